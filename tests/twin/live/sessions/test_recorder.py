"""Logs that are written as the boat sails."""

import math
from pathlib import Path

import numpy as np
import pytest

from twin import Log, Particulars, Twin
from twin.live.sessions.recorder import Recorder
from twin.logs.datum import Datum
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel

VESSEL = Vessel.load("usv75")


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate("zigzag", vessel=VESSEL, sea=SeaState.named("2"), duration=20.0, seed=2)


def record(folder: Path, log: Log, datum: Datum | None = None) -> Recorder:
    made = Recorder(folder, particulars_of(VESSEL), with_truth=log.truth is not None)
    for row, (t, z, cmd) in enumerate(log):
        truth = np.full(6, math.nan) if log.truth is None else log.truth[row]
        made.add(t, z, cmd, truth, datum if row > 9 else None)  # known from the first fix on
    return made


@pytest.mark.parametrize("datum", [None, Datum(latitude=59.9, longitude=10.7)])
@pytest.mark.parametrize("with_truth", [True, False])
def test_a_recorded_log_holds_the_same_numbers(datum, with_truth, log, tmp_path):
    given = log if with_truth else log.without_truth()
    path = record(tmp_path / "new" / "folder", given, datum).close()
    read = Log.read(path)
    for name in ("t", "z", "cmd"):
        np.testing.assert_array_equal(getattr(read, name), getattr(given, name))
    assert (read.truth is None) == (given.truth is None)
    if with_truth:
        np.testing.assert_array_equal(read.truth, given.truth)
    assert read.datum == datum
    assert Particulars.load(path.with_suffix(".toml")) == particulars_of(VESSEL)


def test_a_process_that_is_killed_loses_at_most_a_second(log, tmp_path):
    """What is in the file while it is written is what such a process leaves; rows are short."""
    made = Recorder(tmp_path, particulars_of(VESSEL), with_truth=False)
    for row, (t, z, cmd) in enumerate(log):
        made.add(t, np.where(np.arange(len(z)) < 2, z, np.nan), cmd, log.truth[row], None)
        if row > 20 and row % 11 == 0:
            left = Log.read(made.path)
            assert left.t[-1] >= t - 1.0
    twin = Twin(Particulars.load(made.path.with_suffix(".toml")), "persistence")
    assert len(twin.run(left)) == len(left)
    made.close()


def test_a_log_whose_last_line_is_torn_can_be_read(log, tmp_path):
    path = record(tmp_path, log.slice(t1=2.0)).close()
    whole = path.read_bytes()
    rows = len(Log.read(path))
    last = whole[:-1].rindex(b"\n") + 1
    for cut in (*range(last, len(whole), 4), len(whole) - 1):
        path.write_bytes(whole[:cut])
        torn = Log.read(path)
        assert len(torn) in (rows - 1, rows)
        assert len(torn) == rows or cut == last or "the last line is cut off" in torn.notes[0]
        np.testing.assert_array_equal(torn.z, log.z[: len(torn)])


def test_two_logs_of_one_second_have_names_of_their_own(tmp_path):
    made = [Recorder(tmp_path, particulars_of(VESSEL), with_truth=False) for _k in range(3)]
    assert len({one.path for one in made}) == 3
    assert [one.close() for one in made] == [None] * 3
    assert list(tmp_path.iterdir()) == []  # there was nothing to write
