"""What a browser sends to a view is checked before viser sees it."""

from __future__ import annotations

import itertools
import math
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

viser = pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from msgspec.msgpack import decode, encode  # noqa: E402
from websockets.exceptions import ConnectionClosed  # noqa: E402
from websockets.sync.client import ClientConnection, connect  # noqa: E402

from tests.twin.live.ui.test_viewer import setup, wait  # noqa: E402
from tests.twin.live.wire import free_port  # noqa: E402
from twin.live.sessions.simulated import SimulatedSession  # noqa: E402
from twin.live.ui.messages import RefusedError, checked  # noqa: E402
from twin.live.ui.viewer import Viewer  # noqa: E402

NAN, INF = math.nan, math.inf

CAMERA = {
    **{"type": "ViewerCameraMessage", "wxyz": (1, 0.0, 0.0, 0.0), "fov": 1.0, "near": 1},
    **{"position": (9.0, 9.0, 9.0), "far": 100.0, "image_height": 720, "image_width": 1280},
    **{"look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0)},
}

NUMBERS = NAN, INF, -INF, 1e300, -1e300, 1e10, "1", "nan", True, None, [], {}, "x" * 5000

NAMES = "nobody", "evilmod:X", "../x.toml", "/etc/passwd", "", 0, True, None, ["ukf"], NAN


def update(control: Any, **updates: Any) -> bytes:
    """Return what viser's page sends when a control changes."""
    return encode({"type": "GuiUpdateMessage", "uuid": control._impl.uuid, "updates": updates})


def talk(viewer: Viewer) -> ClientConnection:
    url = f"ws://127.0.0.1:{viewer.port}"
    one = connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, max_queue=None)
    one.send(encode(CAMERA))
    return one


@pytest.fixture
def steered(
    served: Callable[..., Viewer], tmp_path: Path
) -> Iterator[tuple[SimulatedSession, Viewer, Callable[[bytes], None]]]:
    """Serve a boat; return its session, its viewer, and a function that waits for a refusal."""
    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    viewer = served(session)
    wait(lambda: viewer.frames > 0)
    with talk(viewer) as page:

        def refused(message: bytes | str) -> None:
            session.report("")
            page.send(message)
            wait(lambda: session.message.startswith("refused"))

        yield session, viewer, refused


@pytest.mark.parametrize(
    "name", ["throttle", "helm", "wind", "wind_from", "seed", "predictor", "vessel", "scale"]
)
def test_a_value_that_a_control_does_not_offer_is_refused_and_changes_nothing(name, steered):
    session, viewer, refused = steered
    control = getattr(viewer.controls, name)
    before, throttle = control.value, session.helm.throttle
    text = isinstance(before, str)
    wrong = [-1, 0.5] if name == "seed" else [0.5] if name == "wind_from" else []
    for value in NAMES if text else (*NUMBERS, *wrong):
        refused(update(control, value=value))
        assert control.value == before
    if name == "scale":
        refused(update(control, value="infx"))
    wait(lambda: "refused" in viewer.controls.status.content)
    assert session.helm.throttle == throttle and session.scale == 1.0
    t = session.t
    wait(lambda: session.t > t + 0.5)


def test_damaged_messages_are_refused_or_stay_in_range():
    port = free_port(socket.SOCK_STREAM)
    server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    gui = server.gui
    slider = gui.add_slider("s", -1.0, 1.2, 0.05, 0.0)
    number = gui.add_number("n", 3, min=0, max=9, step=1)
    choice = gui.add_dropdown("c", ("a", "b"))
    whole = [encode(CAMERA), update(slider, value=0.5), update(number, value=4)]
    whole += [update(choice, value="b")]
    rng, passed = np.random.default_rng(0), 0
    for k in range(4000):
        raw = bytearray(whole[k % len(whole)])
        for place in rng.integers(len(raw), size=rng.integers(1, 4)):
            raw[place] = rng.integers(256)
        try:
            message = decode(
                checked(gui, bytes(raw[: rng.integers(len(raw)) if k % 9 == 0 else None]))
            )
        except RefusedError:
            continue
        passed += 1
        value = message.get("updates", {}).get("value")
        uuid = message.get("uuid")
        if uuid == slider._impl.uuid:
            assert -1.0 <= value <= 1.2 + 1e-5
        elif uuid == number._impl.uuid:
            assert value in range(10)
        else:
            assert value in (None, "a", "b")
    server.stop()
    assert 0 < passed < 2000


def test_other_properties_of_a_control_cannot_be_set(steered):
    _session, viewer, refused = steered
    control = viewer.controls.predictor
    for updates in (
        {"options": ("evilmod:X",)},
        {"value": "ukf", "options": ("evilmod:X",)},
        {"removed": True},
        {"update_cb": []},
        {"gui_api": None},
        {},
    ):
        refused(update(control, **updates))
    assert control.value == "persistence" and "evilmod:X" not in control.options
    assert control._impl.update_cb is not None and not control._impl.removed
    control.disabled = True
    refused(update(control, value="ukf"))
    refused(update(viewer.controls.pause, value="x"))


def test_messages_that_no_control_sends_are_refused(steered, monkeypatch):
    _session, viewer, refused = steered
    shared = []
    monkeypatch.setattr(viewer.server, "request_share_url", lambda: shared.append(1))
    for message in (
        {"type": "ShareUrlRequest"},  # would open a tunnel to the internet
        {"type": "GuiFormDirtyMessage", "uuid": "x"},
        {"type": "RunJavascriptMessage", "source": "alert(1)"},
        {"type": "SceneNodeClickMessage", "name": "/sea"},
        {**CAMERA, "fov": NAN},
        {**CAMERA, "position": (INF, 0.0, 0.0)},
        {**CAMERA, "position": (0.0, 0.0)},
        {**CAMERA, "position": "abc"},
        {**CAMERA, "more": 1},
        {"type": "GuiUpdateMessage", "uuid": "nobody", "updates": {"value": 1}},
        {"type": "GuiUpdateMessage"},
        {"type": ["x"]},
        {},
        [1, 2],
        "text",
        None,
        NAN,
    ):
        refused(encode(message))
    for raw in (b"", b"\xc1", b"\x91" * 60000, b"\xdd\xff\xff\xff\xff", b"\x00" * 9, "text"):
        refused(raw)
    assert not shared


def test_the_last_of_two_equal_keys_is_the_one_that_was_checked(steered):
    session, viewer, refused = steered
    uuid, good, evil = (encode(one) for one in (viewer.controls.throttle._impl.uuid, 0.5, NAN))
    head = b"\x83" + encode("type") + encode("GuiUpdateMessage") + encode("uuid") + uuid
    head += encode("updates") + b"\x82" + encode("value")
    refused(head + good + encode("value") + evil)
    with talk(viewer) as page:
        page.send(head + evil + encode("value") + good)
        wait(lambda: session.helm.throttle == 0.5 or session.message)
    assert session.helm.throttle in (0.5, 1.0)


def test_a_message_of_many_bytes_ends_its_connection_alone(steered):
    session, viewer, _refused = steered
    with talk(viewer) as page:
        page.send(b"\x00" * (1 << 17))
        with pytest.raises(ConnectionClosed):
            all(page.recv(timeout=20) for _frame in itertools.count())
    assert session.error is None


def test_values_on_offer_reach_the_session(steered):
    session, viewer, _refused = steered
    controls = viewer.controls
    with talk(viewer) as page:
        page.send(update(controls.throttle, value=-1))  # JavaScript has one kind of number
        wait(lambda: session.helm.throttle == -1.0)
        page.send(update(controls.seed, value=7.0))
        page.send(update(controls.vessel, value="otter"))
        page.send(update(controls.scale, value="2x"))
        wait(lambda: session.scale == 2.0 and controls.vessel.value == "otter")
        page.send(encode({"type": "CommandTriggerMessage", "uuid": "nobody"}))  # of no key
        wait(lambda: viewer.server.get_clients())
        session.order(controls._restart)
        wait(lambda: session.vessel.name == "otter")
    assert session.setup.seed == 7 and session.message == ""


def test_nothing_is_imported_or_opened_for_a_name_that_a_browser_sends(
    steered, tmp_path, monkeypatch
):
    session, viewer, refused = steered
    (tmp_path / "evilmod.py").write_text("class X: pass\n")
    monkeypatch.chdir(tmp_path)
    refused(update(viewer.controls.predictor, value="evilmod:X"))
    session.order(viewer.controls._restart)
    wait(lambda: session.changed == 2)
    modules = set(sys.modules)
    # as if the page had got past the check
    viewer.controls.predictor._impl.value = "evilmod:X"
    session.order(viewer.controls._restart)
    wait(lambda: "was not on offer" in session.message)
    viewer.controls.predictor._impl.value = "persistence"
    viewer.controls.vessel._impl.value = "evil.toml"
    session.report("")
    session.order(viewer.controls._restart)
    wait(lambda: session.message)
    assert session.changed == 2 and session.setup.predictor == "persistence"
    assert not any("evil" in name for name in set(sys.modules) - modules)
