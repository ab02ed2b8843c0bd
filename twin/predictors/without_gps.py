"""How much the velocity of a model errs without GPS, for as long as no fix comes."""

from __future__ import annotations

import math

from twin.channels import U, V
from twin.filters.navigation_ekf import GAP_MAX, lacks_gps
from twin.model.structure import CURRENT, N_STATES
from twin.particulars import GRAVITY
from usv_kernel.jit import inlined

__all__ = ["widen_without_gps"]

FROUDE_MOST = 0.2
"""Froude number of the nominal speed above which a rough model is taken to err no more. The noises
of its filter grow with that speed, and so does all that they leave unsure. What it leaves out,
above all currents, does not."""

MODEL_DRIFT, LASTING_SHARE = 0.02, 0.06
"""Error of the model's velocity that lasts without GPS, in nominal speeds, at least; and how much
of the variance of a rough model's own velocity does, of no more than the fastest seen."""

UNTURNED = 0.15
"""Standard deviation of the current along the course that a boat with a rough model has kept, in
nominal speeds: while it turns to no other, a current and an error of drag or thrust look the same.
Where it turns without GPS, the one leaves and the other goes with it."""


@inlined
def widen_without_gps(dt, nav, state, given, model):
    """Add to the variance of the navigation's position what the model's velocity errs by."""
    if nav.gps_age == 0.0:
        for i in range(2):
            nav.turned[i], nav.turned[2 + i] = nav.path[2 + i], 0.0
    if not lacks_gps(nav):
        return
    P, speed = state.P, 0.25 * given.envelope[0]
    lasting, slowed = max(nav.drift_var, (MODEL_DRIFT * speed) ** 2), 1.0
    if given.rest_push < 1.0:  # rough: no population says what it leaves out
        length = given.envelope[0] / given.envelope[2]
        slowed = min(1.0, FROUDE_MOST**2 * GRAVITY * length / (speed * speed))
        most = state.fastest[0] ** 2 + state.fastest[1] ** 2
        lasting = max(lasting, slowed * LASTING_SHARE * min(P[U, U] + P[V, V], most))
        _widen_by_turns(nav, math.sqrt(slowed) * speed)
    at = N_STATES + int(model.hull[CURRENT])
    for i in range(2):
        more = slowed * P[at + i, at + i] if at >= N_STATES else 0.0
        nav.P[i, i] += 2.0 * (lasting + more) * nav.gps_age * min(dt, GAP_MAX)


@inlined
def _widen_by_turns(nav, speed):
    """Add what a current that no turn has shown yet does once the boat turns."""
    before = math.hypot(nav.turned[0], nav.turned[1])  # s along the mean course so far
    share = min(before / max(nav.clock - nav.gps_age, 1e-3), 1.0)
    for i in range(2):
        # time along that course since the last fix, less that along the courses since: s
        apart = nav.turned[i] / max(before, 1e-3) * nav.gps_age - (nav.path[2 + i] - nav.turned[i])
        more = max(apart * apart - nav.turned[2 + i], 0.0)
        nav.turned[2 + i] += more
        nav.P[i, i] += (UNTURNED * speed * share) ** 2 * more
