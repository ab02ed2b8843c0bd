"""Populations of boats, and the priors that come with the package."""

from __future__ import annotations

import dataclasses
import functools
import math
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from twin.model.dynamics import model_of
from twin.model.priors import (
    KINDS,
    TANKER,
    Prior,
    PriorError,
    kind_of,
    population_prior,
    shipped_prior,
)
from twin.model.structure import MODELS, UNEQUAL_THRUSTERS, Structure
from twin.particulars import DESIGNS, Particulars
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.sim.bridge import particulars_of
from twin.training import prior_population as pop
from usv_gym import Vessel
from usv_gym.vessel.vessel import course_eigenvalues

EACH = pytest.mark.parametrize(
    ("model", "kind"), [(m, k) for m in MODELS for k in (*KINDS, TANKER, *DESIGNS)]
)
CALM_BLIND = {
    *UNEQUAL_THRUSTERS,
    *("E_north", "E_east", "X_w", "Y_w", "N_w"),
    *("N_0", "N_cos", "N_sin", "N_cos2", "N_sin2"),
}


@functools.cache
def run_of(name: str, seed: int = 0) -> pop.CalmRun:
    return pop.sail_calm(Vessel.load(name), np.random.default_rng(seed))


def structure_of_kind(model: str, kind: str) -> Structure:
    known = {"drives": "usv75", "differential": "otter"} | {name: name for name in DESIGNS}
    name = known.get(kind, "kvlcc2_l7")
    boat = particulars_of(Vessel.load(name))
    # fine lines make a rudder ship of a tanker
    boat = dataclasses.replace(boat, mass=0.7 * boat.mass) if kind == "rudder" else boat
    assert kind in (kind_of(boat), boat.design)
    return model_of(boat, model)


# ------------------------------------------------- what ships


@EACH
def test_a_prior_ships_for_each_model_and_kind(model: str, kind: str) -> None:
    prior, structure = shipped_prior(model, kind), structure_of_kind(model, kind)
    assert len(prior.fits) >= 100
    assert set(structure.parameters) - set(prior.parameters) <= CALM_BLIND
    mean, covariance = prior.of(structure)
    sd = np.sqrt(np.diag(covariance))
    np.linalg.cholesky(covariance)
    # far from singular even where left and right propeller always turn at one speed
    assert np.linalg.eigvalsh(covariance / np.outer(sd, sd))[0] > 1e-4
    # what the structure thinks by hand is near: within twelve of the wider spreads
    assert np.all(np.abs(mean - structure.mean) < 12.0 * np.maximum(sd, structure.sd))


def apart(prior: Prior) -> np.ndarray:
    """Return what fits may differ by: other processors may end a fit a step apart.

    Fits end at a relative change of 1e-4, files hold six digits.
    """
    return 0.02 * prior.fits.std(axis=0) + 1e-5 * (1.0 + np.abs(prior.fits).max(axis=0))


@EACH
def test_shipped_boats_are_what_the_function_makes(model: str, kind: str) -> None:
    prior = shipped_prior(model, kind)
    draw = functools.partial(pop.random_boat, kind)
    for row, boat in enumerate(prior.boats[:2]):
        xi, error, names = pop.fit_member(model, kind, draw, pop.SEED, int(boat))
        assert names == prior.parameters
        assert np.all(error <= pop.LARGEST_ERROR)
        assert np.all(np.abs(xi - prior.fits[row]) < apart(prior))


@pytest.mark.slow
@EACH
def test_the_whole_file_is_what_the_function_makes(model: str, kind: str) -> None:
    prior, again = shipped_prior(model, kind), pop.make_prior(model, kind)
    assert again.boats.tolist() == prior.boats.tolist()
    assert again.about == prior.about
    assert np.all(np.abs(again.fits - prior.fits) < apart(prior))


def test_one_file_serves_boats_of_every_size() -> None:
    about = particulars_of(Vessel.load("usv75"))
    # twice as long by Froude: speeds and times sqrt(2), shaft speeds 1 / sqrt(2)
    larger = dataclasses.replace(
        about,
        length=2.0 * about.length,
        speed=math.sqrt(2.0) * about.speed,
        shaft_speed=about.shaft_speed / math.sqrt(2.0),
    )
    assert kind_of(about) == kind_of(larger) == "drives"
    scaled = []
    for boat in (about, larger):
        structure = model_of(boat, "paper")
        mean, covariance = population_prior(structure, boat)
        scaled.append((mean / structure.scales, np.sqrt(np.diag(covariance)) / structure.scales))
    np.testing.assert_allclose(scaled[0], scaled[1], rtol=1e-12)


def test_kinds_of_the_shipped_boats() -> None:
    kinds = {name: kind_of(particulars_of(Vessel.load(name))) for name in ("kvlcc2", "otter")}
    assert kinds == {"kvlcc2": TANKER, "otter": "differential"}


# ------------------------------------------------- the class of a boat


def prior_mean(boat: Particulars) -> np.ndarray:
    return population_prior(model_of(boat, "mmg", biased=True), boat)[0]


def test_boat_of_a_known_class_gets_its_prior() -> None:
    usv75 = Vessel.load("usv75")
    for vessel in (usv75, usv75.varied(np.random.default_rng(0))):
        boat = particulars_of(vessel)
        assert boat.design == "usv75"
        structure = model_of(boat, "mmg", biased=True, current=True)
        mean, covariance = population_prior(structure, boat)
        expected = shipped_prior("mmg", "usv75").of(structure)
        np.testing.assert_array_equal(mean, expected[0])
        np.testing.assert_array_equal(covariance, expected[1])
        predictor = PlusPredictor(boat)
        np.testing.assert_array_equal(predictor.segments.prior, mean)


def test_prior_without_class_is_wider(tmp_path: Path) -> None:
    own = tmp_path / "usv75.toml"
    own.write_bytes(Path(str(files("usv_gym.vessel") / "vessels" / "usv75.toml")).read_bytes())
    known, alone = (particulars_of(Vessel.load(vessel)) for vessel in ("usv75", own))
    assert alone == dataclasses.replace(known, design="")
    assert not np.array_equal(prior_mean(known), prior_mean(alone))
    variances = [np.diag(population_prior(model_of(b, "mmg"), b)[1]) for b in (known, alone)]
    shown = variances[0] != variances[1]
    # measured: 0.48
    assert np.exp(np.mean(np.log((variances[0] / variances[1])[shown]))) < 0.6


@pytest.mark.parametrize("name", ["telemetron", "kvlcc2_l7", "otter"])
def test_class_without_prior_is_ignored(name: str) -> None:
    vessel = Vessel.load(name)
    boat = particulars_of(vessel)
    assert (vessel.design, boat.design) == (name, "")


def test_model_of_a_class_has_errors() -> None:
    """Benchmarks vary the vessel itself: a prior around it would hold the answer."""
    nominal, vessel = pop.nominal("usv75"), Vessel.load("usv75")
    ratios = np.array([nominal.values[k] / value for k, value in vessel.values.items() if value])
    # 20 % of coefficients, 5 % of geometry, and the rest is the same
    off = ratios[np.abs(ratios - 1.0) > 0.1] - 1.0
    assert len(off) >= 10
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.25, abs=0.1)
    assert "errors of 20%" in shipped_prior("mmg", "usv75").about


def test_what_calm_water_does_not_show_stays_as_the_structure_has_it() -> None:
    structure = structure_of_kind("mmg", "drives")
    mean, covariance = shipped_prior("mmg", "drives").of(structure)
    for name in CALM_BLIND:
        k = structure.parameters.index(name)
        assert mean[k] == structure.mean[k]
        expected = np.zeros(len(structure))
        expected[k] = structure.sd[k] ** 2
        assert covariance[k].tolist() == expected.tolist()


def test_a_prior_of_another_model_is_refused() -> None:
    with pytest.raises(PriorError, match="'paper' has not all of X_u"):
        shipped_prior("mmg", "drives").of(structure_of_kind("paper", "drives"))


@pytest.mark.parametrize(
    "text", ["", "# a\nboat,X\n0,nan\n", "# a\nboat,X\n0,1,2\n", "# a\nboat\n"]
)
def test_damaged_prior_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PriorError, match=r"bad\.csv: is no prior .*make_prior"):
        Prior.load(path)


# ------------------------------------------------- how it is made


def test_any_number_of_workers_gives_the_same_population(tmp_path: Path) -> None:
    draw = functools.partial(pop.sample_like, particulars_of(Vessel.load("usv75")), "drives")
    one = pop.make_prior("paper", "drives", draw, drawn=4, seed=5)
    two = pop.make_prior("paper", "drives", draw, drawn=4, seed=5, workers=2)
    assert one.to_csv() == two.to_csv()
    assert not np.allclose(one.fits[0], one.fits[1])
    path = tmp_path / "prior.csv"
    path.write_text(one.to_csv(), encoding="utf-8")
    again = Prior.load(path)
    assert (again.about, again.parameters) == (one.about, one.parameters)
    # six digits
    np.testing.assert_allclose(again.fits, one.fits, rtol=5e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_random_boats_hold_their_course(kind: str) -> None:
    for seed in range(5):
        vessel, n = pop.random_boat(kind, np.random.default_rng(seed))
        assert course_eigenvalues(vessel, n)[0].real <= 0.0
    with pytest.raises(PriorError, match="kind = 'oars': must be one of drives"):
        pop.random_boat("oars", np.random.default_rng(0))


@pytest.mark.parametrize("name", ["usv75", "kvlcc2_l7", "otter"])
def test_states_of_a_run_are_consistent(name: str) -> None:
    run = run_of(name)
    x, _, psi, u, v, r = run.states.T
    # trapezes over rows of a quarter second: curvature leaves some 2 %
    north = u * np.cos(psi) - v * np.sin(psi)
    for rate, way in ((north, x), (r, psi)):
        total = pop.ROW * np.sum(0.5 * (rate[1:] + rate[:-1]))
        assert total == pytest.approx(way[-1] - way[0], rel=0.02, abs=0.02 * np.ptp(way))
    about = run.particulars
    assert about.length / about.speed == pytest.approx(pop.LENGTH_TIME)
    assert u[0] == pytest.approx(about.speed)
    assert run.actuators[0, 0] == pytest.approx(about.shaft_speed)
    assert np.ptp(psi) > 0.3


@pytest.mark.parametrize("model", MODELS)
def test_parameters_of_the_model_itself_are_recovered(model: str) -> None:
    run = run_of("usv75")
    structure = model_of(run.particulars, model)
    truth = pop.project(structure, [run])[0]
    # errors from one start over the whole run: the model's own motion
    own = pop.rolled(structure, truth, run, len(run.commands), len(run.commands))[0]
    about = run.particulars
    turn = about.speed / about.length
    units = np.array([about.length, about.length, 1.0, about.speed, about.speed, turn])
    states = run.states.copy()
    states[1:] += own * units
    twin = dataclasses.replace(run, states=states)
    xi, error = pop.project(structure, [twin])
    # the mean of the structure still pulls a little
    assert np.all(error < 0.3 * pop.project(structure, [run])[1] + 1e-3)
    assert np.max(np.abs(pop.rolled(structure, xi, twin))) < 0.03


def test_fit_predicts_other_runs() -> None:
    structure = model_of(run_of("usv75").particulars, "mmg")
    xi, _ = pop.project(structure, [run_of("usv75")])
    by_hand = pop.rolled(structure, structure.mean, run_of("usv75", 1))
    fitted = pop.rolled(structure, xi, run_of("usv75", 1))
    # measured: 0.06; the bound allows other steps of the helm
    assert np.sqrt(np.mean(fitted**2)) < 0.2 * np.sqrt(np.mean(by_hand**2))


def test_boats_that_the_model_does_not_fit_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pop, "LARGEST_ERROR", np.full(3, 1e-9))
    with pytest.raises(PriorError, match="'paper' fits 0 of 2 boats"):
        pop.make_prior("paper", "drives", drawn=2)


def test_samples_of_a_class_lie_around_its_vessel() -> None:
    vessel, rng = Vessel.load("usv75"), np.random.default_rng(0)
    boats = [pop.sample_from_class(vessel, rng)[0] for _ in range(200)]
    assert pop.sample_from_class(vessel, rng)[1] == vessel.values["shaft_speed_manoeuvring"]
    for key in ("Y_v", "N_r"):
        ratios = np.array([boat.values[key] for boat in boats]) / vessel.values[key]
        # 200 draws know a standard deviation to 5 %; boats that do not hold course are drawn again
        assert np.std(ratios) == pytest.approx(pop.CLASS, rel=0.2)
        assert abs(np.mean(ratios) - 1.0) < 0.05
