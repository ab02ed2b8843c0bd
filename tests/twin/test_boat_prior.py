"""A boat's own prior: how runs are combined, its file, and what it is worth."""

import dataclasses
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin import Log, Particulars, Twin, known_plan
from twin.benchmark.scores import Reference
from twin.boat_prior import LOAD_SD_SHARE, BoatPrior, BoatPriorError, combine
from twin.model.priors import PriorError
from twin.particulars import ParticularsError
from twin.predictors.base import Predictor
from twin.predictors.own_prior import prior_note, prior_of_runs
from twin.sim.bridge import particulars_of, simulate
from twin.sim.recorded import read_run
from usv_gym import SeaState, Vessel

SHARED = Path(
    os.environ.get("USV_TWIN_SHARED") or Path(__file__).resolve().parents[2].parent / "shared"
)


def widths(cov: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return variances along the principal directions, in units of the bound's."""
    root = np.linalg.cholesky(bound)
    return np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, cov).T))


def random_cov(rng: np.random.Generator, p: int) -> np.ndarray:
    A = rng.standard_normal((p, p))
    return A @ A.T + 0.1 * np.eye(p)


# ------------------------------------------------- combination


@pytest.mark.parametrize("seed", range(20))
def test_combined_prior_is_nowhere_wider_than_the_population(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, K = int(rng.integers(1, 7)), int(rng.integers(1, 6))
    population = rng.standard_normal(p), random_cov(rng, p)
    runs = [
        (
            rng.standard_normal(p) * 10.0 ** rng.uniform(-2, 3),
            random_cov(rng, p) * rng.uniform(0, 3),
        )
        for _ in range(K)
    ]
    mean, cov = combine(population, runs)
    assert np.isfinite(mean).all() and np.array_equal(cov, cov.T)
    found = widths(cov, population[1])
    assert found.min() > 0.0 and found.max() <= 1.0 + 1e-9


def test_what_no_run_showed_stays_as_in_the_population() -> None:
    population = np.array([1.0, -2.0]), np.diag([0.25, 4.0])
    run = np.array([1.5, -2.0]), np.diag([0.0025, 4.0])
    mean, cov = combine(population, [run, run, run])
    assert mean[1] == pytest.approx(-2.0) and cov[1, 1] == pytest.approx(4.0)
    assert mean[0] == pytest.approx(1.5, abs=0.02)
    assert 0.0025 + (LOAD_SD_SHARE * 1.5) ** 2 < cov[0, 0] < 0.25


def test_runs_that_differ_leave_the_prior_wide() -> None:
    population = np.zeros(1), np.ones((1, 1))
    narrow = np.full((1, 1), 1e-4)
    same = combine(population, [(np.array([0.5]), narrow)] * 4)
    apart = combine(population, [(np.array([v]), narrow) for v in (0.1, 0.9, 0.2, 0.8)])
    assert same[0][0] == pytest.approx(0.5, abs=0.05)
    assert apart[0][0] == pytest.approx(0.5, abs=0.05)
    assert apart[1][0, 0] > 2.0 * same[1][0, 0] and apart[1][0, 0] > 0.16  # their own variance
    # more runs that agree are surer than one
    assert same[1][0, 0] < combine(population, [(np.array([0.5]), narrow)])[1][0, 0]


# ------------------------------------------------- file and particulars


@pytest.fixture(scope="module")
def boat() -> Particulars:
    return dataclasses.replace(particulars_of(Vessel.load("usv75")), design="")


@pytest.fixture(scope="module")
def log() -> Log:
    vessel = Vessel.load("usv75")
    return simulate(
        "zigzag", vessel=vessel, sea=SeaState.named("1"), duration=60.0, seed=2
    ).without_truth()


@pytest.fixture(scope="module")
def prior(boat: Particulars, log: Log) -> BoatPrior:
    twin = Twin(boat)
    twin.run(log)
    return prior_of_runs([twin.predictor])


def test_file_and_particulars_keep_every_bit(
    tmp_path: Path, prior: BoatPrior, boat: Particulars
) -> None:
    (tmp_path / "boat.prior").write_text(prior.file_text(), encoding="utf-8")
    assert BoatPrior.load(tmp_path / "boat.prior") == prior
    assert "E_north" not in prior.parameters and "N_0" not in prior.parameters
    own = dataclasses.replace(boat, prior=prior)
    (tmp_path / "inline.toml").write_text(own.to_toml(), encoding="utf-8")
    assert Particulars.load(tmp_path / "inline.toml") == own
    # the path counts from the file's folder
    text = boat.to_toml().replace("[particulars]", '[particulars]\nprior = "boat.prior"')
    (tmp_path / "boat.toml").write_text(text, encoding="utf-8")
    assert Particulars.load(tmp_path / "boat.toml") == own
    (tmp_path / "boat.prior").unlink()
    with pytest.raises(ParticularsError, match=r"boat\.toml.*boat\.prior: cannot be read"):
        Particulars.load(tmp_path / "boat.toml")


def test_priors_of_other_boats_are_refused(
    tmp_path: Path, prior: BoatPrior, boat: Particulars
) -> None:
    for change, words in (
        ({"length": 2.0 * boat.length}, "correct length"),
        ({"mass": 2.0 * boat.mass}, "correct mass"),
        ({"beam": 0.8 * boat.beam}, "correct beam"),
        ({"steering": "differential"}, "correct steering"),
        ({"shaft_speed": 60.0 * boat.shaft_speed}, "keep the ratio"),
    ):
        with pytest.raises(ParticularsError, match=words):
            dataclasses.replace(boat, prior=prior, **change)
    dataclasses.replace(boat, prior=prior, mass=1.2 * boat.mass)  # loaded
    path = tmp_path / "x.prior"
    good = prior.file_text()
    for text, words in (
        ("[particulars]", "has no format"),
        ("= 3", "not valid TOML"),
        (good.replace("runs = 1", "runs = 0"), "runs = 0 must be"),
        (good.replace("runs = 1", "runs = 1\nmore = 2"), "missing or unknown: more"),
        (good.replace('"X_u", ', "", 1), "parameters need"),
        (good.replace("mean = [", "mean = [nan, ", 1), "shapes"),
        (re.sub(r"(?m)^speed = .*", "speed = 1e-308", good), "speed = 1e-308 must be"),
        (re.sub(r"(?m)^mean = \[[^,]*", "mean = [nan", good), "finite"),
        (good.replace("  [", "  [-", 1), "variances above 0"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(BoatPriorError, match=words) as caught:
            BoatPrior.load(path)
        assert str(path) in str(caught.value)


def test_priors_of_no_such_model_are_refused(prior: BoatPrior, boat: Particulars) -> None:
    names = ("X_odd", *prior.parameters[1:])
    for change, words in (
        ({"model": "other"}, "not one of paper, mmg"),
        ({"parameters": names}, "'X_odd'"),
        ({"mean": (1e6, *prior.mean[1:])}, "X_u = 1e"),
    ):
        wrong = dataclasses.replace(prior, **change)
        with pytest.raises(PriorError, match=words):
            Twin(dataclasses.replace(boat, prior=wrong))
    with pytest.raises(ParticularsError, match=r"BoatPrior\.load"):
        dataclasses.replace(boat, prior="boat.prior")  # type: ignore[arg-type]


def test_saved_twins_need_no_prior_file(
    tmp_path: Path, prior: BoatPrior, boat: Particulars, log: Log
) -> None:
    twin = Twin(dataclasses.replace(boat, prior=prior))
    twin.save(tmp_path / "boat.twin")
    later = Twin.load(tmp_path / "boat.twin")
    assert later.particulars == twin.particulars
    for one in (twin, later):
        one.run(log)
    np.testing.assert_array_equal(twin.estimate().params, later.estimate().params)


def test_only_models_of_the_same_structure_use_it(prior: BoatPrior, boat: Particulars) -> None:
    own = dataclasses.replace(boat, prior=prior)

    cases: list[tuple[str, dict[str, Any], bool]] = [
        ("dsw-ukf-plus", {}, True),
        ("ukf", {"model": "mmg"}, True),
        ("ukf", {}, False),
        ("dsw-ukf", {}, False),
    ]
    for name, options, used in cases:
        twin, plain = Twin(own, name, **options), Twin(boat, name, **options)
        assert (prior_note(twin.predictor, name) == "") is used, name
        assert np.array_equal(twin.estimate().params, plain.estimate().params) != used
        assert prior_note(plain.predictor, name) == ""
    assert "ukf:model=mmg" in prior_note(Twin(own, "ukf").predictor, "ukf")


def test_runs_of_other_boats_or_with_a_prior_are_refused(
    prior: BoatPrior, boat: Particulars, log: Log
) -> None:
    def run(about: Particulars, name: str = "dsw-ukf-plus") -> Predictor:
        twin = Twin(about, name)
        for row in list(log)[:100]:
            twin.step(*row)
        return twin.predictor

    good = run(boat)
    other = dataclasses.replace(boat, length=1.1 * boat.length)
    for bad, words in (
        (run(other), "length"),
        (run(boat, "ukf"), "use one model"),
        (run(dataclasses.replace(boat, prior=prior)), "count twice"),
        (Twin(boat).predictor, "says nothing"),
    ):
        with pytest.raises(BoatPriorError, match=words):
            prior_of_runs([good, bad])
    with pytest.raises(BoatPriorError, match="at least one"):
        prior_of_runs([])
    with pytest.raises(BoatPriorError, match="no parameters"):
        prior_of_runs([Twin(boat, "persistence").predictor])


# ------------------------------------------------- what it is worth


def squares(twin: Twin, log: Log, begin: float, every: float) -> np.ndarray:
    """Run a twin over a log; return the mean squares at 10 s of displacement and heading."""
    reference, next_at, found = Reference(log), float(log.t[0]) + begin, []
    dt = min(max(log.dt, 0.02), 0.25)
    for k, (t, z, cmd) in enumerate(log):
        twin.step(t, z, cmd)
        times = np.array([t, t + 10.0])
        if t < next_at - 1e-9 or t > log.t[-1] - 10.0:
            continue
        next_at += every
        if not reference.known(times):
            continue
        truth = reference.at(times)
        mean = twin.predictor.mean(known_plan(log, k, 10.0, dt), dt)[-1]
        off = (mean[:2] - twin.estimate().state[:2]) - (truth[1, :2] - truth[0, :2])
        turn = (mean[2] - truth[1, 2] + np.pi) % (2.0 * np.pi) - np.pi
        found.append((off @ off, turn * turn))
    return np.mean(found, axis=0)


def test_two_runs_make_the_third_begin_better() -> None:
    """Boats that vary by 30 %, main particulars known; the first half minute of the third run."""
    ratios, sea = [], SeaState(hs=0.3, wind=3.0)
    for seed in range(6):
        vessel = Vessel.load("usv75").varied(np.random.default_rng(seed), 0.3)
        about = dataclasses.replace(particulars_of(vessel), design="")
        ran = []
        for k in range(2):
            twin = Twin(about)
            log = simulate("random", vessel=vessel, sea=sea, duration=90.0, seed=100 * k + seed)
            twin.run(log.without_truth())
            ran.append(twin.predictor)
        own = dataclasses.replace(about, prior=prior_of_runs(ran))
        third = simulate("zigzag", vessel=vessel, sea=sea, duration=45.0, seed=300 + seed)
        scores = [np.sqrt(squares(Twin(boat), third, 5.0, 1.0)) for boat in (own, about)]
        ratios.append(scores[0] / scores[1])
    median = np.median(ratios, axis=0)
    assert (median < 0.9).all(), ratios


@pytest.mark.parametrize(
    ("folder", "predictor", "few"),
    [
        ("kvlcc2_simman2008", "ukf", None),
        pytest.param("kvlcc2_simman2008", "dsw-ukf-plus", None, marks=pytest.mark.slow),
        pytest.param("esso_osaka_frt", "ukf", "berthing", marks=pytest.mark.slow),
        pytest.param("esso_osaka_frt", "dsw-ukf-plus", "berthing", marks=pytest.mark.slow),
    ],
)
def test_other_runs_of_a_tanker_are_worth_a_prior(
    folder: str, predictor: str, few: str | None
) -> None:
    """Leave one run out: RMSE at 10 s over that without a prior, geometric mean of the runs."""
    path = SHARED / "data" / folder
    if not path.is_dir():
        pytest.skip(f"{path} is not here: recorded runs are no part of the project")
    files = [f for f in path.glob("*.csv.gz") if not f.name.startswith(("turn_cut", few or "-"))]
    names = sorted(map(str, files))
    runs, ran, before = {}, {}, {}
    for name in names:
        log, about = runs[name] = read_run(name)
        twin = Twin(about, predictor)
        before[name] = squares(twin, log, min(60.0, 0.4 * (log.t[-1] - log.t[0])), 5.0)
        ran[name] = twin.predictor
    logs = []
    for name, (log, about) in runs.items():
        prior = prior_of_runs([ran[other] for other in names if other != name])
        twin = Twin(dataclasses.replace(about, prior=prior), predictor)
        after = squares(twin, log, min(60.0, 0.4 * (log.t[-1] - log.t[0])), 5.0)
        logs.append(0.5 * np.log(after / before[name]))
    ratio = np.exp(np.mean(logs, axis=0))
    assert (ratio < 1.0).all(), ratio
