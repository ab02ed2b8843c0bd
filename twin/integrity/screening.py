"""What a sensor cannot give: impossible numbers, and exact repetition.

These are no questions of probability: no boat gives the first, and noise never repeats to the bit.
"""

from __future__ import annotations

import math

import numpy as np

from twin.integrity.bank import FALSE_ALARM, VE, VN, G
from usv_kernel.jit import inlined

__all__ = ["PARTS", "find_frozen", "screen"]

PARTS = np.array([[0, 2], [2, 4], [4, 5], [5, 6], [6, 8]])
"""First channel of fix, velocity, compass, gyro and accelerometers, and that after the last."""

FIX, VELOCITY, COMPASS, GYRO, ACCELEROMETERS = range(5)

FROZEN_INTERVALS = 6.0
"""Typical intervals between new samples after which a repeated sample counts as frozen."""

COARSE = 2.0 * math.sqrt(math.pi) * FALSE_ALARM ** (1.0 / FROZEN_INTERVALS)
"""Steps, in standard deviations of the noise, above which so many samples may well be equal.

Two samples of white noise round to one number with the probability step / (2 sqrt(pi) sd).
"""

MASKED_S = 0.5
MASKED_SAMPLES = 2.5
"""Exclusion of a sensor after an impossible number: time, and samples if that is longer."""

MOVING_SHARE = 0.1
"""Share of the nominal speed above which the boat counts as moving."""

CHANGED_SD = 3.0
"""Standard deviations by which heading or velocity must have changed for a coarse sensor to show
it."""

REPEAT_USED_S = 1.0
"""Time between uses of a sample that repeats the last one, as that of a resting boat."""

RENEWAL_MAX_S = 5.0


@inlined
def screen(dt, z, memory, given):
    """Leave out impossible numbers.

    Impossible numbers of two sensors make a row garbage as a whole.
    """
    out, bad = memory.z, 0
    for part in range(PARTS.shape[0]):
        wrong = False
        memory.masked[part] -= dt
        for j in range(PARTS[part, 0], PARTS[part, 1]):
            wrong = wrong or (not math.isnan(z[j]) and not abs(z[j]) < given.limits[j])
        if wrong:
            bad += 1 if part != VELOCITY else 0
            most = max(MASKED_S, MASKED_SAMPLES * memory.renewal[part])
            memory.masked[part] = most
            if part <= VELOCITY:
                memory.masked[FIX] = memory.masked[VELOCITY] = most
    memory.garbage = 1.0 if bad > 1 else 0.0
    for part in range(PARTS.shape[0]):
        for j in range(PARTS[part, 0], PARTS[part, 1]):
            out[j] = math.nan if memory.masked[part] > 0.0 or bad > 1 else z[j]


@inlined
def _shows_motion(part, memory, given):
    """Return whether a sensor would show something new, as the boat moved since it did.

    A velocity of coarse steps repeats itself at a steady speed: it must differ from that of the
    filter in force by a step and :data:`CHANGED_SD`.
    """
    bank = memory.bank
    one = bank.filters[int(bank.force_filter)]
    speed = math.hypot(one.x[VN], one.x[VE])
    if bank.begun == 0.0:
        return False
    if part == COMPASS:
        return memory.turned > memory.step[part] + CHANGED_SD * math.sqrt(given.bank.compass_var)
    if part <= VELOCITY and speed * memory.unchanged[part] < math.sqrt(given.bank.fix_var):
        return False
    step, var = memory.step[part], given.bank.velocity_var
    if part == VELOCITY and (step == 0.0 or step > COARSE * math.sqrt(var)):
        off = math.hypot(one.x[VN] - memory.last[2], one.x[VE] - memory.last[3])
        sd = math.sqrt(var + max(one.P[VN, VN], one.P[VE, VE]))
        if off < step + CHANGED_SD * sd:
            return False
    return speed > (MOVING_SHARE if part <= VELOCITY else 2.0 * MOVING_SHARE) * given.drives.speed


@inlined
def find_frozen(dt, memory, given):
    """Leave out samples that repeat themselves; one that does so while the boat moves is frozen.

    A log may have more rows than a sensor has samples, and a coarse or resting one gives the same
    number for long. So a repeated sample counts as none, but once in a while.
    """
    bank, z = memory.bank, memory.z
    one = bank.filters[int(bank.force_filter)]
    rate = abs(one.x[G]) if one.uses_gyro == 0.0 else abs(bank.epoch_rate - one.x[G])
    if not math.isnan(rate):
        memory.turned += dt * rate
    for part in range(PARTS.shape[0]):
        memory.unchanged[part] += dt
        memory.unused[part] += dt
        first, end = PARTS[part, 0], PARTS[part, 1]
        if math.isnan(z[first]):
            continue
        same = True
        for j in range(first, end):
            same = same and z[j] == memory.last[j]
        typical = max(memory.renewal[part], bank.row)
        if same:
            long = memory.unchanged[part] > (FROZEN_INTERVALS - 0.5) * typical
            memory.frozen[part] = 1.0 if long and _shows_motion(part, memory, given) else 0.0
            if part <= COMPASS and memory.unused[part] < max(REPEAT_USED_S, 2.0 * typical):
                for j in range(first, end):
                    z[j] = math.nan
                continue
        else:
            passed = memory.unchanged[part]
            if memory.frozen[part] == 0.0 and passed < RENEWAL_MAX_S:
                share = 1.0 if memory.renewal[part] == 0.0 else 0.1
                memory.renewal[part] += share * (passed - memory.renewal[part])
            memory.unchanged[part] = memory.frozen[part] = 0.0
            if part == COMPASS:
                memory.turned = 0.0
            step = 0.0
            for j in range(first, end):
                step = math.hypot(step, z[j] - memory.last[j])
                memory.last[j] = z[j]
            if step < memory.step[part] or (memory.step[part] == 0.0 and not math.isnan(step)):
                memory.step[part] = step
        memory.unused[part] = 0.0
