"""Parameters of ArduPilot's Rover for a vessel, from its own speed and turning trials."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from usv_gym.physics import GRAVITY
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel, VesselError
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import check_number
from usv_kernel.servos import Servos

__all__ = ["Handling", "autopilot_parameters", "cruising_speed", "handling", "parameter_text"]

CRUISE_FROUDE = 0.36
"""Froude number of the cruising speed, that of a displacement boat."""

STEP = 0.05
LENGTHS = 40.0
"""Step of a trial, s, and how far it goes at the cruising speed, ship lengths."""

RESPONSE = 0.632
"""Share of the steady rate that a first-order system has reached after its time constant."""

LAG = 2.3
"""Least time, s, in which the closed loop of the turning rate is to answer ..."""

FEED_FORWARD = 0.6
"""... with so much of the steering as feed-forward. The rest comes from P and I, so that it does
not overshoot where a boat answers small angles better than large ones."""

STEERING = 26
THROTTLE = 70
LEFT = 73
RIGHT = 74
"""Functions of ArduPilot's servo outputs."""


class Handling(NamedTuple):
    """What a boat does at its cruising speed."""

    speed: float  # m/s
    throttle: float  # share of full throttle that keeps it
    rate: float  # steady turning rate at half helm, rad/s
    rate_max: float  # at full helm
    radius: float  # of the turn at full helm, m
    turn_time: float  # s until the rate at half helm is reached to 63 %
    speed_time: float  # s until a boat at rest has 63 % of its speed


def cruising_speed(vessel: Vessel) -> float:
    """Return a cruising speed, m/s: Froude number 0.36, in steps of half a metre a second."""
    speed = CRUISE_FROUDE * math.sqrt(GRAVITY * vessel.values["length_waterline"])
    top = vessel.straight_speed(vessel.servos.shaft_speed)
    return min(max(round(2.0 * speed) / 2.0, 0.5), 0.8 * top)


def handling(vessel: Vessel, speed: float | None = None) -> Handling:
    """Simulate speed and turning trials in calm water, through the outputs of an autopilot.

    ``speed`` is that of the approach, m/s, by default :func:`cruising_speed`. VesselError: the
    boat does not reach it, or does not turn.
    """
    servos = vessel.servos
    if speed is None:
        speed = cruising_speed(vessel)
    top = vessel.straight_speed(servos.shaft_speed)
    check_number("cruising speed", speed, 0.01, top, VesselError)
    throttle = vessel.shaft_speed_for(speed) / servos.shaft_speed
    turn = _sail(vessel, speed, throttle, 1.0)
    half, full = _sail(vessel, speed, throttle, 0.5)[:, fr.R], turn[:, fr.R]
    surge = _sail(vessel, 0.0, throttle, 0.0)[:, fr.U]
    rate, rate_max = (float(np.mean(run[-len(run) // 4 :])) for run in (half, full))
    if not (rate > 1e-4 and rate_max > 1e-4):
        raise VesselError(f"{vessel.name}: does not turn by its servo outputs; see [autopilot]")
    return Handling(
        speed=speed,
        throttle=throttle,
        rate=rate,
        rate_max=rate_max,
        radius=math.hypot(*turn[-1, [fr.U, fr.V]].tolist()) / rate_max,
        turn_time=STEP * float(np.argmax(half >= RESPONSE * rate)),
        speed_time=STEP * float(np.argmax(surge >= RESPONSE * surge[-1]) + 1),
    )


def _sail(vessel: Vessel, speed: float, throttle: float, helm: float) -> np.ndarray:
    """Return the states (N, 16) of a run in calm water, with constant throttle and helm."""
    sim = Simulation(1, vessel, SeaState(), dt=STEP, dt_physics=STEP)
    sim.reset([0], [np.random.default_rng(0)], speed=speed)
    command = np.array([_mixed(vessel.servos, throttle, helm)])
    duration = LENGTHS * vessel.values["length_waterline"] / max(speed, 0.5)
    states = []
    for _ in range(max(round(duration / STEP), 200)):
        sim.step(command)
        states.append(sim.state[0].copy())
    return np.array(states)


def _mixed(servos: Servos, throttle: float, helm: float) -> list[float]:
    """Return the command of a throttle and helm, each from -1 to 1, as an autopilot mixes them."""
    if servos.steering:
        return [throttle * servos.shaft_speed] * 2 + [helm * servos.angle] * 2
    shares = [min(max(throttle + side * helm, -1.0), 1.0) for side in (1.0, -1.0)]
    return [share * servos.shaft_speed for share in shares] + [0.0, 0.0]


def autopilot_parameters(
    vessel: Vessel, speed: float | None = None, *, external: bool = False
) -> dict[str, float]:
    """Return parameters of ArduPilot's Rover for a vessel, by name.

    Parameters
    ----------
    vessel : Vessel
        The boat; its servo outputs are those of ``[autopilot]`` in its file.
    speed : float, optional
        Cruising speed, m/s. Default: :func:`cruising_speed`.
    external : bool
        Whether to add a second source set of the EKF that takes external navigation.

    Notes
    -----
    The turning rate r answers the helm h, from -1 to 1, as T r' = K h - r. Feed-forward is a share
    of 1 / K, and P = T / (K L) gives a closed loop of the time L. Rates and radii are those of the
    trial at full helm. They are a start for tuning, not its end.
    """
    boat = handling(vessel, speed)
    servos = vessel.servos
    gain = boat.rate / 0.5
    time = max(boat.turn_time, STEP)
    lag = max(LAG, time)
    found: dict[str, float] = {"FRAME_CLASS": 2}
    if servos.steering:
        functions = {servos.steering: STEERING, servos.left: THROTTLE}
    else:
        functions = {servos.left: LEFT, servos.right: RIGHT}
    for output, function in functions.items():
        found |= {
            f"SERVO{output}_FUNCTION": function,
            f"SERVO{output}_MIN": servos.low,
            f"SERVO{output}_TRIM": servos.middle,
            f"SERVO{output}_MAX": servos.high,
        }
    found |= {
        "CRUISE_SPEED": boat.speed,
        "CRUISE_THROTTLE": round(100.0 * boat.throttle),
        "WP_SPEED": boat.speed,
        "WP_RADIUS": max(0.5 * boat.radius, 2.0),
        "TURN_RADIUS": boat.radius,
        "ATC_TURN_MAX_G": max(boat.speed * boat.rate_max / GRAVITY, 0.01),
        "ATC_ACCEL_MAX": 0.5 * boat.speed / boat.speed_time,
        "ATC_STR_RAT_FF": FEED_FORWARD / gain,
        "ATC_STR_RAT_P": time / (gain * lag),
        "ATC_STR_RAT_I": 0.1 * FEED_FORWARD / gain,
        "ATC_STR_RAT_MAX": math.degrees(boat.rate_max),
        "ATC_STR_ANG_P": min(0.85 / time, 2.0),
        "PSC_POS_P": min(0.14 / time, 0.2),
        "PSC_VEL_P": min(0.7 / time, 1.0),
        # steering is not divided by the speed
        "MOT_SPD_SCA_BASE": 0,
        "FS_THR_ENABLE": 0,
        "FS_GCS_ENABLE": 0,
        "BATT_MONITOR": 0,
        # the wind is that of the simulation
        "SIM_WIND_SPD": 0,
    }
    if external:
        found |= EXTERNAL
    return {name: round(float(value), 4) for name, value in found.items()}


EXTERNAL = {
    "VISO_TYPE": 1,
    "EK3_SRC2_POSXY": 6,
    "EK3_SRC2_VELXY": 6,
    "EK3_SRC2_POSZ": 1,
    "EK3_SRC2_VELZ": 0,
    "EK3_SRC2_YAW": 1,
}
"""Second source set of the EKF: place and velocity of external navigation, yaw of the compass."""


def parameter_text(vessel: Vessel, parameters: dict[str, float]) -> str:
    """Return parameters as a file that ArduPilot reads with ``--defaults``."""
    lines = [f"# {vessel.title}: from its trials in calm water, a start for tuning"]
    lines += [f"{name} {value:g}" for name, value in parameters.items()]
    return "\n".join(lines) + "\n"
