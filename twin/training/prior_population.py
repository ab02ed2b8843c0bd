"""Priors of the twin's parameters, from populations of random boats in calm water.

Each boat is a first draft from main particulars (``usv_gym.design.new_vessel``) with random
coefficients (``Vessel.varied``). It makes steps of throttle and steering, and the twin's model
is fitted to what it does. Everything is counted in lengths and in the time that the boat takes
to sail one, so that a population serves boats of every size.

Source: docs/explanation/twin.md, The refit.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from twin.identification.prediction_error import (
    ACT,
    COLUMNS,
    GOOD,
    LOW,
    MIDDLE,
    STATE,
    WIND,
    RefitSettings,
)
from twin.identification.segments import Segments
from twin.model.dynamics import model_of
from twin.model.priors import KINDS, TANKER, Prior, PriorError
from twin.model.rollout import (
    GRID,
    Paths,
    RolloutConfig,
    RolloutStart,
    Waves,
    rollout,
    rollout_size,
)
from twin.model.structure import (
    COS,
    COS_TWICE,
    MINUS_SIN,
    ONE,
    SIN,
    SIN_TWICE,
    UNEQUAL_THRUSTERS,
    WIND_N,
    WIND_X,
    WIND_Y,
    Structure,
)
from twin.particulars import DESIGNS, STUDY_LENGTH, STUDY_SPEED, Particulars
from twin.sim.bridge import TRUE_STATE, particulars_of
from usv_gym.design.new_vessel import MainParticulars, design
from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel, state_at

__all__ = [
    "CalmRun",
    "fit_member",
    "make_prior",
    "nominal",
    "project",
    "random_boat",
    "rolled",
    "sail_calm",
    "sample_from_class",
    "sample_like",
]

Array = NDArray[np.float64]

LENGTH_TIME = STUDY_LENGTH / STUDY_SPEED
"""Time in which the study boat moves by its length, s. The clock of a run is scaled so that every
boat takes as long, and the times below hold for all."""

SPAN, ROW = 150.0, GRID
"""Length of a run, and of one of its rows, s."""

STEPS = 6
"""Integration steps of the boat in a row; even."""

HORIZON, STRIDE = 20, 20
"""Rows that the fit looks ahead, and rows between its starts."""

NEAR = 4
"""Rows that a first fit looks ahead."""

ERROR_SD = np.array(
    [
        *(0.35 / STUDY_LENGTH, 0.35 / STUDY_LENGTH, 0.04),
        *(0.2 / STUDY_SPEED, 0.2 / STUDY_SPEED, 0.025 * LENGTH_TIME),
    ]
)
"""Errors of equal weight in the fit: of x, y, psi, u, v, r; lengths, rad, speeds."""

LARGEST_ERROR = np.array([1.0 / STUDY_SPEED, 1.0 / STUDY_SPEED, 0.3 * LENGTH_TIME])
"""Root mean square errors of u, v, r above which a boat is left out."""

FINE = 1e-4
"""Relative change of the sum of squares at which a fit ends: far below what a boat differs."""

SEED, DRAWN = 0, 140
"""Of the populations that ship."""

SPREAD, BUILT = 0.30, 0.05
"""Standard deviation of the boats' coefficients, and of their geometry and inertia."""

CLASS = 0.15
"""The same of the coefficients of one class."""

BIAS = 0.20
"""Standard deviation of the errors of the coefficients of a class's model."""

MEASURED = "kvlcc2_l7"
"""The vessel around which tankers are sampled."""

LARGEST_HELM = math.radians(25.0)


@dataclass(frozen=True, eq=False)
class CalmRun:
    """A run in calm water with a scaled clock; rows are :data:`ROW` apart."""

    particulars: Particulars  # of the boat, in the time unit of the run
    states: Array  # (N + 1, 6): x, y (m), psi (rad), u, v (m/s), r (rad/s)
    actuators: Array  # (N + 1, 4): shaft speeds (rev/s) and angles (rad)
    between: Array  # (N, 4): actuators half a row after row k
    commands: Array  # (N, 4): row k is in force from row k to row k + 1 of the states


def sail_calm(vessel: Vessel, rng: np.random.Generator, n: float | None = None) -> CalmRun:
    """Sail random steps of throttle (0.7 to 1) and helm in calm water.

    ``n`` is the nominal shaft speed, rev/s; the vessel's for manoeuvring if left out.
    """
    n = vessel.values["shaft_speed_manoeuvring"] if n is None else n
    speed = vessel.straight_speed(n)
    true = dataclasses.replace(particulars_of(vessel), speed=speed, shaft_speed=n)
    slow = true.time_scale
    rows = round(SPAN / ROW)
    t = ROW * np.arange(rows)
    throttle, helm = np.ones(rows), np.zeros(rows)
    largest, begin = min(LARGEST_HELM, vessel.helm_max), 5.0
    while begin < SPAN:
        throttle[t >= begin], helm[t >= begin] = rng.uniform(0.7, 1.0), rng.uniform(-1, 1) * largest
        begin += rng.uniform(3.0, 10.0)
    commands = vessel.command(n * throttle, helm)
    states = np.empty((rows * STEPS + 1, fr.STATE_SIZE))
    states[0] = state_at(vessel, n, speed)
    ship.sail(
        states,
        np.repeat(commands, STEPS, axis=0),
        ship.Ship(vessel.packed, 3),
        ship.calm_sea(),
        slow * ROW / STEPS,
        np.zeros((ship.WORK_ROWS, fr.STATE_SIZE)),
    )
    shown = states[::STEPS]
    clock = np.array([1.0, 1.0, 1.0, slow, slow, slow])
    shafts = np.array([slow, slow, 1.0, 1.0])
    return CalmRun(
        particulars=dataclasses.replace(
            true,
            speed=slow * speed,
            shaft_speed=slow * n,
            shaft_lag=true.shaft_lag / slow,
            steer_lag=true.steer_lag / slow,
            steer_rate=slow * true.steer_rate,
        ),
        states=shown[:, TRUE_STATE] * clock,
        actuators=shown[:, fr.N_LEFT :] * shafts,
        between=states[STEPS // 2 :: STEPS, fr.N_LEFT :] * shafts,
        commands=commands * shafts,
    )


def rolled(
    structure: Structure, xi: Array, run: CalmRun, horizon: int = HORIZON, stride: int = STRIDE
) -> Array:
    """Return the errors (starts, horizon, 6) of the model's predictions from many rows of a run.

    They are of x, y (lengths), psi (rad), u, v (typical speeds), r (typical speeds over length).
    ``horizon`` and ``stride`` are rows to look ahead, and between starts.
    """
    about = run.particulars
    lags = np.array([about.shaft_lag, about.steer_lag, about.steer_rate])
    turn = about.speed / about.length
    envelope = np.array([4.0 * about.speed, 4.0 * about.speed, 8.0 * turn])
    units = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    actuators, plan = run.actuators * units, run.commands * units
    config, none = RolloutConfig(lags, envelope, structure.terms), Waves(np.zeros((1, 0, 3)), 0.0)
    still, out_act, work = np.zeros(2), np.empty((horizon, 4)), np.zeros(rollout_size())
    starts = range(0, len(plan) - horizon + 1, stride)
    errors = np.empty((len(starts), horizon, 6))
    for out, k in zip(errors, starts, strict=True):
        start = RolloutStart(run.states[k : k + 1], xi[None], actuators[k], still)
        paths = Paths(out[None], out_act)
        rollout(start, plan[k : k + horizon], ROW, config, none, paths, work)
        out -= run.states[k + 1 : k + 1 + horizon]
    errors /= np.array([about.length, about.length, 1.0, about.speed, about.speed, turn])
    return errors


def _shown(structure: Structure) -> Any:
    """Return which parameters calm water can show: no wind, no biases, no unequal thrusters."""
    hidden = (COS, SIN, MINUS_SIN, COS_TWICE, SIN_TWICE, ONE, WIND_X, WIND_Y, WIND_N)
    unequal = [name in UNEQUAL_THRUSTERS for name in structure.parameters]
    return ~np.isin(structure.terms.which, hidden).any(axis=0) & ~np.array(unequal)


def _window(structure: Structure, run: CalmRun) -> Array:
    """Return a run as rows of ``twin.identification.prediction_error``."""
    shafts = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    rows = np.zeros((len(run.states), COLUMNS))
    rows[:, STATE:LOW], rows[:, LOW:WIND], rows[:, GOOD] = run.states, run.states[:, 3:], 1.0
    rows[:, ACT:MIDDLE] = run.actuators * shafts
    rows[:-1, MIDDLE:] = run.between * shafts
    return rows


def project(structure: Structure, runs: Sequence[CalmRun]) -> tuple[Array, Array]:
    """Return the SI parameters (p,) that predict a boat's runs best, and the RMS errors (3,).

    The refit of :mod:`twin.identification.prediction_error` without waves. The structure's own
    mean and standard deviation decide where the runs show little. Errors are of u, v (typical
    speeds) and r (typical speeds over length).
    """
    # parameters that calm water does not show keep their prior means
    sd = np.where(_shown(structure), structure.sd, 1e-6 * structure.sd)
    about = runs[0].particulars
    turn = about.speed / about.length
    units = np.array([about.length, about.length, 1.0, about.speed, about.speed, turn])
    settings = RefitSettings(
        span=SPAN,
        spacing=ROW * STRIDE,
        horizon=ROW * HORIZON,
        every=2,
        sd=ERROR_SD * units,
        # no waves
        offset_sd=1e-6 * units[3:],
        scale=1.0,
        knee=1e9,
    )
    windows = [_window(structure, run) for run in runs]
    rows = np.concatenate(windows)
    starts = [
        sum(map(len, windows[:i])) + k
        for i, window in enumerate(windows)
        for k in range(0, len(window) - HORIZON, STRIDE)
    ]
    xi = structure.mean
    # errors one second ahead are nearly linear in the parameters: a safe start for the long horizon
    for horizon in (NEAR, HORIZON):
        ahead = dataclasses.replace(settings, horizon=ROW * horizon)
        segments = Segments(structure.terms, structure.mean, np.diag(sd**2), ahead, len(starts))
        segments.params[:] = xi
        for start in starts:
            segments.add(start, rows, xi)
        segments.fit(rows, tolerance=FINE)
        xi = segments.params
    final = np.concatenate([rolled(structure, xi, run) for run in runs])
    return xi, np.sqrt(np.mean(final[:, :, 3:] ** 2, axis=(0, 1)))


def _drafted(kind: str, rng: np.random.Generator, **particulars: Any) -> tuple[Vessel, float]:
    """Return a boat around the first draft of main particulars, and its nominal shaft speed."""
    propulsion = {
        "drives": "steerable_drive",
        "rudder": "propeller_rudder",
        "differential": "thruster_pair",
    }
    draft = design(MainParticulars(name=kind, kind=propulsion[kind], **particulars)).vessel
    # N_v is overestimated for broad and fine hulls: its regression is of slender ones
    part = rng.uniform(0.2, 1.0) if kind == "drives" else 1.0
    values = {**draft.values, "N_v": part * draft.values["N_v"]}
    vessel = dataclasses.replace(draft, values=values)
    return vessel.varied(rng, SPREAD, BUILT), vessel.values["shaft_speed_service"]


# length (m), length over beam, beam over draft, block coefficient, Froude number: from ... to
_RANGES = {
    "drives": ((4.0, 12.0), (2.2, 4.0), (3.5, 6.5), (0.33, 0.50), (0.35, 1.1)),
    "rudder": ((2.0, 200.0), (4.5, 7.5), (2.2, 4.0), (0.50, 0.85), (0.08, 0.30)),
    "differential": ((1.0, 6.0), (1.8, 4.0), (3.0, 7.0), (0.35, 0.70), (0.10, 0.40)),
}


def random_boat(kind: str, rng: np.random.Generator) -> tuple[Vessel, float]:
    """Return a random boat of a kind, and its nominal shaft speed in rev/s.

    A kind is one of ``twin.model.priors.KINDS``, ``twin.model.priors.TANKER``, or a class of
    ``twin.particulars.DESIGNS``.
    """
    if kind == TANKER:
        return sample_from_class(Vessel.load(MEASURED), rng, SPREAD)
    if kind in DESIGNS:
        return sample_from_class(nominal(kind), rng, SPREAD)
    if kind not in KINDS:
        known = ", ".join((*KINDS, TANKER, *DESIGNS))
        raise PriorError(f"kind = {kind!r}: must be one of {known}")
    (small, large), *shares = _RANGES[kind]
    length = small * (large / small) ** rng.random()
    slender, flat, block, froude = (rng.uniform(*share) for share in shares)
    beam = length / slender
    return _drafted(
        kind,
        rng,
        length=length,
        beam=beam,
        draft=beam / flat,
        mass=1025.0 * block * length * beam * beam / flat,
        speed=froude * math.sqrt(GRAVITY * length),
    )


def sample_like(
    particulars: Particulars, kind: str, rng: np.random.Generator
) -> tuple[Vessel, float]:
    """Return a random boat of given main particulars, and its nominal shaft speed in rev/s.

    Length, beam, draft, mass and typical speed are used; the coefficients are drawn.
    """
    keys = ("length", "beam", "draft", "mass", "speed")
    return _drafted(kind, rng, **{key: getattr(particulars, key) for key in keys})


@functools.cache
def nominal(name: str) -> Vessel:
    """Return the package's model of a class as known before any data: with coefficient errors.

    Simulated boats vary around the vessel of the package; of a real class that is not known. So
    each coefficient gets a random error, by :data:`BIAS`.

    Source: docs/explanation/twin.md, The refit.
    """
    # a seed that no boat has
    return Vessel.load(name).varied(np.random.default_rng((SEED, DRAWN)), BIAS, BUILT)


def sample_from_class(
    vessel: Vessel, rng: np.random.Generator, spread: float = CLASS
) -> tuple[Vessel, float]:
    """Return a random boat of a vessel's class, and its nominal shaft speed in rev/s.

    A model of the class tells more than main particulars. For a class of your own::

        draw = functools.partial(sample_from_class, Vessel.load("my_class.toml"))
        prior = make_prior("mmg", "drives", draw).of(model_of(particulars, "mmg", biased=True))
        twin = Twin(particulars, prior=prior)

    Parameters
    ----------
    vessel : Vessel
        The class.
    rng : numpy.random.Generator
        Draws the coefficients.
    spread : float
        How different the boats of a class are, as a share.
    """
    return vessel.varied(rng, spread, BUILT), vessel.values["shaft_speed_manoeuvring"]


Draw = Callable[[np.random.Generator], tuple[Vessel, float]]


def fit_member(
    model: str, kind: str, draw: Draw, seed: int, i: int
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the i-th boat of a population: its parameters (p,), their errors (3,) and names.

    The parameters are those that calm water shows, dimensionless; errors as in :func:`project`.
    """
    rng = np.random.default_rng((seed, i))
    vessel, n = draw(rng)
    run = sail_calm(vessel, rng, n)
    # in the time unit of the run no ship is slow
    structure = model_of(run.particulars, model, tanker=kind == TANKER)
    xi, error = project(structure, [run])
    shown = _shown(structure)
    names = tuple(np.array(structure.parameters)[shown].tolist())
    return (xi / structure.scales)[shown], error, names


def make_prior(
    model: str,
    kind: str,
    draw: Draw | None = None,
    *,
    drawn: int = DRAWN,
    seed: int = SEED,
    workers: int = 1,
) -> Prior:
    """Draw a population, fit the model to each boat, and return what they have in common.

    ``draw`` goes from a generator to a boat and its nominal shaft speed; :func:`random_boat` of the
    kind if left out. Of the ``drawn`` boats, those that the model does not fit are left out.
    PriorError: it does not fit half of them. The result does not depend on ``workers``.
    """
    draw = draw or functools.partial(random_boat, kind)
    found = Parallel(n_jobs=workers)(
        delayed(fit_member)(model, kind, draw, seed, i) for i in range(drawn)
    )
    fitted = [i for i, fit in enumerate(found) if np.all(fit[1] <= LARGEST_ERROR)]
    if len(fitted) < max(2, drawn // 2):
        raise PriorError(
            f"the model {model!r} fits {len(fitted)} of {drawn} boats; take another model, or draw "
            "other boats"
        )
    what = f"kind {kind}"
    if kind in DESIGNS:
        what = f"class {kind}, around a model with errors of {BIAS:.0%}"
    return Prior(
        about=f"model {model}, {what}, seed {seed}, {drawn} boats drawn; {__name__}",
        parameters=found[0][2],
        boats=np.array(fitted),
        fits=np.array([found[i][0] for i in fitted]),
    )
