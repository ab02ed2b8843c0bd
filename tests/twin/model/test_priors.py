"""The priors that come with the package, and the script that makes them."""

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
from usv_gym import Vessel

EACH = pytest.mark.parametrize(
    ("model", "kind"), [(m, k) for m in MODELS for k in (*KINDS, TANKER, *DESIGNS)]
)
CALM_BLIND = {
    *UNEQUAL_THRUSTERS,
    *("E_north", "E_east", "X_w", "Y_w", "N_w"),
    *("N_0", "N_cos", "N_sin", "N_cos2", "N_sin2"),
}


@pytest.fixture
def population(monkeypatch: pytest.MonkeyPatch):
    """The script that makes the priors."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[3] / "examples/priors")
    import population

    return population


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


@EACH
def test_shipped_boats_are_what_the_script_makes(population, model: str, kind: str) -> None:
    prior = shipped_prior(model, kind)
    # other processors may end a fit a step apart, and files hold six digits
    apart = 0.02 * prior.fits.std(axis=0) + 1e-5 * (1.0 + np.abs(prior.fits).max(axis=0))
    draw = functools.partial(population.random_boat, kind)
    fit, error, names = population.fit_member(model, kind, draw, int(prior.boats[0]))
    assert names == prior.parameters
    assert np.all(error <= population.LARGEST_ERROR)
    assert np.all(np.abs(fit - prior.fits[0]) < apart)


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
    with pytest.raises(PriorError, match="X_u"):
        shipped_prior("mmg", "drives").of(structure_of_kind("paper", "drives"))


@pytest.mark.parametrize(
    "text", ["", "# a\nboat,X\n0,nan\n", "# a\nboat,X\n0,1,2\n", "# a\nboat\n"]
)
def test_damaged_prior_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(PriorError, match=r"bad\.csv: is no prior"):
        Prior.load(path)


def test_a_prior_survives_its_file(tmp_path: Path) -> None:
    prior, path = shipped_prior("mmg", "drives"), tmp_path / "prior.csv"
    path.write_text(prior.to_csv(), encoding="utf-8")
    again = Prior.load(path)
    assert (again.about, again.parameters) == (prior.about, prior.parameters)
    np.testing.assert_allclose(again.fits, prior.fits, rtol=5e-6)  # six digits
