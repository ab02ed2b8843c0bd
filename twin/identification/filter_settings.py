"""Noise, prior and structure of the joint UKF, scaled to any boat."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.model.dynamics import model_of
from twin.model.priors import boat_or, population_prior
from twin.model.structure import N_STATES, Structure
from twin.particulars import STUDY_LENGTH_M, STUDY_SPEED_MPS, Particulars
from usv_kernel.errors import UsvTwinError

__all__ = [
    "FilterSettings",
    "plain_settings",
]

Array = NDArray[Any]

STUDY_STEP_S = 0.05
"""Step at which the noises below are quoted."""

GUST_NOISE = 0.0088
GUST_YAW_NOISE = 0.039
"""Standard deviations that gusts add in one second to a tanker's velocities, times length, m2/s,
and to its yaw rate, times length squared, rad m2/s."""

CALM_NOISE_SHARE = 0.05
CALM_YAW_NOISE_SHARE = 0.005
"""Standard deviation of the measurement noise without waves over that with waves; of the yaw rate,
that of the gyro alone."""

WAVE_TIME = 1.0
WAVE_MEASUREMENT_NOISE = 0.3
WAVE_PROCESS_NOISE = 10.0
"""Adaptation of a tanker's noise to waves: averaging time of the squared innovations, and factors
of that mean in the densities of measurement noise (both in L/U) and of process noise (in U/L)."""

WANDERING = ("E_north", "E_east", "N_0")
WANDER_TIME_S = 28.0
"""Biases of a tanker with a random walk, and the time in which it reaches the prior's variance."""

ROUGH_PROCESS_NOISE = 4.0
ROUGH_MEASUREMENT_NOISE = 0.5
"""Standard deviations of the noises of a boat with a fixed pair of thrusters, in those of the
study's boat: the residuals of its rough model are not white."""

REST_PROCESS_NOISE = 0.001
"""Share of that process noise at rest with shafts stopped: the error of a rough model grows with
its forces."""

ROUGH_SHARE = 0.3
"""Least damping and thrust of such a boat, as a share of the prior's."""

ROUGH_SPEED_RATIO_MAX = 2.5
ROUGH_VELOCITY_SD_MAX = 0.6
"""Forecasts of such a boat: its largest shaft speed and speed in nominal ones, and the largest
standard deviation of a velocity over its plausible bound."""

SIGMA_DISTANCE_SQUARED = 3.0
"""Squared distance of the sigma points for such a boat, in variances: with alpha = 1 it would be
the number of states and parameters, at which quadratic terms dominate.

Source: Julier and Uhlmann 1997, n + kappa = 3.
"""

CURRENT_TIME_S = 300.0
"""Time of the study's boat in which the current's random walk reaches its prior's variance."""

UNEQUAL = ("N_0", "N_mn")
UNEQUAL_TIME_S = 10.0
"""Turning of a boat with a fixed pair of thrusters at equal shaft speeds, a random walk, and the
time of the study's boat in which it reaches the prior's variance."""

PRIOR_INFLATION = 1.5
"""Factor of the population's covariance in the prior of a tanker."""


class FilterError(UsvTwinError):
    """Settings of a filter that cannot be used; the message names the field."""


@dataclass(frozen=True)
class FilterSettings:
    """Noises and prior of the joint UKF, in SI units of the boat at hand."""

    structure: Structure  # what the accelerations are made of; p parameters
    q: Array  # (6,): variance that each state gains per second
    # (6,): variance of each measured state for rows 0.05 s apart (of the study boat's time). Rows
    # further apart count for more, as their waves are less correlated
    r: Array
    p0: Array  # (6,): variance of each state at the start
    q_xi: Array  # (p,): variance that each parameter gains per second
    # (p,), (p, p): prior of the parameters
    xi0: Array
    xi0_cov: Array
    n_unit: float  # shaft speeds are multiplied by this before they enter the model
    # adaptation to waves: averaging time (s) of how much the squared innovations of the velocities
    # exceed their expectation, and what that mean adds to the densities of measurement noise (s)
    # and process noise (1/s); zeros switch it off
    waves: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # share of the velocities' process noise that is left at rest: 1 where waves and wind make it,
    # less where the model's error does, which grows with the forces
    rest_push: float = 1.0
    # least damping and thrust, as a share of the prior's
    share: float = 0.1
    # largest shaft speed and speed of a forecast in nominal ones; and largest standard deviation of
    # a velocity over its plausible bound
    most: tuple[float, float] = (1.0, math.inf)
    # spread of the sigma points
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        p = len(self.structure)
        shapes = {"q": (6,), "r": (6,), "p0": (6,), "q_xi": (p,), "xi0": (p,), "xi0_cov": (p, p)}
        for name, shape in {**shapes, "waves": (3,)}.items():
            value = np.asarray(getattr(self, name))
            if value.shape != shape or not np.isfinite(value).all():
                raise FilterError(
                    f"{name} has shape {value.shape}; give finite numbers of shape {shape}"
                )
            if name not in ("xi0", "xi0_cov") and (value < 0.0).any():
                raise FilterError(f"{name} has entries below 0: give variances, or densities")
        if not 0.0 < self.n_unit < math.inf:
            raise FilterError(f"n_unit = {self.n_unit} must be finite and above 0")


def plain_settings(particulars: Particulars, model: str | None = None) -> FilterSettings:
    """Return the settings of the plain joint UKF.

    The model is that of the paper if none is named, but for tankers: see :func:`_of_a_tanker`.

    Those that worked for a boat of 6.336 m (waterline) at 5.4 m/s and 20 Hz, scaled to any
    boat by length and speed (Froude). The measurement noise is far above that of the
    sensors, because the measured velocities carry the waves and the model does not.

    Source: docs/explanation/twin.md, Joint filter.
    """
    if model is None and particulars.tanker:
        return _of_a_tanker(particulars)
    L, U = particulars.length / STUDY_LENGTH_M, particulars.speed / STUDY_SPEED_MPS
    time = L / U
    scale = np.array([L, L, 1.0, U, U, 1.0 / time])
    q = np.array([1e-3, 1e-3, 1e-4, 0.05, 0.05, 0.0125]) * scale
    r = np.array([1.0, 1.0, 0.03, 0.3, 0.3, 0.048]) * scale
    p0 = np.array([2.0, 2.0, 0.05, 0.3, 0.3, 0.05]) * scale
    rough = particulars.steering == "differential"
    if rough:
        q[3:] *= ROUGH_PROCESS_NOISE
        r *= ROUGH_MEASUREMENT_NOISE
    structure = model_of(particulars, model or ("mmg" if rough else "paper"), current=True)
    mean, covariance = boat_or((structure.mean, np.diag(structure.sd**2)), structure, particulars)
    walking = np.isin(structure.parameters, ("C_north", "C_east")) / CURRENT_TIME_S
    if rough:
        walking = walking + np.isin(structure.parameters, UNEQUAL) / UNEQUAL_TIME_S
    q_xi = walking * np.diag(covariance) / time
    found = FilterSettings(
        structure=structure,
        q=q**2 / (STUDY_STEP_S * time),
        r=r**2 * time,
        p0=p0**2,
        q_xi=q_xi,
        xi0=mean,
        xi0_cov=covariance,
        n_unit=structure.n_unit,
    )
    if not rough:
        return found
    return dataclasses.replace(
        found,
        rest_push=REST_PROCESS_NOISE,
        share=ROUGH_SHARE,
        most=(ROUGH_SPEED_RATIO_MAX, ROUGH_VELOCITY_SD_MAX),
        alpha=math.sqrt(SIGMA_DISTANCE_SQUARED / (N_STATES + len(structure))),
    )


def _of_a_tanker(particulars: Particulars) -> FilterSettings:
    """Return the settings for a slow ship of full form: docs/explanation/twin.md, Tankers."""
    L, time = particulars.length, particulars.length / particulars.speed
    disturbed = np.array([GUST_NOISE / L, GUST_NOISE / L, GUST_YAW_NOISE / L**2])
    calm = plain_settings(particulars, "mmg")
    structure = calm.structure
    mean, covariance = population_prior(structure, particulars)
    wander = np.isin(structure.parameters, WANDERING) * np.diag(covariance) / WANDER_TIME_S
    mean, covariance = boat_or((mean, PRIOR_INFLATION * covariance), structure, particulars)
    return dataclasses.replace(
        calm,
        q=np.concatenate([calm.q[:3], disturbed**2]),
        r=np.array([*5 * (CALM_NOISE_SHARE,), CALM_YAW_NOISE_SHARE]) ** 2 * calm.r,
        q_xi=wander,
        xi0=mean,
        xi0_cov=covariance,
        waves=(WAVE_TIME * time, WAVE_MEASUREMENT_NOISE * time, WAVE_PROCESS_NOISE / time),
    )
