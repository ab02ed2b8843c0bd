"""The causality test finds predictors that use later rows; those of users go by module and name."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.benchmark.conformance import ContractError, check_predictor
from twin.cli.main import app
from twin.predictors import registry
from twin.predictors.base import Estimate, Prediction, Predictor
from twin.predictors.baselines import Persistence
from twin.predictors.registry import PREDICTORS, PredictorError, predictor_class

OWN = """
from twin.predictors.baselines import Persistence

class Mine(Persistence):
    tuning = "one configuration, by judgement"
    average = 2.0

class Counts(Persistence):
    seen = 0

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        Counts.seen += 1

    def forecast_from_last(self, rows, plan):
        return super().forecast_from_last(rows, plan) + Counts.seen

not_a_class = 3
"""

LONG = ("lstm", "fleet-lstm", "transformer")
"""Neural networks, whose rows take ten times as long."""

NAMES = [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in PREDICTORS]


@pytest.mark.parametrize("name", NAMES, indirect=True)
def test_every_predictor_passes(name):
    assert check_predictor(name) == 2


class Plain(Predictor):
    """Stands still: a minimal predictor."""

    def __init__(self, particulars, *, seed=0):
        super().__init__(particulars, seed=seed)
        self.reset()

    def reset(self):
        self.t, self.now = 0.0, np.zeros(6)

    def update(self, t, dt, z, cmd):
        self.t = t
        self.now[0] = np.nan_to_num(z[0], posinf=0.0)

    @property
    def state(self):
        return self.now

    def estimate(self):
        none = np.zeros(0)
        return Estimate(self.t, self.now.copy(), np.ones(6), none, none, bool(self.now[0]))

    def predict(self, plan, dt):
        rows = len(plan)
        cov = np.tile(np.eye(6), (rows, 1, 1))
        mean = np.tile(self.now, (rows, 1))
        after = self.t + dt * np.arange(1, rows + 1)
        return Prediction(self.t, self.now.copy(), np.eye(6), after, mean, cov)


class Shares(Plain):
    """All of the class count their rows together."""

    seen = 0

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        Shares.seen += 1
        self.now[1] = Shares.seen


class Moves(Plain):
    """Predictions change the state."""

    def predict(self, plan, dt):
        self.now[3] += 1.0
        return super().predict(plan, dt)


class NotFinite(Plain):
    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        prediction.cov[-1, 2, 2] = np.nan
        return prediction


class Fails(Plain):
    def predict(self, plan, dt):
        raise RuntimeError("no")


class NotANumber(Persistence):
    def forecast_from_last(self, rows, plan):
        path = super().forecast_from_last(rows, plan)
        path[-1, 3] = np.nan
        return path


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        (Shares, "whole log"),
        (Moves, "whole log"),
        (NotFinite, "covariance .* not finite"),
        (Fails, r"RuntimeError: no \(.*test_conformance.py, line \d+\)"),
        (NotANumber, "u_mps is nan at step"),
    ],
)
def test_a_violation_is_found_and_the_predictor_named(kind, word, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "broken", kind)
    with pytest.raises(ContractError, match=f"({kind.__name__}|broken): .*{word}"):
        check_predictor("broken")


def test_a_minimal_predictor_passes(monkeypatch):
    monkeypatch.setitem(PREDICTORS, "plain", Plain)
    assert check_predictor("plain") == 2


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A user's module in the working directory."""
    (tmp_path / "some_body.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "some_body", raising=False)
    return tmp_path


def test_a_class_is_found_by_module_and_name(own):
    kind = predictor_class("some_body:Mine")
    assert issubclass(kind, Persistence) and kind.average == 2.0
    assert kind.tuning == "one configuration, by judgement"
    (own / "bad_body.py").write_text("1 / 0")
    for wrong, word in {
        "some_body:Nobody": "Nobody",
        "no_body:Mine": "no_body",
        "some_body:not_a_class": "not a subclass",
        "bad_body:Mine": "ZeroDivisionError",
    }.items():
        with pytest.raises(PredictorError, match=word):
            predictor_class(wrong)


def test_entry_points_join_the_registry(own):
    info = own / "some_body-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: some-body\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        f"[{registry.GROUP}]\nmine = some_body:Mine\nukf = some_body:Mine\n"
    )
    code = (
        "from twin.predictors.registry import PREDICTORS, predictor_class;"
        "print(predictor_class('mine').__module__, predictor_class('ukf').__module__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=own, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["some_body", "twin.predictors.ukf"]


@pytest.mark.parametrize(
    ("name", "code", "word"),
    [
        ("some_body:Mine", 0, "2 forecasts are finite, and equal those from logs cut"),
        ("some_body:Counts", 1, "some_body:Counts: after"),
        ("some_body:Nobody", 2, "Nobody"),
    ],
)
def test_the_command_prints_the_result(own, name, code, word):
    done = CliRunner().invoke(app, ["benchmark", "--check", name])
    assert done.exit_code == code, done.output
    assert word in " ".join(done.output.split())


def test_only_the_oracle_gets_the_simulator(own):
    (own / "peeking.py").write_text(
        "from twin.sim.oracle import Oracle\n\nclass Peek(Oracle):\n    pass\n"
    )
    with pytest.raises(PredictorError, match="only the oracle"):
        predictor_class("peeking:Peek")
