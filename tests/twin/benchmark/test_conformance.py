"""The contract of predictors: the registry keeps it, and violations are found."""

from __future__ import annotations

import subprocess
import sys
from typing import ClassVar

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.benchmark.conformance import CHECKS, check
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

class NoCovariance(Persistence):
    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        prediction.cov[:, 0, 1] = prediction.cov[:, 1, 0] = 1e6
        return prediction

not_a_class = 3
"""


LONG = ("lstm", "fleet-lstm", "transformer")
"""Neural networks, whose rows take ten times as long."""

NAMES = [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in PREDICTORS]


@pytest.mark.parametrize("name", NAMES, indirect=True)
def test_every_predictor_keeps_the_contract(name):
    found = check(name)
    assert [item.name for item in found] == list(CHECKS)
    assert all(item.passed for item in found), [item for item in found if not item.passed]


class Plain(Predictor):
    """Stands still: a minimal predictor that keeps the contract."""

    seen = 0

    def __init__(self, particulars, *, seed=0):
        super().__init__(particulars, seed=seed)
        self.reset()

    def reset(self):
        self.t, self.n, self.now = 0.0, 0, np.zeros(6)

    def update(self, t, dt, z, cmd):
        self.t, self.n = t, self.n + 1
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


class Writes(Plain):
    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        z[0] = 0.0


class Keeps(Plain):
    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        self.row = z

    def predict(self, plan, dt):
        self.now[1] = np.nan_to_num(self.row[1])
        return super().predict(plan, dt)


class Peeps(Plain):
    """Reads the later rows where only cheating finds them: in the caller that holds the log."""

    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        prediction.mean[:, 1] = self.later
        return prediction

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        frame = sys._getframe()
        while frame is not None and "log" not in frame.f_locals:
            frame = frame.f_back
        self.later = 0.0 if frame is None else float(np.nan_to_num(frame.f_locals["log"].z[-1, 5]))


class Shares(Plain):
    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        Shares.seen += 1
        self.now[1] = Shares.seen


class Remembers(Plain):
    def reset(self):
        old = getattr(self, "n", 0)
        super().reset()
        self.n = old

    def predict(self, plan, dt):
        self.now[2] = self.n
        return super().predict(plan, dt)


class Moves(Plain):
    def predict(self, plan, dt):
        self.now[3] += 1.0
        return super().predict(plan, dt)


class Stashes(Plain):
    """Answers one plan with the commands of another."""

    plan = None

    def predict(self, plan, dt):
        if np.ptp(plan, axis=0).max() > 0.0:
            self.plan = plan.copy()
        prediction = super().predict(plan, dt)
        prediction.mean[:, 3] += (plan if self.plan is None else self.plan).sum()
        return prediction


class Erases(Plain):
    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        plan[:] = 0.0
        return prediction


class Blind(Plain):
    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        self.now[1] = z[1]


class Backwards(Plain):
    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        prediction.t[:] = prediction.t[::-1].copy()
        return prediction


class Inside(Plain):
    def predict(self, plan, dt):
        prediction = super().predict(plan, dt)
        prediction.low[:] = prediction.mean + 1.0
        return prediction


class Fails(Plain):
    def predict(self, plan, dt):
        raise RuntimeError("no")


class NotANumber(Persistence):
    def forecast_from_last(self, rows, plan):
        path = super().forecast_from_last(rows, plan)
        path[-1, 3] = np.nan
        return path


class FitsAll(Persistence):
    """Holds a speed that is fitted to all rows, also to those after an origin."""

    model = None

    def reset(self):
        super().reset()
        self.model = None

    def forecast(self, rows, origins, plans):
        if self.model is None:
            self.model = rows[:, 3:6].mean(axis=0)
        out = super().forecast(rows, origins, plans)
        out[..., 3:] = self.model
        return out


class FitsKept(FitsAll):
    """The same with its own list of rows."""

    def forecast(self, rows, origins, plans):
        out = Persistence.forecast(self, rows, origins, plans)
        out[..., 3:] = np.mean(self._rows, axis=0)[3:6]
        return out


class Remembering(Plain):
    """Answers with what an earlier one of its class has seen at later times."""

    seen_at: ClassVar[dict] = {}

    def update(self, t, dt, z, cmd):
        super().update(t, dt, z, cmd)
        self.seen_at[round(t, 3)] = float(np.nan_to_num(z[0]))
        self.now[2] = self.seen_at.get(round(t + 5.0, 3), 0.0)


class Bare(Plain):
    def __init__(self, particulars):
        super().__init__(particulars)


BROKEN = [
    (Writes, "arguments untouched", "writes to the row"),
    (Keeps, "arguments untouched", "overwritten"),
    (Peeps, "no future, no truth", "later rows are nonsense"),
    (Shares, "same seed, same answer", "same seed"),
    (Remembers, "reset", "after reset"),
    (Moves, "no side effects", "under one plan changes"),
    (Stashes, "no side effects", "changes the next one"),
    (Erases, "arguments untouched", "writes to the plan"),
    (Blind, "before and without data", "not finite"),
    (Blind, "losses, gaps, wild numbers", "not finite"),
    (Backwards, "shapes, times, covariances, intervals", "do not increase"),
    (Inside, "shapes, times, covariances, intervals", "low <= mean <= high"),
    (Fails, "time", "raises RuntimeError: no"),
    (Bare, "class and constructor", "seed"),
    (NotANumber, "shapes, times, covariances, intervals", "u_mps is nan at step"),
    (FitsAll, "no rows after an origin", "use rows[: origin + 1] alone"),
    (FitsKept, "no rows after an origin", "use rows[: origin + 1] alone"),
    (Remembering, "no future, no truth", "another of its class has seen the whole run"),
]


@pytest.mark.parametrize(("kind", "name", "words"), BROKEN)
def test_a_violation_is_found(kind, name, words, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "broken", kind)
    (found,) = check("broken", [name])
    assert found.passed is False
    assert words in found.text


PLACES = [
    (NotANumber, "shapes, times, covariances, intervals", "def forecast_from_last("),
    (FitsAll, "no rows after an origin", "self.model = rows[:, 3:6].mean(axis=0)"),
    (FitsKept, "no rows after an origin", "Persistence.forecast(self, rows, origins, plans)"),
    (Fails, "time", 'in predict: raise RuntimeError("no")'),
    (Writes, "arguments untouched", "def update(self, t, dt, z, cmd):"),
]


@pytest.mark.parametrize(("kind", "name", "line"), PLACES)
def test_a_violation_has_its_line(kind, name, line, monkeypatch):
    monkeypatch.setitem(PREDICTORS, "broken", kind)
    (found,) = check("broken", [name])
    assert "test_conformance.py:" in found.place and line in found.place


def test_a_cause_is_explained_once(monkeypatch):
    monkeypatch.setitem(PREDICTORS, "broken", NotANumber)
    failed = [item for item in check("broken") if item.passed is False]
    first, *others = failed
    assert len(others) > 5 and first.place
    assert all(item.text == f"the same as in {first.name!r}" for item in others)
    assert not any(item.place for item in others)


def test_a_file_that_is_read_but_not_declared_is_found(own):
    (own / "gain.txt").write_text("0.5")
    (own / "weighing.py").write_text(
        "from pathlib import Path\n"
        "from twin.predictors.baselines import Persistence\n"
        "class Mine(Persistence):\n"
        "    def reset(self):\n"
        "        super().reset()\n"
        "        self.gain = float(Path(__file__).with_name('gain.txt').read_text())\n"
        "class Declared(Mine):\n"
        "    files = ('gain.txt',)\n"
    )
    (found,) = check("weighing:Mine", ["files"])
    assert found.passed
    found = check("weighing:Mine", ["reset", "files"])[1]
    assert found.passed is False and "gain.txt" in found.text
    assert "weighing.py:6" in found.place
    found = check("weighing:Declared", ["reset", "files"])[1]
    assert found.passed and "gain.txt" in found.text


def test_a_minimal_predictor_keeps_the_contract(monkeypatch):
    monkeypatch.setitem(PREDICTORS, "plain", Plain)
    # a class from outside of the package cannot be saved, which is allowed
    assert all(item.passed is not False for item in check("plain"))


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
    assert predictor_class("some_body:NoCovariance").tuning == "not stated"
    for wrong, words in {
        "some_body:Nobody": "Nobody",
        "no_body:Mine": "No module named 'no_body'",
        "some_body:not_a_class": "not a subclass",
    }.items():
        with pytest.raises(PredictorError, match=words):
            predictor_class(wrong)
    (own / "bad_body.py").write_text("1 / 0")
    with pytest.raises(PredictorError, match="ZeroDivisionError"):
        predictor_class("bad_body:Mine")
    assert check("bad_body:Mine")[0].passed is False


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
        ("some_body:Mine", 0, "14 checks, 0 failed"),
        ("some_body:NoCovariance", 1, "eigenvalue"),
        ("some_body:Nobody", 1, "FAIL"),
    ],
)
def test_the_command_prints_the_checks(own, name, code, word):
    done = CliRunner().invoke(app, ["benchmark", "--check", name])
    assert done.exit_code == code, done.output
    assert word in " ".join(done.output.split())


def test_only_the_oracle_gets_the_simulator(own):
    (own / "peeking.py").write_text(
        "from twin.sim.oracle import Oracle\n\nclass Peek(Oracle):\n    pass\n"
    )
    with pytest.raises(PredictorError, match="only the oracle"):
        predictor_class("peeking:Peek")
