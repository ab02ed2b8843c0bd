"""The paper's DSW-UKF: late fusion, joint UKF, dynamic sliding window.

It is here to be compared with. With the settings that the paper prints, it is no better than 8 s
means of the velocities in a steady turn. Running the window again has no reliable effect. Six seeds
changed the error by -54 to +6 % in the turn and -36 to +53 % in the zigzag. The reference is the
same filter without a window (``window="off"``). Its prediction intervals mean little. In four runs
the position's standard deviation 10 s ahead had medians of 4 and 5, 13 and 55 m. At some moments
the prior of 1 on each of 25 parameters lets the covariance grow to 1e6 m/s, where the arithmetic
stops it. The true sway was inside the 90 % interval in 28 to 94 % of the forecasts. All that is
promised of them is that they are finite and positive definite.

What the paper leaves open is decided in the docstrings below. The pieces that a comparison needs
are options of :class:`DSWPredictor`. Equations carry the numbers that the paper prints beside them;
its text calls Eq 52 "49".

Source: Qu et al. 2025, sections 3.2.2 and 3.2.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.channels import MEASUREMENTS, PSI, U
from twin.checkpoint import (
    State,
    check_fields,
    load_part,
    with_prefix,
)
from twin.filters.late_fusion import DIVERGED_SD, LateFusion
from twin.filters.navigation_ekf import GAP_MAX_S
from twin.filters.navigation_state import sample_limits
from twin.filters.ukf import measurement_update
from twin.identification.dynamic_window import NOISE_FORMS, DynamicWindow, WaveProxy, adapt_noise
from twin.identification.filter_settings import STUDY_STEP_S, FilterSettings
from twin.identification.joint_ukf import (
    accumulate_information,
    advance,
    clip_velocities,
    filter_config,
    filter_state,
    filter_workspace,
    information_is_due,
)
from twin.model.actuators import follow_all
from twin.model.dynamics import N_ACT, drive, model_of, rates_over_ground
from twin.model.structure import N_STATES
from twin.particulars import Particulars
from twin.predictors.ukf import ModelPredictor
from usv_kernel.arrays import alloca_f64
from usv_kernel.errors import UsvTwinError
from usv_kernel.jit import inlined, kernel
from usv_kernel.scalar import wrap

__all__ = [
    "ADAPTED",
    "WINDOWS",
    "DSWPredictor",
    "paper_settings",
]

Array = NDArray[np.float64]

WINDOWS = ("dynamic", "fixed", "off")

ADAPTED = ("Q", "R", "QR")

ROWS_MAX = 100_000
"""Longest window, rows."""

RATED_SHAFT_SPEED = 380.0 / 60.0
"""Rated shaft speed of the paper, rev/s: the unit in which its thrust parameters are sized."""


def paper_settings(
    particulars: Particulars,
    model: str = "paper",
    *,
    x0: ArrayLike = 0.1,
    p0: ArrayLike = 1.0,
    q: ArrayLike = 1e-4,
    r: ArrayLike = 1.0,
    n_unit: float | None = None,
) -> FilterSettings:
    """Return the settings that the paper prints: x0 = 0.1, Q = 1e-4 I, R = I.

    What it does not print is ours: P0 = I, the only one of several that learns, and alpha = 1. A
    small alpha loses ten digits with 31 states. Velocities are held within four times what is
    nominal, without which some runs would overflow.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    model : str
        Structure of the accelerations, see :func:`twin.model.dynamics.model_of`: the paper's
        has p = 25 parameters (Eq 20).
    x0 : float or array_like, shape (p,)
        Parameters at the start, Eq 47.
    p0 : float or array_like, shape (6 + p,)
        Variances at the start, of the six states (x, y, psi, u, v, r) and the parameters.
    q : float or array_like, shape (6,)
        Variances that the states gain in each step of 0.05 s, Eq 50; the parameters gain none.
    r : float or array_like, shape (6,)
        Variances of the measured states, Eq 51.
    n_unit : float, optional
        Factor that brings the shaft speeds of the log to the unit of the model. By default the
        nominal shaft speed becomes the paper's rated 380 rpm = 6.33 rev/s. So x0 = 0.1 means for
        any boat what it meant for theirs. 1 leaves rev/s; 60 is the rpm with which nothing is
        learned.

        Source: Eq (47), (50), (51).
    """
    unit = RATED_SHAFT_SPEED / particulars.shaft_speed if n_unit is None else n_unit
    if not (math.isfinite(unit) and unit > 0.0):
        raise UsvTwinError(f"n_unit = {n_unit} must be a finite number above 0")
    structure = model_of(particulars, model)
    p = len(structure)
    variances = _vector_of("p0", p0, N_STATES + p, positive=True)
    return FilterSettings(
        structure=structure,
        q=_vector_of("q", q, N_STATES, positive=True) / STUDY_STEP_S,
        r=_vector_of("r", r, N_STATES, positive=True),
        p0=variances[:N_STATES],
        q_xi=np.zeros(p),
        xi0=_vector_of("x0", x0, p, positive=False),
        xi0_cov=np.diag(variances[N_STATES:]),
        n_unit=unit,
    )


def _vector_of(name: str, values: ArrayLike, size: int, *, positive: bool) -> Array:
    """Return ``size`` values, one for all or each its own."""
    given = np.asarray(values, dtype=np.float64)
    if given.shape not in ((), (size,)):
        raise UsvTwinError(
            f"{name} has the shape {given.shape}; give one number, or {size} of them"
        )
    if not np.isfinite(given).all() or (positive and (given <= 0.0).any()):
        raise UsvTwinError(f"{name} = {given} must be finite{' and above 0' if positive else ''}")
    return np.array(np.broadcast_to(given, size))


SHAFT_LIMIT = 20.0
ANGLE_LIMIT = 7.0
"""Limits of a valid command: shaft speed in nominal ones, and drive angle in rad."""

RIDGE = 1e-9
"""Share that is added to the variances of a prediction, so that rounding leaves it definite."""

_WIND = MEASUREMENTS.index("wind_mps")
_ACCEL_Y = MEASUREMENTS.index("accel_y_mps2")


class _Filter(NamedTuple):
    """A joint filter, flat."""

    memory: Any  # see FilterState
    config: Any  # see FilterConfig
    model: Any  # ModelTerms
    work: Any  # see FilterWorkspace


class _Ring(NamedTuple):
    """The last rows, in a ring."""

    states: Any  # (M, 6) fused states
    acts: Any  # (M, 4) actuators before the row
    cmds: Any  # (M, 4) commands
    dts: Any  # (M,) times since the row before, s
    innovation: Any  # (2, 6) innovation of the last row, and its expected variances


@kernel
def _rerun(first, count, ring, joint):
    """Run the filter over ``count`` rows of the ring from row ``first`` on."""
    model = joint.model
    state, config = filter_state(joint.memory, model), filter_config(joint.config, model)
    work = filter_workspace(joint.work, model.which.shape[1])
    x, P, size = state.x, state.P, ring.states.shape[0]
    for i in range(N_STATES):
        work.R[i, i] = config.r[i]
        work.mask[i] = 1.0
    for j in range(count):
        row = (first + j) % size
        advance(ring.dts[row], ring.cmds[row], state, config, work)
        for i in range(N_STATES):
            ring.innovation[0, i] = ring.states[row, i] - x[i]
            ring.innovation[1, i] = P[i, i] + config.r[i]
        z = ring.states[row]
        measurement_update(x, P, z, work.mask, work.R, PSI, math.inf, work.sigma)


@inlined
def _start_at(measured, state, config):
    """Start from a measured state (6,); parameters and their covariance go on as they are."""
    x, P = state.x, state.P
    for i in range(N_STATES):
        x[i] = measured[i]
        row = P[i]
        row[:] = 0.0
        P[i, i] = config.p0[i]
    for k in range(N_STATES, x.shape[0]):
        row = P[k]
        for i in range(N_STATES):
            row[i] = 0.0


@kernel
def _use_measured_motion(measured, dt, cmd, joint):
    """Take a measured state (6,) without learning from it."""
    state = filter_state(joint.memory, joint.model)
    config = filter_config(joint.config, joint.model)
    _start_at(measured, state, config)
    clip_velocities(state.x, config.envelope)
    follow_all(state.act, cmd, config.lags, config.n_unit, dt)


@kernel
def _restart(first, count, ring, joint):
    """Run the filter over the ``count`` rows after ``first`` once more, from what it measured.

    Parameters and their covariance go on as they are, and the actuators end where they were.
    """
    model = joint.model
    state, config = filter_state(joint.memory, model), filter_config(joint.config, model)
    act = state.act
    now, size = alloca_f64(N_ACT), ring.states.shape[0]
    for k in range(N_ACT):
        now[k], act[k] = act[k], ring.acts[(first + 1) % size, k]
    _start_at(ring.states[first], state, config)
    _rerun(first + 1, count, ring, joint)
    for k in range(N_ACT):
        act[k] = now[k]


@kernel
def _finish_row(dt, joint):
    """Clip the velocities, and count the regressors of the moment."""
    model = joint.model
    state, config = filter_state(joint.memory, model), filter_config(joint.config, model)
    terms = filter_workspace(joint.work, model.which.shape[1]).terms
    clip_velocities(state.x, config.envelope)
    x = state.x
    drive(state.act, terms)
    motion, current = (x[3], x[4], x[5], math.cos(x[2]), math.sin(x[2])), (0.0, 0.0)
    rates_over_ground(motion, state.wind, current, x, N_STATES, model, terms)
    if information_is_due(dt, state):
        accumulate_information(terms, state, model)


class DSWPredictor(ModelPredictor):
    """The paper's DSW-UKF: late fusion, joint UKF, dynamic sliding window.

    At each row the filter takes one step. After every ``stride`` rows it is run once more over the
    last W rows. The parameters and their covariance stay as they are; the state starts from the
    measured one at the window's begin. The length follows Algorithm 1. Its indices take the trace
    of the innovation covariance, the surge speed as the motion, and the wind if the log has it. A
    proxy for the wave height comes from the lateral acceleration (``WaveProxy``). So each row is
    used about W/stride times more. This is one reading: the text does not say what is done with the
    window. On our boat and on others it does not beat the filter without it. After false numbers
    (spikes, frozen fixes) it is metres off for half a minute and more.

    Two rules never act as they are printed. With R = I over six states the trace is above P_max =
    2.25 in every row, so the binary period is always T0/2. And V < 0.1 in any steady sea, so the
    calm rule depends on S alone.

    Parameters
    ----------
    particulars : Particulars
        The boat.
    feedback : bool
        Feed the fused value back to the IMU filter (see ``LateFusion``);
        as printed there is none.
    window : str
        One of :data:`WINDOWS`: ``"dynamic"`` by Algorithm 1, ``"fixed"`` at ``w_min`` rows,
        or ``"off"``: no row is used twice.
    stride : int
        Rows between re-runs, 1 or more; 7 is near the half window of 15 that makes the
        paper's 210 iterations of its 80 s.
    w_min, w_max : int
        Bounds of W, rows. The paper gives w = 15. That w_r stays within w, which the rule of the
        lateral acceleration implies, is ours (Eq 40 alone has no bound).
    period : str
        Form of Eq 36, one of ``dynamic_window.PERIOD_FORMS``; by default
        Algorithm 1's.
    adapt : str
        ``"off"``, or the form of Eq 52, one of ``dynamic_window.NOISE_FORMS``. ``"literal"``: Q
        grows with the size of the state error (the innovation, per state), R with that of the
        control error. That is read as the mean distance between commands and actuators (shaft
        speeds in nominal ones, angles in rad). It says nothing of a sensor. ``"signed"``: both
        follow the squared state error less what the filter expects of it. Both stay within a factor
        of 100 of their start.
    adapts : str
        What Eq 52 moves, one of :data:`ADAPTED`. Q alone is ours: R never helped.
    adapt_gain : float
        Its alpha and beta, 0 or more.
    model, x0, p0, q, r, n_unit
        See :func:`paper_settings`.
    seed : int
        Nothing is drawn at random here.
    """

    tuning = "about 65 configurations in the study"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "printed": {"adapt": "literal", "adapts": "QR", "feedback": False, "window": "dynamic"}
    }
    """``dsw-ukf:printed``: Eq 52 on Q and R, fusion without feedback, the window of Algorithm 1."""

    def __init__(
        self,
        particulars: Particulars,
        *,
        model: str = "paper",
        feedback: bool = True,
        window: str = "dynamic",
        stride: int = 7,
        w_min: int = 15,
        w_max: int = 30,
        period: str = "binary",
        adapt: str = "off",
        adapts: str = "Q",
        adapt_gain: float = 1e-3,
        x0: ArrayLike = 0.1,
        p0: ArrayLike = 1.0,
        q: ArrayLike = 1e-4,
        r: ArrayLike = 1.0,
        n_unit: float | None = None,
        seed: int = 0,
    ) -> None:
        settings = paper_settings(particulars, model, x0=x0, p0=p0, q=q, r=r, n_unit=n_unit)
        super().__init__(particulars, settings, seed=seed)
        for name, value, known in (
            ("window", window, WINDOWS),
            ("adapt", adapt, ("off", *NOISE_FORMS)),
            ("adapts", adapts, ADAPTED),
        ):
            if value not in known:
                raise UsvTwinError(f"{name} = {value!r} is unknown; use one of {', '.join(known)}")
        if stride < 1:
            raise UsvTwinError(f'stride = {stride} must be 1 or more; window="off" for no re-run')
        if not 1 <= w_min <= w_max <= ROWS_MAX:
            raise UsvTwinError(
                f"w_min = {w_min} must be 1 or more, and w_max = {w_max} no less, to {ROWS_MAX}"
            )
        if not (math.isfinite(adapt_gain) and adapt_gain >= 0.0):
            raise UsvTwinError(f"adapt_gain = {adapt_gain} must be a finite number, 0 or more")
        self.fusion = LateFusion(particulars.instruments, particulars.length, feedback=feedback)
        self.window = DynamicWindow(base=w_min, cap=w_max - w_min, period=period)
        self.waves = WaveProxy()
        self.use, self.stride = window, stride
        self.adapt, self.adapts, self.adapt_gain = adapt, adapts, adapt_gain
        self._size = w_max
        self._sample_limits = sample_limits(particulars)
        shaft = SHAFT_LIMIT * particulars.shaft_speed
        self._command_limits = np.array([shaft, shaft, ANGLE_LIMIT, ANGLE_LIMIT])
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.ukf.reset()
        self.fusion.reset()
        self.window.reset()
        self.waves.reset()
        size = self._size
        self._ring = _Ring(
            np.zeros((size, N_STATES)),
            np.zeros((size, N_ACT)),
            np.zeros((size, N_ACT)),
            np.zeros(size),
            np.zeros((2, N_STATES)),
        )
        ukf = self.ukf
        ukf.fastest[:] = math.inf  # the paper's forecast has no guard
        self._joint = _Filter(ukf.memory, ukf.constants, ukf.terms, ukf.scratch)
        self._count = 0
        self._held, self._sound = False, 0
        self._wind = math.nan
        self.t = 0.0
        self.q, self.r = self.ukf.q, self.ukf.r
        self.q[:], self.r[:] = self.ukf.settings.q, self.ukf.settings.r

    def views(self) -> dict[str, Array]:
        """See :meth:`ModelPredictor.views`."""
        return {
            **super().views(),
            **{"noise.process": self.q, "noise.measurement": self.r},
            **with_prefix("ring", self._ring._asdict()),
        }

    def state_dict(self) -> State:
        """See :meth:`ModelPredictor.state_dict`."""
        return {
            **super().state_dict(),
            **{"count": self._count, "wind": self._wind},
            **{"held": self._held, "sound": self._sound},
            **with_prefix("fusion", self.fusion.state_dict()),
            **with_prefix("window", self.window.state_dict()),
            **with_prefix("waves", self.waves.state_dict()),
        }

    def load_state_dict(self, state: State) -> None:
        """Take over a saved state; see :meth:`Predictor.load_state_dict`."""
        parts = {"fusion": self.fusion, "window": self.window, "waves": self.waves}
        own = {k: v for k, v in state.items() if k.partition(".")[0] not in parts}
        like = {"count": 0, "wind": 0.0, "held": False, "sound": 0}
        count = {name: own.pop(name, None) for name in like}
        check_fields(count, like)
        for name, part in parts.items():
            load_part(name, part, state)
        super().load_state_dict(own)
        self._count, self._wind = count["count"], count["wind"]
        self._held, self._sound = count["held"], count["sound"]

    @property
    def ready(self) -> bool:
        """True once the filter has begun."""
        return self._count > 0

    def suspend_learning(self, commands: bool, motion: bool) -> None:
        """See :meth:`twin.predictors.base.Predictor.suspend_learning`: parameters are held."""
        self._held = commands or motion

    def update(self, t: float, dt: float, z: Array, cmd: Array) -> None:
        """Take one row; see :meth:`twin.predictors.base.Predictor.update`."""
        self.t = t
        # numbers that no boat gives would overflow the filter
        z = np.where(np.abs(z) < self._sample_limits, z, np.nan)
        before = self._ring.cmds[(self._count - 1) % self._size]
        cmd = np.where(np.abs(cmd) < self._command_limits, cmd, before)
        s = self.fusion.update(min(dt, GAP_MAX_S), z)
        ukf = self.ukf
        if not self.fusion.ready or self._count == 0:
            unit = ukf.settings.n_unit
            ukf.act[:] = unit * cmd[0], unit * cmd[1], cmd[2], cmd[3]
            if not self.fusion.ready:
                return
            ukf.x[:N_STATES] = s
        row = self._count % self._size
        ring = self._ring
        ring.states[row], ring.cmds[row], ring.dts[row] = s, cmd, dt
        ring.acts[row] = ukf.act
        self._count += 1
        if self._held or self._is_lost(s):
            # no row before this one is used again
            self._sound = 0
            _use_measured_motion(s, dt, cmd, self._joint)
            return
        self._sound += 1
        self._run(row, 1)
        error, expected = self._ring.innovation.copy()
        if self.adapt != "off":
            error[PSI] = wrap(error[PSI])
            self._adapt(error, expected, cmd)
        if math.isfinite(z[_WIND]):
            self._wind = float(z[_WIND])
        if self.use != "off":
            W = self.window.base if self.use == "fixed" else self._length(z, dt, s, expected)
            if self._count % self.stride == 0 and self._sound > W:
                self._restart(W)
        _finish_row(dt, self._joint)

    def _is_lost(self, measured: Array) -> bool:
        """Return whether a measured state (6,) is so far off that the filter has diverged."""
        error = measured - self.ukf.x[:N_STATES]
        error[PSI] = wrap(error[PSI])
        variance = self.ukf.P.diagonal()[:N_STATES] + self.r
        return bool((error**2 > DIVERGED_SD**2 * variance).any())

    def with_common_error(self, cov: Array) -> Array:
        """Return covariances with the GPS bias added, positive definite however large."""
        cov = super().with_common_error(cov)
        np.einsum("...ii->...i", cov)[...] *= 1.0 + RIDGE
        return cov

    def _length(self, z: Array, dt: float, s: Array, expected: Array) -> int:
        """Return W by Algorithm 1."""
        return self.window.update(
            self.t,
            trace_P=float(expected.sum()),
            hs=self.waves.update(dt, float(z[_ACCEL_Y])),
            vw=self._wind,
            a_y=float(z[_ACCEL_Y]),
            motion=float(s[U]),
        )

    def _restart(self, W: int) -> None:
        """Use the last W rows once more, starting from the measured state."""
        _restart((self._count - W) % self._size, W - 1, self._ring, self._joint)

    def _run(self, first: int, count: int) -> None:
        _rerun(first, count, self._ring, self._joint)

    def _adapt(self, error: Array, expected: Array, cmd: Array) -> None:
        """Move Q and R by Eq 52."""
        ukf = self.ukf
        if self.adapt == "literal":
            unit = ukf.settings.n_unit
            behind = np.abs(ukf.act - [unit * cmd[0], unit * cmd[1], cmd[2], cmd[3]])
            behind[:2] /= unit * self.particulars.shaft_speed
            state, control = np.abs(error), np.full(N_STATES, behind.mean())
        else:
            state = control = error**2 - expected
        start, gain = ukf.settings, self.adapt_gain
        if "Q" in self.adapts:
            q, start_q = self.q * STUDY_STEP_S, start.q * STUDY_STEP_S
            self.q[:] = adapt_noise(q, state, gain, start_q, self.adapt) / STUDY_STEP_S
        if "R" in self.adapts:
            self.r[:] = adapt_noise(self.r, control, gain, start.r, self.adapt)
