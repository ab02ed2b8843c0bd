"""The paper's dynamic sliding window: how many samples the identifier looks back on.

The window has W = w + w_r samples (Eq 35). Its variable part w_r follows from a fluctuation index
of wind and waves (Eq 37) and a nonlinearity index (Eq 39). The latter rests on the largest Lyapunov
exponent of the motion. A lateral acceleration above 0.3 g doubles the window. It is adjusted when a
period has elapsed that shrinks with the innovation covariance (Eq 36). The adaptation of Q and R
(Eq 52) stands here as well.

Equations are numbered as the paper prints them beside its formulas. (34) is the augmented state,
(35) W, (36) the period, (37) the fluctuation index, (38) the exponent. (39) is the nonlinearity
index, (40) w_r, (52) the adaptation, which the text around it calls 49.

Eq 38 is an estimate from one pair of points. The text names the small-data method of
Rosenstein, Collins and De Luca (1993, Physica D 65:117-134), and that is what is computed.

None of this is recommended. With 15 noisy samples the exponent measures the noise. No reading of
the window was found to beat a plain filter. It is here to reproduce the paper.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.checkpoint import State, check_fields
from twin.identification.lyapunov import LENGTH_MIN, rosenstein
from twin.particulars import GRAVITY
from usv_kernel.errors import UsvTwinError

__all__ = [
    "NOISE_FORMS",
    "PERIOD_FORMS",
    "DynamicWindow",
    "WaveProxy",
    "adapt_noise",
    "adjustment_period",
    "environment_index",
    "nonlinearity_index",
    "variable_part",
]

Array = NDArray[np.float64]

ACCEL_MAX = 1e6
"""Limit of a valid sample of an accelerometer, m/s2."""

PERIOD_FORMS = ("continuous", "binary")
"""``continuous``: Eq 36. ``binary``: lines 5-8 of Algorithm 1."""

GAMMA_ENVIRONMENT = 0.6
GAMMA_NONLINEARITY = 0.4
"""Weights of Eq 40."""

BASE_PERIOD = 10.0
TRACE_LIMIT = 1.5**2
"""T0 of Eq 36, s, and P_max."""

CALM_ENVIRONMENT = 0.1
CALM_NONLINEARITY = 1.2
"""w_r = 0 where both indices are below these."""

LATERAL_LIMIT = 0.3 * GRAVITY
"""The window is at its bound at once where abs(a_y) is above this, m/s2."""

NOISE_FORMS = ("literal", "signed")
"""``literal``: Eq 52 as printed, which only grows. ``signed``: the error may be negative."""

NOISE_RANGE = 100.0
"""Variances of noise stay within this factor of their start."""

EXPONENT_MAX = 50.0
"""Largest exponent in Eq 39; beyond it S is huge anyway, and must stay finite."""


def environment_index(hs: ArrayLike, vw: ArrayLike) -> float:
    """Return how much waves and wind fluctuate within the window: index V.

    ``hs`` (n,) is the wave height, or anything proportional to it; NaN = missing. A quantity that
    is missing or zero throughout adds nothing.

    Source: Qu et al. 2025, Eq 37 as printed, with 1/3 over two terms.
    """
    total = 0.0
    for values in (np.asarray(hs, dtype=np.float64), np.asarray(vw, dtype=np.float64)):
        known = values[np.isfinite(values)]
        mean = abs(float(known.mean())) if known.size else 0.0
        if mean > 0.0:
            total += float(known.std()) / mean
    return total / 3.0


def nonlinearity_index(lambda_max: float, W: int, dt: float) -> float:
    """Return the mean growth of a small difference over the window: index S, 1 if differences stay.

    ``lambda_max`` is the largest Lyapunov exponent, 1/s, NaN counts as 0; W the window length,
    samples, above 0; dt the sampling interval, s.

    Source: Qu et al. 2025, Eq 39.
    """
    if W < 1 or not (math.isfinite(dt) and dt >= 0.0):
        raise UsvTwinError(f"W = {W} must be 1 or more, dt = {dt} finite and 0 or more")
    if math.isnan(lambda_max):
        return 1.0
    rate = min(max(lambda_max, -1e12), 1e12)
    return float(np.exp(np.minimum(rate * dt * np.arange(W), EXPONENT_MAX)).mean())  # Eq 39


def adjustment_period(trace_P: float, *, form: str = "continuous") -> float:
    """Return the time (s) between two adjustments of the window.

    ``trace_P`` is the trace of the innovation covariance, 0 or more; NaN counts as 0. ``form`` is
    one of :data:`PERIOD_FORMS`.

    Source: Qu et al. 2025, Eq 36, and Algorithm 1, lines 5-8. The two agree only at
    ``trace_P == TRACE_LIMIT``.
    """
    if form not in PERIOD_FORMS:
        raise UsvTwinError(f"form = {form!r} is unknown; use one of {', '.join(PERIOD_FORMS)}")
    trace = 0.0 if math.isnan(trace_P) else max(trace_P, 0.0)
    if form == "binary":
        return 0.5 * BASE_PERIOD if trace > TRACE_LIMIT else BASE_PERIOD
    return BASE_PERIOD / (1.0 + trace / TRACE_LIMIT)  # Eq 36


def variable_part(V: float, S: float, base: int, cap: int) -> int:
    """Return the variable part w_r of the window, samples, from its two indices.

    ``V`` is :func:`environment_index`, ``S`` :func:`nonlinearity_index`; ``base`` the fixed part
    w, ``cap`` the largest w_r, samples.

    Source: Qu et al. 2025, Eq 40, and the rule for calm water in the text below it.
    """
    if V < CALM_ENVIRONMENT and S < CALM_NONLINEARITY:
        return 0
    share = GAMMA_ENVIRONMENT * V + GAMMA_NONLINEARITY * S
    return int(min(max(math.floor(base * min(share, 1e6) + 0.5), 0), cap))


class WaveProxy:
    """Running RMS of the wave-frequency acceleration: what a boat knows of the wave height.

    No sensor on board measures Hs. The RMS of the acceleration that waves cause is
    proportional to it as long as their period and the boat's course stay the same. Eq 37
    uses only standard deviation over mean, in which the factor cancels.

    Parameters
    ----------
    cutoff_period : float
        Motions slower than this (manoeuvres, tilt, bias) are taken out, s.
    memory : float
        Time constant of the mean square, s. The longer it is, the smaller the fluctuation
        that Eq 37 sees in a short window: 10 s gives a few per cent.

    Attributes
    ----------
    value : float
        Latest RMS, m/s2; NaN before the first sample.
    """

    def __init__(self, *, cutoff_period: float = 8.0, memory: float = 10.0) -> None:
        for name, value in (("cutoff_period", cutoff_period), ("memory", memory)):
            if not (math.isfinite(value) and value > 0.0):
                raise UsvTwinError(f"{name} = {value} must be a finite number above 0")
        self._slow = cutoff_period / (2.0 * math.pi)
        self._memory = memory
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self.value = math.nan
        self._mean = 0.0
        self._square = 0.0
        self._weight = 0.0

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        own = {"mean": self._mean, "square": self._square, "weight": self._weight}
        return {"value": self.value, **own}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned."""
        check_fields(state, self.state_dict())
        self.value, self._mean = state["value"], state["mean"]
        self._square, self._weight = state["square"], state["weight"]

    def update(self, dt: float, accel: float) -> float:
        """Take a specific force (m/s2), dt (s) after the one before; return the RMS.

        A missing sample (NaN) holds the value, which is NaN before the first. UsvTwinError: dt
        is negative or not finite.
        """
        if not (math.isfinite(dt) and dt >= 0.0):
            raise UsvTwinError(f"dt = {dt} must be a finite number, 0 or more")
        if not abs(accel) < ACCEL_MAX:
            return self.value
        if math.isnan(self.value):
            self._mean = accel
        self._mean += (1.0 - math.exp(-dt / self._slow)) * (accel - self._mean)
        # The weight of the start is divided out: the RMS is unbiased from the beginning.
        gain = 1.0 - math.exp(-dt / self._memory)
        self._square += gain * ((accel - self._mean) ** 2 - self._square)
        self._weight += gain * (1.0 - self._weight)
        self.value = math.sqrt(self._square / self._weight) if self._weight > 0.0 else 0.0
        return self.value


class DynamicWindow:
    """Length of the sliding window by the rules of the paper.

    Parameters
    ----------
    base : int
        Fixed part w, samples; also the length at the start.
    cap : int, optional
        Largest variable part w_r, samples; by default ``base``, as the doubling rule implies.
        Eq 40 alone has no bound: S grows with W, and the window to any cap.
    period : str
        Form of Eq 36, one of :data:`PERIOD_FORMS`.

    Attributes
    ----------
    W, w_r : int
        Present length and its variable part, samples.
    T : float
        Adjustment period by the latest trace, s.
    V, S, lambda_max : float
        Indices and exponent of the latest adjustment; NaN before the first.

    Notes
    -----
    Source: Qu et al. 2025, Eq 35-40, and Algorithm 1.
    """

    def __init__(
        self, *, base: int = 15, cap: int | None = None, period: str = "continuous"
    ) -> None:
        if base < 1 or (cap is not None and cap < 0):
            raise UsvTwinError(f"base = {base} must be 1 or more, cap = {cap} 0 or more")
        if period not in PERIOD_FORMS:
            raise UsvTwinError(
                f"period = {period!r} is unknown; use one of {', '.join(PERIOD_FORMS)}"
            )
        self.base = base
        self.cap = base if cap is None else cap
        self.period = period
        self.reset()

    def reset(self) -> None:
        """Go back to the start: W = base and no samples."""
        self.w_r = 0
        self.T = BASE_PERIOD
        self.V = math.nan
        self.S = math.nan
        self.lambda_max = math.nan
        self._adjusted = math.nan
        self._latest = -math.inf
        self._rows: deque[tuple[float, float, float, float]] = deque(maxlen=self.base + self.cap)

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        return {
            **{"w_r": self.w_r, "T": self.T, "V": self.V, "S": self.S},
            **{"lambda_max": self.lambda_max, "adjusted": self._adjusted},
            **{"latest": self._latest, "rows": np.array(self._rows).reshape(-1, 4)},
        }

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned."""
        check_fields(state, self.state_dict(), ragged=("rows",))
        self.w_r = int(state["w_r"])
        self.T, self.V, self.S = state["T"], state["V"], state["S"]
        self.lambda_max = state["lambda_max"]
        self._adjusted, self._latest = state["adjusted"], state["latest"]
        self._rows.clear()
        self._rows.extend(tuple(row) for row in state["rows"].tolist())

    @property
    def W(self) -> int:
        """Present length of the window, samples."""
        return self.base + self.w_r  # Eq 35

    def update(
        self,
        t: float,
        *,
        trace_P: float = math.nan,
        hs: float = math.nan,
        vw: float = math.nan,
        a_y: float = math.nan,
        motion: float = math.nan,
    ) -> int:
        """Take one row at time t (s), never before the last; return the length W of the window.

        ``trace_P`` is that of the filter's innovation covariance, ``hs`` the wave height, m, or a
        proxy of it (:class:`WaveProxy`). ``vw`` is the wind speed, m/s, ``a_y`` the lateral
        specific force, m/s2, ``motion`` the channel of the state whose exponent is taken. NaN =
        missing, but for t. W is from ``base`` to ``base + cap``. UsvTwinError: t is not finite or
        goes back.
        """
        if not math.isfinite(t) or t < self._latest:
            raise UsvTwinError(f"t = {t} must be finite and not before {self._latest}")
        if math.isnan(self._adjusted):
            self._adjusted = t
        self._latest = t
        self._rows.append((t, hs, vw, motion))
        self.T = adjustment_period(trace_P, form=self.period)
        if abs(a_y) > LATERAL_LIMIT:
            self.w_r = self.cap
            self._adjusted = t
        elif t - self._adjusted >= self.T:
            self._adjust()
            self._adjusted = t
        return self.W

    def _adjust(self) -> None:
        """Set w_r from the indices of the present window."""
        rows = np.array(list(self._rows)[-self.W :])
        self.V = environment_index(rows[:, 1], rows[:, 2])
        moving = rows[np.isfinite(rows[:, 3])]
        span = float(moving[-1, 0] - moving[0, 0]) if len(moving) else 0.0
        if len(moving) >= LENGTH_MIN and span > 0.0:
            dt = span / (len(moving) - 1)
            self.lambda_max = rosenstein(moving[:, 3], dt=dt)
            self.S = nonlinearity_index(self.lambda_max, self.W, dt)
        else:
            self.lambda_max = math.nan
            self.S = 1.0
        self.w_r = variable_part(self.V, self.S, self.base, self.cap)


def adapt_noise(noise: Array, error: Array, gain: float, start: Array, form: str) -> Array:
    """Return the variances (n,) of a noise after a step of the adaptation.

    ``error`` is that of the state or control. Literal: its size counts, whatever the unit. Signed:
    squared error minus the variance that the filter expects. NaN (unknown) counts as 0. ``start``
    are the variances at the start, ``form`` is one of :data:`NOISE_FORMS`.

    Source: Qu et al. 2025, Eq 52 (the text calls it 49). The equation adds a number to a matrix;
    read as added to each variance.
    """
    step = np.nan_to_num(gain * (np.abs(error) if form == "literal" else error), nan=0.0)
    moved: Array = np.clip(noise + step, start / NOISE_RANGE, start * NOISE_RANGE)  # Eq 52
    return moved
