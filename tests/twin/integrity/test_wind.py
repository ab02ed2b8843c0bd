"""The apparent wind in a twin: what it makes of it, and that faults of an anemometer do no harm."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from twin import Twin
from twin.channels import APPARENT_FROM, APPARENT_SPEED, WIND_SPEED
from twin.integrity.bank import SILENT_S
from twin.integrity.wind import STUCK_S
from twin.logs.log import Log
from twin.predictors.ukf import ModelPredictor
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, SensorSuite, Vessel

BEST = SensorSuite.grade("best")
BOAT = Vessel.load("usv75")
SEA = SeaState.named("2").replace(wind=9.0)
TRUE = -9.0 * math.cos(SEA.wind_from), -9.0 * math.sin(SEA.wind_from)
"""Velocity of the air, m/s."""
WIND = [APPARENT_SPEED, APPARENT_FROM]
FAULT = slice(800, 1201)
"""Rows in which the anemometer is at fault: 40 to 60 s."""


@functools.cache
def run() -> Log:
    return simulate("zigzag", vessel=BOAT, sea=SEA, duration=60.0, seed=2, suite=BEST)


def with_wind(z: np.ndarray) -> Log:
    return dataclasses.replace(run(), z=z)


def twin_after(log: Log) -> tuple[Twin, np.ndarray]:
    """Return a twin that has seen a log, and the wind by its filter at each row (N, 2)."""
    twin = Twin(particulars_of(BOAT, BEST), "ukf")
    assert isinstance(twin.predictor, ModelPredictor)
    winds = []
    for row in log:
        twin.step(*row)
        winds.append(twin.predictor.ukf.wind.copy())  # type: ignore[attr-defined]
    return twin, np.array(winds)


def broken(kind: str) -> Log:
    z = run().z.copy()
    has = np.flatnonzero(np.isfinite(z[:, APPARENT_SPEED]))
    struck = has[(has >= FAULT.start) & (has < FAULT.stop)]
    if kind == "silent":
        z[FAULT, APPARENT_SPEED:] = math.nan
    elif kind == "frozen":
        z[struck[:, None], WIND] = z[has[has < FAULT.start][-1], WIND]
    elif kind == "dead":
        z[struck[:, None], WIND] = 0.0
    elif kind == "vane":
        z[struck, APPARENT_FROM] = 0.5
    elif kind == "spikes":
        z[struck[::7], APPARENT_SPEED] = 45.0
    elif kind == "garbage":
        z[struck, APPARENT_SPEED], z[struck, APPARENT_FROM] = 1e9, 1e9
    elif kind == "negative":
        z[struck, APPARENT_SPEED] = -5.0
    return with_wind(z)


def test_the_true_wind_is_found_while_the_boat_turns() -> None:
    """Gusts of 9 m/s have a standard deviation of 1.1; 2 degrees of bias make 0.3."""
    twin, winds = twin_after(run())
    assert winds[400:].mean(axis=0) == pytest.approx(TRUE, abs=1.0)
    assert "wind" not in twin.health


@pytest.mark.parametrize(
    ("kind", "status"),
    [("silent", "absent"), ("frozen", "excluded"), ("dead", "excluded"), ("vane", "excluded")],
)
def test_an_anemometer_at_fault_is_named(kind: str, status: str) -> None:
    twin, _ = twin_after(broken(kind))
    found = twin.health["wind"]
    assert found.status == status and found.why.startswith("wind ")
    assert any(line.startswith(f"wind {status} from") for line in twin.notes)
    late = STUCK_S if status == "excluded" else SILENT_S
    # a faulty sample comes a quarter of a second after the last good one at the latest
    assert found.since == pytest.approx(40.0 + late, abs=0.6)


@pytest.mark.parametrize("kind", ["silent", "frozen", "dead", "spikes", "garbage", "negative"])
def test_an_anemometer_at_fault_does_no_harm(kind: str) -> None:
    """The wind stays near the true one, and is never NaN."""
    _, winds = twin_after(broken(kind))
    assert np.isfinite(winds).all()
    off = np.hypot(*(winds[FAULT] - TRUE).T)
    assert off.max() < 5.0 and off.mean() < 2.5


def test_it_is_used_again_when_it_works_again() -> None:
    z = broken("frozen").z.copy()
    z[1100:] = run().z[1100:]
    twin, winds = twin_after(with_wind(z))
    assert "wind" not in twin.health
    _, good = twin_after(run())
    assert winds[-1] == pytest.approx(good[-1], abs=0.5)


def test_a_twin_without_an_anemometer_knows_no_wind() -> None:
    z = run().z.copy()
    z[:, APPARENT_SPEED:] = math.nan
    _, winds = twin_after(with_wind(z))
    assert not winds.any()


def test_a_true_wind_that_is_measured_is_taken_as_it_is() -> None:
    z = run().z.copy()
    z[:, APPARENT_SPEED:] = math.nan
    z[:, WIND_SPEED], z[:, WIND_SPEED + 1] = 6.0, math.pi
    _, winds = twin_after(with_wind(z))
    assert winds[-1] == pytest.approx([6.0, 0.0], abs=1e-9)


def test_a_lower_anemometer_gives_the_wind_of_ten_metres() -> None:
    low = dataclasses.replace(particulars_of(BOAT, BEST).instruments, wind_height=0.5)
    twins = [
        Twin(dataclasses.replace(particulars_of(BOAT, BEST), instruments=one), "ukf")
        for one in (low, dataclasses.replace(low, wind_height=10.0))
    ]
    for row in run().slice(0.0, 20.0):
        for twin in twins:
            twin.step(*row)
    a, b = (twin.predictor.ukf.wind for twin in twins)  # type: ignore[attr-defined]
    assert np.hypot(*a) / np.hypot(*b) == pytest.approx(20.0**0.11, rel=0.02)
