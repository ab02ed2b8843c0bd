"""What the panel says of sensors and of the current, without a browser."""

from types import SimpleNamespace

import numpy as np
import pytest

from twin import Log, Twin
from twin.integrity.monitor import SensorStatus
from twin.live.sessions.log import LogSession
from twin.live.sessions.session import Snapshot
from twin.live.ui.curves import by_equation
from twin.live.ui.panel import checks, said, table
from twin.model.structure import MODELS, structure_of
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_kernel.channels import GYRO

VESSEL = Vessel.load("usv75")
GOOD, NONE = SensorStatus("ok", 0.0, ""), SensorStatus("absent", 0.0, "")


def test_sensors_that_agree_share_a_line_and_others_say_why():
    bad = SensorStatus("excluded", 12.0, "compass disagrees with the other sensors")
    doubted = SensorStatus("doubtful", 13.5, "commands do not explain how the boat moves")
    health = {"gps": GOOD, "compass": bad, "gyro": GOOD, "accelerometers": NONE}
    health |= {"commands": doubted, "navigation": GOOD}
    lines = checks(SimpleNamespace(health=health))
    assert lines == {
        "sensors ok": "gps, gyro",
        "sensors absent": "accelerometers",
        "compass (check)": "EXCLUDED since 12.0 s: disagrees with the other sensors",
        "commands (check)": "DOUBTFUL since 13.5 s: do not explain how the boat moves",
    }
    assert table(lines).count("bold") == 2


def snapshot(**others: object) -> Snapshot:
    given = {
        **{"t": 1.0, "boat": np.zeros(16), "overlay": None, "motion": None, "gps_age": 0.1},
        **{"fixes": np.empty((0, 2)), "track": np.empty((0, 2)), "gps_lost": False},
        **{"imu_lost": False, "has_imu": True},
    }
    return Snapshot(**(given | others))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("current", "words"),
    [
        ([0.3, 0.4, 0.1, 0.1], "0.50 +/- 0.20 m/s to 053 deg"),
        ([0.0, -0.2, 0.0, 0.0], "0.20 +/- 0.00 m/s to 270 deg"),
    ],
)
def test_the_current_is_shown_by_speed_and_where_it_flows(current, words):
    session = SimpleNamespace(recording=False, recorded=None, message="")
    assert said(snapshot(current=np.array(current)), session)["current (twin)"] == words
    assert "current (twin)" not in said(snapshot(), session)


def test_a_moment_of_a_log_shows_the_health_and_the_current_of_then(tmp_path):
    log = simulate("zigzag", vessel=VESSEL, sea=SeaState.named("2"), duration=30.0, seed=3)
    z, frozen = log.z.copy(), (log.t >= 10.0) & (log.t < 20.0)
    z[frozen, GYRO] = z[np.flatnonzero(frozen)[0], GYRO]
    session = LogSession(
        Log(log.t, z, log.cmd, None, "frozen"),
        Twin(particulars_of(VESSEL), "dsw-ukf-plus"),
        VESSEL,
        tmp_path,
    )
    while session.done < log.t[-1]:
        session._advance()
    seen = {}
    for t in (5.0, 19.5, 5.0):
        session.at = t
        seen[t] = session._look()
        assert "current (twin)" in said(seen[t], session)
    assert seen[5.0].health["gyro"].status == "ok"
    assert seen[19.5].health["gyro"].status == "excluded"
    assert "EXCLUDED since 1" in said(seen[19.5], session)["gyro (check)"]
    assert not np.array_equal(seen[5.0].current, seen[19.5].current)
    twin = Twin(particulars_of(VESSEL), "dsw-ukf-plus")
    twin.run(session.log.slice(t1=19.5))
    assert twin.health == seen[19.5].health


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("current", [False, True])
def test_each_parameter_stands_once_and_under_its_equation(model, current):
    structure = structure_of(model, 6.3, 5.4, 20.0, biased=True, current=current)
    blocks = by_equation(structure.blocks)
    assert list(blocks) == ["surge", "surge and sway", "sway", "yaw"]
    under = {name: structure.parameters[a:b] for name, (a, b) in blocks.items()}
    assert sum(under.values(), ()) == structure.parameters
    common = {"E_north", "E_east", *(("C_north", "C_east") if current else ())}
    assert set(under["surge and sway"]) == common
    for equation, marks in (("surge", ("X", "T_u")), ("sway", ("Y", "T_v")), ("yaw", ("N", "T_r"))):
        assert all(name.startswith(marks) for name in under[equation])
