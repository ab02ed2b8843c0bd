"""Kernel by which a model aids a navigation filter that lacks fixes, IMU or any heading."""

from __future__ import annotations

import math

from twin.channels import PSI, R, U, V
from twin.filters.navigation_ekf import aid, lacks_gps, lacks_heading, lacks_imu
from twin.model.structure import N_STATES, current_of
from twin.particulars import STUDY_SPEED_MPS
from usv_kernel.jit import inlined

__all__ = ["aid_by_model"]

AID_PERIOD_S = 1.0
"""Time between corrections by the model, whose errors are correlated in time."""

AID_SD = 0.5 / STUDY_SPEED_MPS
"""Standard deviation of the model's velocity as an aid, in nominal speeds."""

AID_YAW_SD = 0.04
"""Standard deviation of the model's yaw rate as an aid, in nominal speeds over length."""

LEEWAY_SD = 0.15
"""Where neither compass nor gyro gives samples, the heading is that of the course through the
water: sway is zero within this standard deviation, in nominal speeds."""


@inlined
def aid_by_model(dt, nav, work, x, given, model):
    """Correct velocity, yaw rate and course of the navigation by the model's state ``x``.

    Without this, a boat that never had a gyro and loses its compass is taken to sail astern.
    """
    no_gps, no_imu, no_heading = lacks_gps(nav), lacks_imu(nav), lacks_heading(nav)
    nav.since_aid += dt
    if not (no_gps or no_imu or no_heading) or nav.since_aid < AID_PERIOD_S:
        return
    nav.since_aid = 0.0
    speed, turn = 0.25 * given.envelope[0], 0.25 * given.envelope[2]
    if no_gps or no_imu:
        aid(nav, work, 3, x[U], (AID_SD * speed) ** 2)
        aid(nav, work, 4, x[V], (AID_SD * speed) ** 2)
    if no_imu or no_heading:
        aid(nav, work, 5, x[R], (AID_YAW_SD * turn) ** 2)
    if no_heading and not (no_gps or no_imu):
        north, east = current_of(x, N_STATES, model.hull)
        aside = east * math.cos(nav.n[PSI]) - north * math.sin(nav.n[PSI])
        aid(nav, work, 4, aside, (LEEWAY_SD * speed) ** 2)
