"""Which filter of the bank is in force: what is left out, and when it is used again.

As long as the filter in force passes its test, what it uses is sound. Where it fails, the smallest
set is looked for whose filter passes without it: that of a single sensor before that of a device.
If only one passes, it comes into force at once, else the best after :data:`DECIDE_S`. As no filter
has seen what it leaves out, nothing has to be undone (solution separation).

What is left out is used again when filter 0, begun anew from the filter in force, has passed for
:data:`RETURN_S`, twice as long after each relapse. While a GPS is left out, one more filter begins
afresh from all sensors. If it passes for :data:`FRESH_S`, dead reckoning had drifted, and it wins.
"""

from __future__ import annotations

import math

import numpy as np

from twin.integrity.bank import (
    A1,
    A2,
    ACCELEROMETERS,
    AIDS,
    FILTERS,
    FIXES,
    FRESH,
    GYRO,
    LEFT_OUT,
    PE,
    PN,
    PSI,
    SILENT_S,
    STATES,
    VN,
    _convert,
    forget_tests,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["DECISION", "decide"]

DECISION = np.dtype(
    [
        ("in_doubt", "f8"),  # 1 while the filter in force fails
        ("failing_since", "f8"),  # clock at which it began to; below 0 it passes
        ("decided", "f8"),  # clock of the last decision, s
        ("relapses", "f8"),  # decisions that came soon after the one before
        ("dwell", "f8"),  # how long filter 0 must pass, s
    ]
)
"""What is remembered of decisions."""

SINGLE_S, DECIDE_S, LOST_S = 0.3, 6.0, 15.0

RETURN_S, RETURN_MAX_S, RELAPSE_S = 2.0, 20.0, 60.0

FRESH_S = 20.0

RESYNC_S, RENEW_S = 5.0, 12.0

HALF = 0.5

LEAD = 14.0

NO_COMPASS, NO_GYRO = 4, 5


@inlined
def _is_device(k):
    """Return whether filter k leaves out two sensors of a device."""
    return k == 3 or k == 7


@kernel
def copy_filter(source, target, k, clock, given):
    """Let filter k go on from another one, and test anew."""
    for i in range(STATES):
        target.x[i] = source.x[i]
        for j in range(STATES):
            target.P[i, j] = source.P[i, j]
    gyro, driven = target.uses_gyro, target.uses_accelerometers
    target.uses_gyro, target.uses_accelerometers = source.uses_gyro, source.uses_accelerometers
    if LEFT_OUT[k, GYRO] > 0.0 or source.uses_gyro == 0.0:
        _convert(target, gyro, source.uses_accelerometers, given)
    if driven != source.uses_accelerometers:
        _convert(target, target.uses_gyro, driven, given)
    forget_tests(target)
    target.since = clock


@kernel
def _is_minimal(bank, k, force):
    """Return whether no filter that leaves out less than filter k passes."""
    for other in range(FRESH):
        if other == k or other == force or bank.filters[other].ratio >= 1.0:
            continue
        part = True
        for j in range(LEFT_OUT.shape[1]):
            part = part and LEFT_OUT[other, j] <= LEFT_OUT[k, j]
        if part:
            return False
    return True


@kernel
def _is_candidate(bank, k, force, device):
    """Return whether leaving out what filter k does may explain the failure."""
    if k == force or bank.filters[k].ratio >= 1.0 or _is_device(k) != device:
        return False
    return _is_minimal(bank, k, force)


@kernel
def _best(bank, force, yaw_witness):
    """Return how many filters may explain a failure, the best of them, and its lead.

    The lead is twice the logarithm of the likelihood ratio to the next one, by the samples of the
    sensors that both use.
    """
    device = False
    for k in range(FRESH):
        device = device or _is_candidate(bank, k, force, False)
    device = not device
    count, best, lead = 0, -1, math.inf
    for k in range(FRESH):
        if not _is_candidate(bank, k, force, device):
            continue
        count += 1
        least = math.inf
        for other in range(FRESH):
            if other == k or not _is_candidate(bank, other, force, device):
                continue
            ahead = 0.0
            for aid in range(AIDS):
                if LEFT_OUT[k, aid] == 0.0 and LEFT_OUT[other, aid] == 0.0:
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


@kernel
def _begin_fresh(bank, force, given):
    """Let the fresh filter begin with heading and biases of the one in force, and with the fix."""
    fresh = bank.filters[FRESH]
    copy_filter(bank.filters[force], fresh, FRESH, bank.clock, given)
    for i in range(4):
        for j in range(STATES):
            fresh.P[i, j] = fresh.P[j, i] = 0.0
        fresh.x[i] = bank.start[i]
    fresh.P[PN, PN] = fresh.P[PE, PE] = 4.0 * given.fix_var
    for i in range(2):
        fresh.P[VN + i, VN + i] = given.speed_var


@kernel
def decide(bank, state, frozen, yaw_witness, force_ratio, given):
    """Choose the filter in force after an epoch; return whether it changed.

    ``state`` is the record of the decision, ``frozen`` (5,) is 1 for what repeats itself. The last
    two are what the commands say without GPS: see :mod:`twin.integrity.commands`.
    """
    now, force = bank.clock, int(bank.force_filter)
    filters = bank.filters
    for k in range(FILTERS):
        for j in range(LEFT_OUT.shape[1]):
            if frozen[j] > 0.0 and LEFT_OUT[k, j] == 0.0:
                filters[k].ratio = max(filters[k].ratio, FROZEN_RATIO)
        if LEFT_OUT[k, ACCELEROMETERS] == 0.0:
            filters[k].ratio = max(filters[k].ratio, force_ratio)
    state.in_doubt = 0.0
    if filters[force].ratio >= 1.0:
        if state.failing_since < 0.0:
            state.failing_since = now
        state.in_doubt = 1.0
        count, best, lead = _best(bank, force, yaw_witness)
        waited = now - state.failing_since
        certain = count == 1 and _is_tested(bank, best) and (waited >= SINGLE_S or filters[force].ratio >= FROZEN_RATIO)
        if best >= 0 and (certain or (lead > LEAD and waited > SINGLE_S) or waited > DECIDE_S):
            relapsed = now - state.decided < RELAPSE_S
            state.relapses = state.relapses + 1.0 if relapsed else 0.0
            state.dwell = min(RETURN_S * 2.0**state.relapses, RETURN_MAX_S)
            state.decided, state.failing_since, state.in_doubt = now, -1.0, 0.0
            bank.force_filter = best
            if best != 0:
                copy_filter(filters[best], filters[0], 0, now, given)
            return True
        if best < 0 and waited > LOST_S:
            _begin_anew(bank, given)
            state.failing_since, bank.force_filter = -1.0, 0.0
            return True
        return False
    state.failing_since = -1.0
    if force != 0 and force <= 3:
        fresh = filters[FRESH]
        if fresh.ratio >= 1.0 or fresh.since <= state.decided:
            if bank.age[FIXES] < given.gps_latency + 1.0:
                _begin_fresh(bank, force, given)
        elif (
            now - fresh.since > FRESH_S
            and fresh.ratio < HALF
            and fresh.seen[FIXES] > HALF * FRESH_S
        ):
            for k in range(FRESH):
                copy_filter(fresh, filters[k], k, now, given)
            bank.force_filter, state.decided = 0.0, now
            return True
    if force != 0:
        full = filters[0]
        if full.ratio >= 1.0:
            state.dwell = min(max(state.dwell, 2.0 * (now - full.since)), RETURN_MAX_S)
            copy_filter(filters[force], full, 0, now, given)
        elif now - full.since > state.dwell and full.ratio < HALF and _spoke(full, force, state):
            bank.force_filter = 0.0
            for k in range(1, FRESH):
                copy_filter(full, filters[k], k, now, given)
            return True
    for k in range(1, FRESH):
        if k == force:
            continue
        lasting = now - filters[k].since
        renew = force == 0 and filters[0].ratio < HALF and lasting > RENEW_S + k
        if renew or (filters[k].ratio >= 1.0 and lasting > RESYNC_S):
            copy_filter(filters[force], filters[k], k, now, given)
    return False


@inlined
def _is_tested(bank, k):
    """Return whether filter k has recent samples that could make it fail."""
    tested = False
    for aid in range(AIDS):
        tested = tested or (LEFT_OUT[k, aid] == 0.0 and bank.age[aid] < SILENT_S)
    return tested


@inlined
def _spoke(full, force, state):
    """Return whether what is left out has given samples meanwhile."""
    spoke = True
    for aid in range(3):
        if LEFT_OUT[force, aid] > 0.0 and full.seen[aid] < HALF * state.dwell:
            spoke = False
    return spoke


@kernel
def _begin_anew(bank, given):
    """Let every filter begin again from the sensors, as if nothing had been known."""
    for k in range(FILTERS):
        one = bank.filters[k]
        for i in range(STATES):
            for j in range(STATES):
                one.P[i, j] = 0.0
        if not math.isnan(bank.start[0]):
            one.x[PN], one.x[PE] = bank.start[0], bank.start[1]
        one.P[PN, PN] = one.P[PE, PE] = 1e4
        one.P[VN, VN] = one.P[VN + 1, VN + 1] = given.speed_var
        one.P[PSI, PSI] = 0.5
        one.P[A1, A1] = one.P[A2, A2] = given.accel_bias_var
        one.uses_gyro = one.uses_accelerometers = -1.0
        one.since = bank.clock
        forget_tests(one)


FROZEN_RATIO = 9.0
