"""Recorded runs: where the commands end, and persistence of the recorded velocities."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from twin.benchmark.protocol import Settings, units
from twin.benchmark.runner import run_unit
from twin.benchmark.scores import Reference
from twin.benchmark.verdict.losses import loss_rows, losses_to_score, score_loss_end
from twin.benchmark.verdict.recorded import RecordedPersistence, commands_end
from twin.channels import MEASUREMENTS
from twin.logs.log import Log, recorded_runs
from twin.predictors.base import Estimate
from usv_kernel.channels import COMPASS, GPS_X, GPS_Y, GYRO


def circle(rows: int = 400, doppler: bool = False) -> Log:
    """Return a boat on a circle: 2 m/s ahead, 0.5 m/s to starboard, 0.1 rad/s."""
    t = 0.1 * np.arange(rows)
    psi, u, v, r = 0.1 * t, 2.0, 0.5, 0.1
    z = np.full((rows, len(MEASUREMENTS)), math.nan)
    z[:, GPS_X] = (u * np.sin(psi) + v * (np.cos(psi) - 1.0)) / r
    z[:, GPS_Y] = (u * (1.0 - np.cos(psi)) + v * np.sin(psi)) / r
    z[:, COMPASS] = psi
    if doppler:
        z[:, 2], z[:, 3] = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
        z[:, GYRO] = r
    return Log(t, z, np.full((rows, 4), 5.0))


@pytest.mark.parametrize("doppler", [False, True])
def test_persistence_of_recorded_velocities_follows_a_circle(doppler: bool) -> None:
    log = circle(doppler=doppler)
    reference = Reference(log)
    times = np.array([15.0, 25.0])
    held = RecordedPersistence(log, reference, "none.csv")
    squares = held.squared_errors(reference.at(times), times)
    # slopes over the last second are those of its middle
    assert np.all(np.sqrt(squares) < ([1e-3, 1e-6] if doppler else [0.02, 1e-6]))
    turned = reference.at(times) + np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.2]])
    position, heading = np.sqrt(held.squared_errors(turned, times))
    assert position == pytest.approx(5.0, abs=0.03)
    assert heading == pytest.approx(0.2, abs=1e-6)


def test_commands_end_where_the_operator_takes_over() -> None:
    log = circle()
    assert commands_end(log) == log.t[-1]
    log.cmd[300:] = 0.0
    assert commands_end(log) == log.t[299]
    truth = np.zeros((len(log), 6))
    assert commands_end(Log(log.t, log.z, log.cmd, truth)) == log.t[-1]
    log.cmd[:] = 0.0  # a boat that drifts all the time
    assert commands_end(log) == log.t[-1]


@pytest.mark.parametrize(
    ("filled", "end"),
    [
        (lambda k: k < 200, 19.9),  # the stream stops
        (lambda k: k % 150 == 0, math.inf),  # written at each change only
        (lambda k: k < 395, math.inf),  # half a second is no stop
    ],
)
def test_a_log_says_where_its_stream_of_commands_stops(tmp_path: Path, filled, end: float) -> None:
    lines = ["t_s,n_rps,delta_rad,gps_x_m,gps_y_m,compass_rad"]
    for k, (t, z, _) in enumerate(circle()):
        command = "5.0,0.1" if filled(k) else ","
        lines.append(f"{t:.1f},{command},{z[GPS_X]},{z[GPS_Y]},{z[COMPASS]}")
    path = tmp_path / "run.csv"
    path.write_text("\n".join(lines) + "\n")
    log = Log.read(path)
    assert log.commands_end == pytest.approx(end)
    assert commands_end(log) == pytest.approx(min(end, log.t[-1]))


def test_a_loss_is_scored_at_its_last_row() -> None:
    log = circle()
    reference = Reference(log)
    lost = [(10.0, 20.0), (35.0, 60.0), (90.0, 99.0)]
    # the second lasts longer than the run, the third begins after it
    assert losses_to_score(log.t, lost, reference) == {199: 10.0}
    true = reference.at(log.t[199:200])[0]
    state = np.array([true[0] + 3.0, true[1] + 4.0, *np.zeros(4)])
    sd = np.array([2.0, 2.0, *np.zeros(4)])
    none = np.zeros(0)
    ended = score_loss_end(
        Estimate(float(log.t[199]), state, sd, none, none, True), 10.0, reference
    )
    assert ended["error_m"] == pytest.approx(5.0)
    # 90 % of a round normal distribution lies within 2.146 standard deviations
    assert ended["said_m"] == pytest.approx(2.0 * 2.1460, abs=1e-3)
    unit = {"scenario": "turn", "case": "gps10", "fault": "gps10", "predictor": "ukf", "log": ""}
    near = {**ended, "error_m": 1.0}
    (row,) = loss_rows([{"unit": unit, "loss_ends": [ended, near]}])
    assert (row["error_m"], row["worst_m"], row["held"]) == (3.0, pytest.approx(5.0), 0.5)


def test_a_log_that_begins_late_has_its_loss_at_the_same_place(tmp_path: Path) -> None:
    """Faults are counted from the first row; so is where a loss is scored."""
    whole = Log.read(recorded_runs()["boat1_usv_circle"]).slice(0.0, 90.0)
    ship = str(recorded_runs()["boat1_usv_circle"].with_name("boat1_usv_circle.toml"))
    found = []
    for late in (0.0, 100.0):
        path = tmp_path / f"from_{late:g}.csv"
        dataclasses.replace(whole, t=whole.t + late).write(path)
        settings = Settings(
            **{"scenarios": (), "faults": ("gps20",), "plans": ("known",), "logs": (str(path),)},
            **{"predictors": ("persistence",), "ship": ship},
        )
        result = run_unit(settings, units(settings)[0], tmp_path, pictures=False)
        (end,) = result["loss_ends"]
        found.append((end["t_s"] - late, end["length_s"], end["error_m"], end["said_m"]))
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    # 20 s without GPS: the radius is no longer that of a fix
    assert found[0][3] > 5.0
