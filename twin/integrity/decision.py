"""Which filter of the bank is in force: what is left out, and when it is used again.

As long as the filter in force passes its test, what it uses is sound. Where it fails, the smallest
set is looked for whose filter passes without it: that of a single sensor before that of a device.
If only one passes, or one leads by likelihood, it comes into force after :data:`DECIDE_SINGLE_S`,
else the best after :data:`DECIDE_S`. As no filter has seen what it leaves out, nothing has to be
undone (solution separation).

What is left out is used again when filter 0, begun anew from the filter in force, has passed for
:data:`RETURN_S`. Where it fails and a GPS is left out, it begins next with the fix. If it passes
for :data:`RETURN_AFRESH_S` then, dead reckoning had drifted.
"""

from __future__ import annotations

import math

import numpy as np

from twin.integrity.bank import (
    AIDS,
    FILTERS,
    FIXES,
    GYRO,
    LEFT_OUT,
    LOST_SD_M,
    NO_ACCELEROMETERS,
    NO_COMPASS,
    NO_GPS,
    NO_GYRO,
    PE,
    PN,
    RETURN_S,
    SENSED,
    SILENT_S,
    STATES,
    THRUST,
    WINDOWS_S,
    begin_anew,
    begin_at_fix,
    convert,
    forget_tests,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["DECISION", "decide"]

DECISION = np.dtype(
    [
        ("in_doubt", "f8"),  # 1 while the filter in force fails
        ("failing_since", "f8"),  # clock at which it began to; below 0 it passes
        ("afresh", "f8"),  # 1 where filter 0 began from a GPS that is left out
    ]
)
"""What is remembered of decisions."""

DECIDE_SINGLE_S = 1.0
"""Delay of the decision where a single filter explains the failure."""

LEAD_LOG_RATIO = -2.0 * math.log(1e-3)
"""Twice the log-likelihood ratio to the next filter that is decided on after the same delay."""

DECIDE_S = 6.0
"""Delay after which the filter with the highest likelihood is decided on."""

UNEXPLAINED_S = 15.0
"""Time without an explanation of a failure after which all filters begin anew."""

RETURN_AFRESH_S = 20.0
"""Time for which a filter that began from an excluded GPS must pass before the GPS is used ..."""

DRIFT_SD_MAX = 20.0
"""... and its largest separation from dead reckoning, in standard deviations of the latter."""

RETURN_RATIO_MAX = 0.5
"""Ratio of statistic to threshold below which an excluded sensor may return."""


@kernel
def copy_filter(source, target, k, clock, given):
    """Set filter k to the state of another one, and restart its tests."""
    for i in range(STATES):
        target.x[i] = source.x[i]
        for j in range(STATES):
            target.P[i, j] = source.P[i, j]
    gyro, driven = target.uses_gyro, target.uses_accelerometers
    target.uses_gyro, target.uses_accelerometers = source.uses_gyro, source.uses_accelerometers
    if LEFT_OUT[k, GYRO] > 0.0 or source.uses_gyro == 0.0:
        convert(target, gyro, source.uses_accelerometers, given)
    if driven != source.uses_accelerometers:
        convert(target, target.uses_gyro, driven, given)
    forget_tests(target)
    target.since = clock


@kernel
def _is_candidate(bank, k, force, device):
    """Return whether filter k, which leaves something else out, has passed all along."""
    return k != force and bank.filters[k].misfit[FIXES] < math.inf and (k == NO_GPS) == device


@kernel
def _best(bank, force, yaw_witness):
    """Return how many filters may explain a failure, the best of them, and its lead.

    The lead is twice the logarithm of the likelihood ratio to the next one, by the samples of the
    sensors that both use.
    """
    device = False
    for k in range(FILTERS):
        device = device or _is_candidate(bank, k, force, False)
    device = not device
    count, best, lead = 0, -1, math.inf
    for k in range(FILTERS):
        if not _is_candidate(bank, k, force, device):
            continue
        count += 1
        least = math.inf
        for other in range(FILTERS):
            if other == k or not _is_candidate(bank, other, force, device):
                continue
            ahead = 0.0
            for aid in range(AIDS):
                both = bank.modelled > 0.0
                if aid < SENSED:
                    both = LEFT_OUT[k, aid] == 0.0 and LEFT_OUT[other, aid] == 0.0
                if both:
                    ahead += bank.filters[other].misfit[aid] - bank.filters[k].misfit[aid]
            if k == NO_GYRO and other == NO_COMPASS:
                ahead += 2.0 * yaw_witness
            elif k == NO_COMPASS and other == NO_GYRO:
                ahead -= 2.0 * yaw_witness
            if ahead == 0.0:
                ahead = bank.filters[other].ratio - bank.filters[k].ratio
            least = min(least, ahead)
        if best < 0 or least > lead:
            best, lead = k, least
    return count, best, lead


@inlined
def _is_tested(bank, k):
    """Return whether filter k has recent samples that could make it fail."""
    tested = bank.modelled > 0.0
    for aid in range(SENSED):
        tested = tested or (LEFT_OUT[k, aid] == 0.0 and bank.age[aid] < SILENT_S)
    return tested


@kernel
def _leave_out(bank, state, force, yaw_witness, given):
    """Decide what explains that the filter in force fails; return whether another one is now."""
    filters, now = bank.filters, bank.clock
    if state.failing_since < 0.0:
        state.failing_since = now
        for k in range(FILTERS):
            filters[k].misfit[:] = 0.0
    for k in range(FILTERS):
        if filters[k].ratio >= 1.0:
            # what has never seen the fault passes all along
            filters[k].misfit[FIXES] = math.inf
    state.in_doubt = 1.0
    count, best, lead = _best(bank, force, yaw_witness)
    waited, least = now - state.failing_since, DECIDE_S
    if (count == 1 and _is_tested(bank, best)) or lead > LEAD_LOG_RATIO:
        least = DECIDE_SINGLE_S
        if best == NO_ACCELEROMETERS and bank.modelled > 0.0:
            # commands say it rarely: they say it twice
            least = max(least, bank.interval[THRUST])
    if best >= 0 and waited > least:
        state.afresh, state.failing_since, state.in_doubt = 0.0, -1.0, 0.0
        bank.force_filter = best
        if best != 0:
            copy_filter(filters[best], filters[0], 0, now, given)
        return True
    if best < 0 and waited > UNEXPLAINED_S and bank.age[FIXES] < SILENT_S:
        begin_anew(bank, given)
        state.failing_since = -1.0
        return True
    return False


@inlined
def _may_have_drifted(fresh, reckoned):
    """Return whether the drift of dead reckoning may explain its separation from the GPS."""
    separation = math.hypot(fresh.x[PN] - reckoned.x[PN], fresh.x[PE] - reckoned.x[PE])
    sd = math.sqrt(reckoned.P[PN, PN] + reckoned.P[PE, PE])
    return sd > LOST_SD_M or separation < DRIFT_SD_MAX * sd


@kernel
def _use_again(bank, state, force, given):
    """Return whether what was left out is used again, as filter 0 has passed with it."""
    full, now = bank.filters[0], bank.clock
    lasted = now - full.since
    if full.ratio >= 1.0:
        # in turn from the filter in force and from a GPS that is left out
        has_fix = LEFT_OUT[force, FIXES] > 0.0 and bank.age[FIXES] < given.gps_latency + 1.0
        state.afresh = 1.0 - state.afresh if has_fix else 0.0
        copy_filter(bank.filters[force], full, 0, now, given)
        if state.afresh > 0.0:
            begin_at_fix(full, bank, given)
        return False
    dwell = RETURN_AFRESH_S if state.afresh > 0.0 else RETURN_S
    if lasted <= dwell or full.ratio >= RETURN_RATIO_MAX:
        return False
    if state.afresh > 0.0 and not _may_have_drifted(full, bank.filters[force]):
        return False
    for aid in range(SENSED):
        if LEFT_OUT[force, aid] > 0.0 and full.seen[aid] < 0.5 * dwell:
            return False  # it has not spoken meanwhile
    bank.force_filter = 0.0
    for k in range(1, FILTERS):
        copy_filter(full, bank.filters[k], k, now, given)
    return True


@kernel
def decide(bank, state, yaw_witness, given):
    """Choose the filter in force after an epoch; return whether it changed.

    ``state`` is the record of the decision, ``yaw_witness`` the log-likelihood of the turns by
    compass over that of those by gyro.
    """
    now, force, filters = bank.clock, int(bank.force_filter), bank.filters
    state.in_doubt = 0.0
    if filters[force].ratio >= 1.0:
        return _leave_out(bank, state, force, yaw_witness, given)
    state.failing_since = -1.0
    if force != 0 and _use_again(bank, state, force, given):
        return True
    for k in range(1, FILTERS):
        lasted = now - filters[k].since
        renew = force == 0 and filters[0].ratio < RETURN_RATIO_MAX and lasted > WINDOWS_S[-1] + k
        renew = renew and bank.age[FIXES] < SILENT_S
        if k != force and (renew or (filters[k].ratio >= 1.0 and lasted > DECIDE_S)):
            copy_filter(filters[force], filters[k], k, now, given)
    return False
