"""Priors of the twin's parameters, from populations of random boats in calm water.

Each boat is a first draft from main particulars (``usv_gym.design.new_vessel``) with random
coefficients (``Vessel.varied``). It makes steps of throttle and steering, and the twin's model is
fitted to what it does. Everything is counted in lengths and in the time that the boat takes to sail
one, so that a population serves boats of every size. See docs/explanation/twin.md, The refit.
"""

import dataclasses
import functools
import math

import numpy as np
from joblib import Parallel, delayed

from twin.identification import prediction_error as rows_of
from twin.identification.prediction_error import RefitSettings
from twin.identification.segments import Segments
from twin.model import structure as terms
from twin.model.dynamics import model_of
from twin.model.priors import TANKER, Prior, PriorError
from twin.model.rollout import (
    GRID,
    Paths,
    RolloutConfig,
    RolloutStart,
    Waves,
    rollout,
    rollout_size,
)
from twin.particulars import DESIGNS, STUDY_LENGTH_M, STUDY_SPEED_MPS, Particulars
from twin.sim.bridge import TRUE_STATE, particulars_of
from usv_gym.design.new_vessel import MainParticulars, design
from usv_gym.physics import GRAVITY, ship
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel, state_at

LENGTH_TIME = STUDY_LENGTH_M / STUDY_SPEED_MPS
"""Time in which the study boat moves by its length, s. The clock of a run is scaled so that every
boat takes as long, and the times below hold for all."""

SPAN_S = 150.0  # length of a run
STEPS = 6  # integration steps of the boat in a row of GRID seconds; even
HORIZON, STRIDE = 20, 20  # rows that the fit looks ahead, and rows between its starts
NEAR = 4  # rows that a first fit looks ahead

ERROR_SD = np.array(
    [
        *(0.35 / STUDY_LENGTH_M, 0.35 / STUDY_LENGTH_M, 0.04),
        *(0.2 / STUDY_SPEED_MPS, 0.2 / STUDY_SPEED_MPS, 0.025 * LENGTH_TIME),
    ]
)
"""Errors of equal weight in the fit: of x, y, psi, u, v, r; lengths, rad, speeds."""

LARGEST_ERROR = np.array([1.0 / STUDY_SPEED_MPS, 1.0 / STUDY_SPEED_MPS, 0.3 * LENGTH_TIME])
"""Root mean square errors of u, v, r above which a boat is left out."""

FIT_TOLERANCE = 1e-4  # relative change of the sum of squares at which a fit ends
SEED, DRAWN = 0, 140  # of the populations that ship
SPREAD = 0.30  # standard deviation of the boats' coefficients
BUILT = 0.05  # the same of their geometry and inertia
CLASS_SPREAD = 0.15  # the same of the coefficients within one class
BIAS = 0.20  # the same of the errors of the coefficients of a class's model
LARGEST_HELM = math.radians(25.0)


@dataclasses.dataclass(frozen=True, eq=False)
class CalmRun:
    """A run in calm water with a scaled clock; rows are GRID seconds apart."""

    particulars: Particulars  # of the boat, in the time unit of the run
    states: np.ndarray  # (N + 1, 6): x, y (m), psi (rad), u, v (m/s), r (rad/s)
    actuators: np.ndarray  # (N + 1, 4): shaft speeds (rev/s) and angles (rad)
    between: np.ndarray  # (N, 4): actuators half a row after row k
    commands: np.ndarray  # (N, 4): row k is in force from row k to row k + 1 of the states


def sail_calm(vessel, rng, n):
    """Sail random steps of throttle (0.7 to 1 of ``n``, rev/s) and helm in calm water."""
    speed = vessel.straight_speed(n)
    true = dataclasses.replace(particulars_of(vessel), speed=speed, shaft_speed=n)
    slow = true.time_scale
    rows = round(SPAN_S / GRID)
    t = GRID * np.arange(rows)
    throttle, helm = np.ones(rows), np.zeros(rows)
    largest, begin = min(LARGEST_HELM, vessel.helm_max), 5.0
    while begin < SPAN_S:
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
        slow * GRID / STEPS,
        np.zeros((ship.WORK_ROWS, fr.STATE_SIZE)),
    )
    shafts = np.array([slow, slow, 1.0, 1.0])
    particulars = dataclasses.replace(
        true,
        speed=slow * speed,
        shaft_speed=slow * n,
        shaft_lag=true.shaft_lag / slow,
        steer_lag=true.steer_lag / slow,
        steer_rate=slow * true.steer_rate,
    )
    return CalmRun(
        particulars,
        states[::STEPS, TRUE_STATE] * np.array([1.0, 1.0, 1.0, slow, slow, slow]),
        states[::STEPS, fr.N_LEFT :] * shafts,
        states[STEPS // 2 :: STEPS, fr.N_LEFT :] * shafts,
        commands * shafts,
    )


def errors_of(structure, xi, run):
    """Return the errors (starts, HORIZON, 6) of the model's predictions from many rows of a run.

    They are of x, y (lengths), psi (rad), u, v (typical speeds), r (typical speeds over length).
    """
    about = run.particulars
    lags = np.array([about.shaft_lag, about.steer_lag, about.steer_rate])
    turn = about.speed / about.length
    envelope = np.array([4.0 * about.speed, 4.0 * about.speed, 8.0 * turn])
    units = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    actuators, plan = run.actuators * units, run.commands * units
    config, none = RolloutConfig(lags, envelope, structure.terms), Waves(np.zeros((1, 0, 3)), 0.0)
    out_act, work = np.empty((HORIZON, 4)), np.zeros(rollout_size())
    starts = range(0, len(plan) - HORIZON + 1, STRIDE)
    errors = np.empty((len(starts), HORIZON, 6))
    for out, k in zip(errors, starts, strict=True):
        start = RolloutStart(run.states[k : k + 1], xi[None], actuators[k], np.zeros(2))
        rollout(start, plan[k : k + HORIZON], GRID, config, none, Paths(out[None], out_act), work)
        out -= run.states[k + 1 : k + 1 + HORIZON]
    return errors / np.array([about.length, about.length, 1.0, about.speed, about.speed, turn])


def shown_parameters(structure):
    """Return which parameters calm water can show: no wind, no biases, no unequal thrusters."""
    hidden = (terms.COS, terms.SIN, terms.MINUS_SIN, terms.COS_TWICE, terms.SIN_TWICE, terms.ONE)
    hidden += (terms.WIND_X, terms.WIND_Y, terms.WIND_N)
    unequal = [name in terms.UNEQUAL_THRUSTERS for name in structure.parameters]
    return ~np.isin(structure.terms.which, hidden).any(axis=0) & ~np.array(unequal)


def fit(structure, run):
    """Return the SI parameters (p,) that predict a run best, and the RMS errors (3,).

    The refit of :mod:`twin.identification.prediction_error` without waves. The structure's own
    mean and standard deviation decide where the run shows little. Errors are of u, v (typical
    speeds) and r (typical speeds over length).
    """
    # parameters that calm water does not show keep their prior means
    sd = np.where(shown_parameters(structure), structure.sd, 1e-6 * structure.sd)
    about = run.particulars
    turn = about.speed / about.length
    units = np.array([about.length, about.length, 1.0, about.speed, about.speed, turn])
    settings = RefitSettings(
        span=SPAN_S,
        spacing=GRID * STRIDE,
        horizon=GRID * HORIZON,
        every=2,
        sd=ERROR_SD * units,
        offset_sd=1e-6 * units[3:],  # no waves
        scale=1.0,
        knee=1e9,
    )
    shafts = np.array([structure.n_unit, structure.n_unit, 1.0, 1.0])
    rows = np.zeros((len(run.states), rows_of.COLUMNS))
    rows[:, rows_of.STATE : rows_of.LOW] = run.states
    rows[:, rows_of.LOW : rows_of.WIND] = run.states[:, 3:]
    rows[:, rows_of.GOOD] = 1.0
    rows[:, rows_of.ACT : rows_of.MIDDLE] = run.actuators * shafts
    rows[:-1, rows_of.MIDDLE :] = run.between * shafts
    starts = range(0, len(rows) - HORIZON, STRIDE)
    xi = structure.mean
    # errors one second ahead are nearly linear in the parameters: a safe start for the long horizon
    for horizon in (NEAR, HORIZON):
        ahead = dataclasses.replace(settings, horizon=GRID * horizon)
        segments = Segments(structure.terms, structure.mean, np.diag(sd**2), ahead, len(starts))
        segments.params[:] = xi
        for start in starts:
            segments.add(start, rows, xi)
        segments.fit(rows, tolerance=FIT_TOLERANCE)
        xi = segments.params
    errors = errors_of(structure, xi, run)
    return xi, np.sqrt(np.mean(errors[:, :, 3:] ** 2, axis=(0, 1)))


PROPULSION = {
    "drives": "steerable_drive",
    "rudder": "propeller_rudder",
    "differential": "thruster_pair",
}

RANGES = {
    "drives": ((4.0, 12.0), (2.2, 4.0), (3.5, 6.5), (0.33, 0.50), (0.35, 1.1)),
    "rudder": ((2.0, 200.0), (4.5, 7.5), (2.2, 4.0), (0.50, 0.85), (0.08, 0.30)),
    "differential": ((1.0, 6.0), (1.8, 4.0), (3.0, 7.0), (0.35, 0.70), (0.10, 0.40)),
}
"""Length (m), length over beam, beam over draft, block coefficient, Froude number: from ... to."""


def random_boat(kind, rng):
    """Return a random boat of a kind, and its nominal shaft speed in rev/s.

    A kind is one of ``twin.model.priors.KINDS``, ``twin.model.priors.TANKER`` (boats like the
    KVLCC2), or a class of ``twin.particulars.DESIGNS``.
    """
    if kind == TANKER:
        return boat_of_class(Vessel.load("kvlcc2_l7"), rng, SPREAD)
    if kind in DESIGNS:
        return boat_of_class(nominal(kind), rng, SPREAD)
    (small, large), *shares = RANGES[kind]
    length = small * (large / small) ** rng.random()
    slender, flat, block, froude = (rng.uniform(*share) for share in shares)
    beam = length / slender
    particulars = MainParticulars(
        name=kind,
        kind=PROPULSION[kind],
        length=length,
        beam=beam,
        draft=beam / flat,
        mass=1025.0 * block * length * beam * beam / flat,
        speed=froude * math.sqrt(GRAVITY * length),
    )
    draft = design(particulars).vessel
    # N_v is overestimated for broad and fine hulls: its regression is of slender ones
    part = rng.uniform(0.2, 1.0) if kind == "drives" else 1.0
    draft = dataclasses.replace(draft, values={**draft.values, "N_v": part * draft.values["N_v"]})
    return draft.varied(rng, SPREAD, BUILT), draft.values["shaft_speed_service"]


@functools.cache
def nominal(name):
    """Return the package's model of a class as known before any data: with coefficient errors.

    Simulated boats vary around the vessel of the package; of a real class that is not known. So
    each coefficient gets a random error, by BIAS.
    """
    # a seed that no boat has
    return Vessel.load(name).varied(np.random.default_rng((SEED, DRAWN)), BIAS, BUILT)


def boat_of_class(vessel, rng, spread=CLASS_SPREAD):
    """Return a random boat of a vessel's class, and its nominal shaft speed in rev/s."""
    return vessel.varied(rng, spread, BUILT), vessel.values["shaft_speed_manoeuvring"]


def fit_member(model, kind, draw, i):
    """Return the i-th boat of a population: its parameters (p,), their errors (3,) and names.

    The parameters are those that calm water shows, dimensionless; errors as in :func:`fit`.
    """
    rng = np.random.default_rng((SEED, i))
    vessel, n = draw(rng)
    run = sail_calm(vessel, rng, n)
    # in the time unit of the run no ship is slow
    structure = model_of(run.particulars, model, tanker=kind == TANKER)
    xi, error = fit(structure, run)
    shown = shown_parameters(structure)
    names = tuple(np.array(structure.parameters)[shown].tolist())
    return (xi / structure.scales)[shown], error, names


def make_prior(model, kind, draw=None, drawn=DRAWN, jobs=1):
    """Draw a population, fit the model to each boat, and return what they have in common.

    ``draw`` goes from a generator to a boat and its nominal shaft speed; :func:`random_boat` of the
    kind if left out. Of the ``drawn`` boats, those that the model does not fit are left out.
    """
    draw = draw or functools.partial(random_boat, kind)
    found = Parallel(n_jobs=jobs)(delayed(fit_member)(model, kind, draw, i) for i in range(drawn))
    fitted = [i for i, member in enumerate(found) if np.all(member[1] <= LARGEST_ERROR)]
    if len(fitted) < max(2, drawn // 2):
        raise PriorError(
            f"the model {model!r} fits {len(fitted)} of {drawn} boats; take another model, or draw "
            "other boats"
        )
    what = f"kind {kind}"
    if kind in DESIGNS:
        what = f"class {kind}, around a model with errors of {BIAS:.0%}"
    return Prior(
        about=f"model {model}, {what}, seed {SEED}, {drawn} boats drawn; examples/priors",
        parameters=found[0][2],
        boats=np.array(fitted),
        fits=np.array([found[i][0] for i in fitted]),
    )
