"""The view in a real browser, with many browsers, and from the command line."""

import math
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.twin.live.wire import free_port, setup, viewing, wait
from twin import Log, Twin, recorded_runs
from twin.live.sessions.feed import FeedSession
from twin.live.sessions.log import LogSession
from twin.live.sessions.simulated import SimulatedSession
from twin.logs.wire.nmea import NmeaFeed
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_gym.vessel.geometry import boat_of

viser = pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")

from twin.live.ui.scene import attitude, borders, quaternion  # noqa: E402
from twin.live.ui.viewer import Viewer  # noqa: E402

VESSEL = Vessel.load("usv75")
REPLAY = Path(__file__).parents[4] / "examples" / "replay.py"
SHOTS = Path(__file__).parents[3] / "screenshots"
"""Kept for people to look at; git ignores it."""


def status(driver: Any) -> dict[str, str]:
    """Return what the panel says."""
    rows = driver.execute_script(
        "return [...document.querySelectorAll('#status tr')].map("
        "row => [...row.children].map(cell => cell.innerText))"
    )
    return dict(rows)


def interval(driver: Any) -> float:
    return float(re.search(r"([\d.]+) m", status(driver)["interval at 10 s"]).group(1))


def press(driver: Any, text: str) -> None:
    """Click the button of a text."""
    script = (
        "const b = [...document.querySelectorAll('button')].find(b => b.innerText.trim() === "
        "arguments[0]); if (b) b.click(); return !!b"
    )
    assert driver.execute_script(script, text), f"no button says {text!r}"


def pixels(driver: Any, name: str) -> np.ndarray:
    """Take a screenshot, keep it, and return its pixels."""
    import io

    from PIL import Image

    SHOTS.mkdir(exist_ok=True)
    png = driver.get_screenshot_as_png()
    (SHOTS / f"{name}.png").write_bytes(png)
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def opened(browser: Any, viewer: Viewer) -> Any:
    driver = browser(1280, 720)
    driver.get(viewer.url)
    wait(lambda: "interval at 10 s" in status(driver))
    # what the browser says of its missing graphics card is in the way
    driver.execute_script(CLOSE_NOTE)
    return driver


CLOSE_NOTE = (
    "const n = document.querySelector('.mantine-Notification-closeButton'); if (n) n.click();"
    "return !!n"
)


def errors_of(driver: Any) -> list[Any]:
    """Return what went wrong in the page; its missing icon did not."""
    said = driver.get_log("browser")
    return [one for one in said if one["level"] == "SEVERE" and "favicon" not in one["message"]]


def test_a_boat_is_seen_to_sail_and_to_lose_its_gps(browser, served, tmp_path):
    session = SimulatedSession(setup(), tmp_path, "zigzag")
    session.set_scale(10.0)
    viewer = served(session)
    wait(lambda: session.t > 40.0)
    session.order(session.set_scale, 1.0)
    driver = opened(browser, viewer)
    first = pixels(driver, "before")
    where, said = session.snapshot.boat[:2], status(driver)
    wait(lambda: math.dist(session.snapshot.boat[:2], where) > 10.0)
    wait(lambda: status(driver)["time"] != said["time"])
    time.sleep(1.0)
    second = pixels(driver, "after")
    scene = (slice(100, 700), slice(300, 900))
    changed = np.abs(first[scene] - second[scene]).max(axis=-1) > 24
    assert changed.mean() > 0.02, "the picture stands still"

    before = interval(driver)
    press(driver, "lose GPS until pressed")
    wait(lambda: status(driver)["GPS"].startswith("LOST"))
    fixes = viewer.scene.fixes.points.copy()
    last = session.snapshot.fixes[-1]
    session.order(session.set_scale, 10.0)
    wait(lambda: session.snapshot.gps_age > 15.0)
    session.order(session.set_scale, 1.0)
    np.testing.assert_array_equal(session.snapshot.fixes[-1], last)
    # drawn where they were; only the water under them moves
    np.testing.assert_array_equal(viewer.scene.fixes.points[:, :2], fixes[:, :2])
    wait(lambda: interval(driver) > 1.2 * before)  # the page follows a little later
    pixels(driver, "gps_lost")
    press(driver, "find GPS again")
    wait(lambda: not status(driver)["GPS"].startswith("LOST"))
    wait(lambda: not np.array_equal(session.snapshot.fixes[-1], last))

    press(driver, "lose IMU until pressed")
    wait(lambda: status(driver)["IMU"] == "LOST")
    press(driver, "pause")
    wait(lambda: session.paused)
    assert errors_of(driver) == []


def test_keys_steer(browser, served, tmp_path):
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    session = SimulatedSession(setup(predictor="persistence"), tmp_path)
    driver = opened(browser, served(session))
    page = driver.find_element(By.TAG_NAME, "body")
    page.send_keys(*[Keys.ARROW_RIGHT] * 15)  # none of them is lost, however fast
    wait(lambda: session.helm.angle == pytest.approx(math.radians(30.0)))
    page.send_keys(*[Keys.ARROW_LEFT] * 13)
    wait(lambda: session.helm.angle == pytest.approx(math.radians(4.0)))
    page.send_keys(Keys.ARROW_DOWN)
    wait(lambda: session.helm.throttle == pytest.approx(0.9))
    page.send_keys("g")
    wait(lambda: session.snapshot.gps_lost)
    assert errors_of(driver) == []


def test_a_log_is_seen_with_its_slider(browser, served, tmp_path):
    path = recorded_runs()["boat1_usv_circle"]
    from twin import Particulars

    particulars = Particulars.load(path.with_name("boat1_usv_circle.toml"))
    log = Log.read(path)
    session = LogSession(log, Twin(particulars, "ukf"), None, tmp_path)
    viewer = served(session)
    wait(lambda: session.done == log.t[-1])
    driver = opened(browser, viewer)
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    press(driver, "pause")
    wait(lambda: session.paused)
    slider = driver.find_element(By.CSS_SELECTOR, "[role=slider]")
    slider.send_keys(Keys.END)
    wait(lambda: session.at == pytest.approx(log.t[-1], abs=0.1))
    wait(lambda: len(session.snapshot.ahead) == 0)
    slider.send_keys(Keys.HOME, *[Keys.ARROW_RIGHT] * 300)  # 30 s
    wait(lambda: session.at == pytest.approx(30.0, abs=0.5))
    wait(lambda: float(status(driver)["time"].split()[0]) == pytest.approx(session.at, abs=0.3))
    assert len(session.snapshot.ahead) >= 50
    pixels(driver, "log")
    assert errors_of(driver) == []


@pytest.mark.parametrize("name", ["usv75", "kvlcc2", "otter"])
def test_every_boat_has_a_scene(name, served, tmp_path):
    vessel = Vessel.load(name)
    log = simulate("zigzag", vessel=vessel, sea=SeaState.named("3"), duration=20.0, seed=1, dof=3)
    session = LogSession(log, Twin(particulars_of(vessel), "ukf"), vessel, tmp_path)
    viewer = served(session)
    wait(lambda: viewer.frames > 0)
    assert viewer.scene.length == pytest.approx(np.ptp(boat_of(vessel).whole().vertices[:, 0]))


def test_a_feed_that_has_not_begun_answers_orders(served, tmp_path):
    twin = Twin(particulars_of(VESSEL), "persistence")
    feed = NmeaFeed(f"udp://:{free_port()}", twin.particulars)
    (tmp_path / "file").write_text("no folder")
    session = FeedSession(feed, twin, VESSEL, tmp_path / "file" / "folder")
    controls = served(session).controls
    wait(lambda: "nothing has come yet" in controls.status.content)
    session.order(session.toggle_record)
    wait(lambda: "choose another folder" in controls.status.content)
    session.folder = tmp_path
    session.order(session.toggle_record)
    wait(lambda: controls.record.label == "stop recording")


def test_the_command_ends_cleanly_on_ctrl_c(tmp_path):
    port = free_port(socket.SOCK_STREAM)
    given = "--sea", "4", "--dof", "3", "-p", "ukf"
    with viewing(tmp_path, "--port", str(port), *given) as (process, lines):
        assert f"http://127.0.0.1:{port}" in lines[-1]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60.0) as page:
            assert page.status == 200
        process.send_signal(signal.SIGINT)
        said, complained = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "stopped" in said
    assert "Traceback" not in complained and "rror" not in complained


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["--nmea", "--mavlink"])
def test_a_boat_that_is_replayed_is_followed(kind, tmp_path):
    log = simulate("zigzag", vessel=VESSEL, sea=SeaState.named("2"), duration=30.0, seed=1)
    log.write(tmp_path / "run.csv")
    port, address = free_port(socket.SOCK_STREAM), f"udp://:{free_port()}"
    own = "--vessel", "usv75", "-p", "ukf", "--port", str(port)
    with viewing(tmp_path, kind, address, *own) as (process, _):
        done = subprocess.run(
            [
                *(sys.executable, str(REPLAY), "run.csv", kind, address),
                *("--speed", "10", "--ship", "usv75"),
            ],
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        process.send_signal(signal.SIGTERM)
        _, complained = process.communicate(timeout=20)
    assert process.returncode == 0 and "Traceback" not in complained
    assert done.returncode == 0


def test_a_boat_stands_in_the_scene_as_it_does_at_sea():
    """Quaternions against the rotation matrices of the ship."""
    from scipy.spatial.transform import Rotation

    from usv_gym.physics.frames import rotate

    rng = np.random.default_rng(0)
    for _ in range(20):
        phi, theta, psi = rng.uniform(-1.2, 1.2, 3)
        w, x, y, z = attitude(phi, theta, psi)
        turn = Rotation.from_quat([x, y, z, w]).as_matrix()
        for axis in np.eye(3):
            np.testing.assert_allclose(turn @ axis, rotate(phi, theta, psi, *axis), atol=1e-12)
    # north is y, east is x, down is -z
    w, x, y, z = quaternion(
        Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    )
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(turn @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0], atol=1e-12)


def test_the_ribbon_is_two_standard_deviations_wide_across_the_track():
    t = np.linspace(0.0, 1.0, 30)
    places = np.stack([10.0 * t, np.zeros(30)], axis=1)
    covs = np.zeros((30, 2, 2))
    covs[:, 0, 0], covs[:, 1, 1] = 25.0, (1.0 + t) ** 2
    left, right = borders(places, covs).transpose(1, 0, 2)
    np.testing.assert_allclose(right[:, 1] - left[:, 1], 4.0 * (1.0 + t))
    np.testing.assert_allclose(left[:, 0], places[:, 0], atol=1e-12)
    still = borders(np.zeros((30, 2)), covs)  # a boat that lies still
    assert np.isfinite(still).all()
