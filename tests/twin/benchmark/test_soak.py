"""Long runs: nothing crashes, nothing is not finite, memory stays."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from twin import PREDICTORS
from twin.benchmark.soak import garbage_rows, soak_environments, soak_predictor
from twin.cli.main import app
from twin.live.soak import soak_feed

SOAKED = sorted(set(PREDICTORS) - {"oracle", "lstm"})
"""All but the one that knows the truth, and the one that needs torch and a training."""


def test_garbage_is_the_same_for_a_seed_and_holds_every_kind():
    some, again = (
        list(itertools.islice(garbage_rows(np.random.default_rng(1), 5.0), 3000)) for _ in range(2)
    )
    for (t, z, cmd), (t2, z2, cmd2) in zip(some, again, strict=True):
        assert t == t2 and z.tobytes() == z2.tobytes() and cmd.tobytes() == cmd2.tobytes()
    steps = np.diff([row[0] for row in some])
    values = np.concatenate([row[1] for row in some])
    assert (steps <= 0.0).any() and (steps > 1000.0).any()
    assert np.isnan(values).any() and np.isinf(values).any() and (np.abs(values) > 1e100).any()
    finite = [np.isfinite(row[2]).all() for row in some]
    assert 0.6 < np.mean(finite) < 0.9


def check(found, rows: int) -> None:
    assert found.rows == rows and 0 < found.refused < 0.5 * rows
    assert found.crashes == found.not_finite == found.not_definite == 0, found
    assert found.normal_after <= 30.0, found


@pytest.mark.parametrize("name", ["persistence", "ukf"])
def test_garbage_harms_no_predictor(name):
    check(soak_predictor(name, 1000, seed=1), 1000)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOAKED)
def test_much_garbage_harms_no_predictor(name):
    found = soak_predictor(name, 2000, seed=1)
    check(found, 2000)
    assert not found.growth > 50.0


def test_the_command_writes_what_it_found(tmp_path):
    path = tmp_path / "soak.json"
    options = ["--steps", "6000", "--rows", "1000", "--hours", "0.05", "--json", str(path)]
    result = CliRunner().invoke(app, ["soak", *options, "--predictors", "persistence"])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "84 kinds of environments" in said and "0 crashes" in said and "feed of 0.05 h" in said
    found = json.loads(path.read_text())
    assert len(found["environments"]) == 84 and found["garbage"][0]["predictor"] == "persistence"
    assert found["feed"][0]["rows"] > 3000


@pytest.mark.slow
def test_ten_million_steps_of_boats_break_nothing():
    found = list(soak_environments(10_000_000, seed=2))
    assert len(found) == 84 and sum(one.steps for one in found) >= 10_000_000
    assert not any(one.crashes or one.not_finite for one in found)
    # the first ones compile, and fill the caches
    assert not sum(max(one.growth, 0.0) for one in found[4:] if math.isfinite(one.growth)) > 100.0


@pytest.mark.slow
def test_hours_of_a_feed_break_nothing():
    found = soak_feed(0.5, seed=2)
    assert found.rows > 0.9 * 1800.0 * 20.0
    assert found.crashes == found.not_finite == found.not_definite == 0
    assert found.error < 4.0 and not found.growth > 50.0
