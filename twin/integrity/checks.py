"""Kernel that holds the sensors and commands of a row against each other, and leaves out faults.

Information flows down once: what a sensor cannot give (:mod:`twin.integrity.screening`), the bank
of filters and its test (:mod:`twin.integrity.bank`), which of them is in force
(:mod:`twin.integrity.decision`), and the commands against the motion that it says
(:mod:`twin.integrity.commands`).
"""

from __future__ import annotations

import math

from twin.integrity.bank import (
    A1,
    A2,
    GAP_S,
    LEFT_OUT,
    NO_ACCELEROMETERS,
    NO_COMPASS,
    NO_GYRO,
    NO_VELOCITY,
    PSI,
    RETURN_S,
    ROWS_HELD_MAX,
    SENSED,
    SILENT_S,
    THRUST,
    VE,
    VN,
    WINDOWS,
    G,
    advance_bank,
    window_ratio,
)
from twin.integrity.commands import (
    LEARN_LOG_RATIO_MAX,
    LEFT_DEAD,
    RIGHT_DEAD,
    SOUND,
    WARM_UP_STEPS,
    most_evidence,
    watch_commands,
)
from twin.integrity.decision import DECIDE_S, decide
from twin.integrity.screening import PARTS, find_frozen, screen
from twin.integrity.state import (
    ABSENT,
    COMMANDS,
    CONTRADICTS,
    DOUBTFUL,
    EXCLUDED,
    FROZEN,
    GPS,
    HYPOTHESIS_REASON,
    IMPOSSIBLE,
    NEVER_S,
    NO_REASON,
    OK,
    OLD,
    SILENT,
    VELOCITY_OUT,
)
from twin.integrity.wind import check_wind
from usv_kernel.jit import inlined, kernel

__all__ = ["check_sensors", "write_restart"]


@inlined
def _set(memory, sensor, status, reason):
    """Set the status of a sensor, and since when it is so; count the changes."""
    one = memory.sensors[sensor]
    if one.status != status or one.reason != reason:
        if one.status != status:
            one.since = memory.clock - (one.silent if status == ABSENT else 0.0)
        one.status, one.reason = status, reason


@inlined
def _all_statuses(memory):
    """Return one number for the statuses of all sensors: the digits of a number to base 4.

    The digits of the wind are its status and whether it is known or has a reason.
    """
    wind = memory.wind
    number = 1.0 if wind.reason > 0.0 or wind.known > 0.0 else 0.0
    number = 4.0 * number + wind.status
    for sensor in range(COMMANDS + 1):
        number = 4.0 * number + memory.sensors[sensor].status
    return number


@inlined
def _may_be_at_fault(bank, sensor):
    """Return whether a filter passes that leaves a sensor out."""
    found = False
    for k in range(1, LEFT_OUT.shape[0]):
        left = LEFT_OUT[k, sensor + 1] > 0.0 or (sensor == GPS and LEFT_OUT[k, 0] > 0.0)
        found = found or (left and bank.filters[k].ratio < 1.0)
    return found


@inlined
def _await_backlog(dt, memory):
    """Note that the samples of a row may be old, as all sensors had been silent together.

    What stalled hands out what it missed. At twice its pace this takes as long as the silence. So
    samples are held back until the filters have passed with them for a while.
    """
    bank, silence = memory.bank, math.inf
    for aid in range(SENSED):
        silence = min(silence, bank.age[aid] + dt)
    for k in range(2):
        silence = min(silence, bank.imu_age[k] + dt)
    memory.backlog, memory.heard = max(memory.backlog - dt, 0.0), memory.heard + dt
    if memory.backlog == 0.0:
        memory.old = 0.0
    if bank.begun > 0.0 and silence > max(SILENT_S, ROWS_HELD_MAX * bank.row):
        memory.backlog, memory.heard = min(silence, GAP_S), 0.0


@inlined
def _holds_back(memory):
    """Return whether samples that may be old are not used."""
    return memory.old > 0.0 or (memory.backlog > 0.0 and memory.heard < RETURN_S)


@inlined
def _set_statuses(dt, z, memory):
    """Set the status of each sensor, and its reason."""
    bank = memory.bank
    force = int(bank.force_filter)
    for sensor in range(COMMANDS):
        one, first = memory.sensors[sensor], PARTS[sensor + 1, 0] if sensor > GPS else 0
        one.silent = 0.0 if not math.isnan(z[first]) else one.silent + dt
        frozen = memory.frozen[sensor + 1] > 0.0 or (sensor == GPS and memory.frozen[0] > 0.0)
        masked = memory.masked[sensor + 1] > 0.0 or memory.garbage > 0.0
        left = LEFT_OUT[force, sensor + 1] > 0.0 or (sensor == GPS and LEFT_OUT[force, 0] > 0.0)
        if masked:
            _set(memory, sensor, EXCLUDED, IMPOSSIBLE)
        elif memory.old > 0.0 and one.silent <= SILENT_S:
            _set(memory, sensor, EXCLUDED, OLD)
        elif _holds_back(memory):
            _set(memory, sensor, ABSENT, SILENT)
        elif frozen:
            _set(memory, sensor, EXCLUDED, FROZEN)
        elif left and one.silent > SILENT_S:
            _set(memory, sensor, ABSENT, SILENT)
        elif left and force == NO_VELOCITY:
            _set(memory, sensor, DOUBTFUL, VELOCITY_OUT)
        elif left:
            _set(memory, sensor, EXCLUDED, CONTRADICTS)
        elif one.silent > SILENT_S:
            _set(memory, sensor, ABSENT, SILENT if one.status > ABSENT or one.reason > 0.0 else 0.0)
        elif memory.decision.in_doubt > 0.0 and _may_be_at_fault(bank, sensor):
            _set(memory, sensor, DOUBTFUL, CONTRADICTS)
        elif one.silent == 0.0 or one.status > ABSENT:
            _set(memory, sensor, OK, NO_REASON)
    commands = memory.drives
    h = int(commands.hypothesis)
    if commands.impossible > 0.0:
        _set(memory, COMMANDS, EXCLUDED, IMPOSSIBLE)
    elif h == SOUND:
        _set(memory, COMMANDS, OK, NO_REASON)
    elif h in (LEFT_DEAD, RIGHT_DEAD):
        # the boat has changed: its commands are used, and the twin learns what they do now
        _set(memory, COMMANDS, DOUBTFUL, HYPOTHESIS_REASON + h - 1)
    else:
        _set(memory, COMMANDS, EXCLUDED, HYPOTHESIS_REASON + h - 1)


@inlined
def _watch(dt, cmd, memory, given):
    """Compare the commands with the motion that the filter in force estimates."""
    bank = memory.bank
    one = bank.filters[int(bank.force_filter)]
    c, s = math.cos(one.x[PSI]), math.sin(one.x[PSI])
    u, v = one.x[VN] * c + one.x[VE] * s, one.x[VE] * c - one.x[VN] * s
    gyro = bank.epoch_rate - bank.filters[0].x[G]
    rate = gyro if one.uses_gyro > 0.0 and not math.isnan(gyro) else one.x[G]
    sound = bank.filters[0]
    bias = (sound.x[A1], sound.x[A2]) if sound.uses_accelerometers > 0.0 else (0.0, 0.0)
    forces = (memory.z[6] - bias[0], memory.z[7] - bias[1])
    # the origin moves otherwise than the IMU where it turns
    v += rate * given.bank.origin_arm[0]
    u -= rate * given.bank.origin_arm[1]
    turns = min(bank.imu_age[0] if one.uses_gyro > 0.0 else NEVER_S, bank.age[2]) < KNOWN_S
    known, doubted = bank.begun > 0.0 and turns and memory.old == 0.0, memory.contradicted > 0.0
    force, has_gps = int(bank.force_filter), False
    for aid in range(2):
        has_gps = has_gps or (bank.age[aid] < SILENT_S and LEFT_OUT[force, aid] == 0.0)
    headings = bank.filters[NO_COMPASS].x[PSI], bank.filters[NO_GYRO].x[PSI]
    motion = (rate, u, v, *headings, sound.P[A1, A1])
    watch_commands(
        dt, cmd, motion, forces, known, doubted, has_gps, memory.clock, memory.drives, given.drives
    )
    return has_gps


@inlined
def _aid_bank(memory, has_gps, given):
    """Give the bank what the commands make, where a step of theirs has just ended."""
    bank, drives = memory.bank, memory.drives
    sound = drives.hypothesis == SOUND and drives.impossible <= 0.0
    sound = sound and drives.steps > WARM_UP_STEPS
    sound = sound and most_evidence(drives) < LEARN_LOG_RATIO_MAX
    bank.modelled = 1.0 if sound and not has_gps else 0.0
    if drives.said == 0.0:
        return
    drives.said = 0.0
    span, scale = drives.length, given.drives.speed / drives.length
    for axis in range(2):
        bank.push[axis] = drives.push[axis] * scale
        bank.excess[axis] = drives.excess[axis] * scale
        bank.push_var[axis] = drives.push_var[axis] * scale**2
    bank.samples[THRUST], bank.interval[THRUST] = 1.0, span


@kernel
def write_restart(memory, given, restart):
    """Write where the filter in force is to ``RESTART``, for the navigation to begin again from.

    Without GPS a filter without a ship's model knows no better where the boat is: only the heading
    and, without accelerometers, the surge by the commands begin again.
    """
    bank, has_gps = memory.bank, memory.switched == SWITCHED_WITH_GPS
    k = int(bank.force_filter)
    one = bank.filters[k]
    x, P, state, cov = one.x, one.P, restart.state, restart.cov
    c, s = math.cos(x[PSI]), math.sin(x[PSI])
    gyro = bank.rate - x[G]
    rate = gyro if one.uses_gyro > 0.0 and not math.isnan(gyro) else x[G]
    ahead, side = given.bank.origin_arm[0], given.bank.origin_arm[1]
    state[0], state[1] = x[0] + c * ahead - s * side, x[1] + s * ahead + c * side
    state[2], state[5] = x[PSI], rate
    # no faster than the boat has sailed
    share = min(1.0, bank.fastest / max(math.hypot(x[VN], x[VE]), 1e-9))
    state[3] = share * (x[VN] * c + x[VE] * s) - rate * side
    state[4] = share * (x[VE] * c - x[VN] * s) + rate * ahead
    for i in range(6):
        for j in range(6):
            cov[i, j] = 0.0
    drift = given.bank.fix_bias_var
    cov[0, 0], cov[1, 1] = P[0, 0] + drift, P[1, 1] + drift
    cov[0, 1] = cov[1, 0] = P[0, 1]
    cov[2, 2] = P[PSI, PSI] + given.bank.compass_bias_var
    for i in range(2):
        for j in range(2):
            a = (c, s) if i == 0 else (-s, c)
            b = (c, s) if j == 0 else (-s, c)
            total = 0.0
            for m in range(2):
                for n in range(2):
                    total += a[m] * P[VN + m, VN + n] * b[n]
            cov[3 + i, 3 + j] = total
        for m in range(2):
            cov[m, 3 + i] = P[m, VN] * (c if i == 0 else -s) + P[m, VE] * (s if i == 0 else c)
            cov[3 + i, m] = cov[m, 3 + i]
    cov[5, 5] = P[G, G] + given.bank.gyro_var
    used = False
    for aid in range(2):
        used = used or (bank.age[aid] < SILENT_S and LEFT_OUT[k, aid] == 0.0)
    reckons = has_gps and one.uses_accelerometers > 0.0
    restart.position = 1.0 if used or reckons else 0.0
    restart.heading = 1.0 if has_gps or LEFT_OUT[k, 2] + LEFT_OUT[k, 3] > 0.0 else 0.0
    restart.surge, restart.lost = 0.0, memory.old
    drives = memory.drives
    if not has_gps and k == NO_ACCELEROMETERS and drives.steps > WARM_UP_STEPS:
        restart.surge = 1.0
        surge = drives.surges[int(drives.hypothesis)] * given.drives.speed
        state[3], state[4] = min(max(surge, -bank.fastest), bank.fastest), 0.0
        for i in range(3, 5):
            for j in range(6):
                cov[i, j] = cov[j, i] = 0.0
            cov[i, i] = (RESTART_SD * given.drives.speed) ** 2


SWITCHED = 1.0
SWITCHED_WITH_GPS = 2.0
"""Another filter has come into force, without and with a GPS before."""

KNOWN_S = 1.0
"""The yaw rate is known by a sample of gyro or compass that is no older."""

RESTART_SD = 0.2
"""Standard deviation of surge from the commands and of zero sway, in nominal speeds."""


@kernel
def check_sensors(dt, z, cmd, state, ready, memory, given, out):
    """Test the sensors of a row against each other, and exclude those at fault.

    Parameters
    ----------
    dt : float
        Time since the row before, s.
    z, cmd : ndarray, shapes (19,), (4,)
        The row.
    state : ndarray, shape (6,)
        State that the predictor had after the row before; for the wind only.
    ready : bool
        Whether that means anything.
    memory, given : record
        ``INTEGRITY``, advanced in place; ``INTEGRITY_SETTINGS``.
    out : ndarray, shape (19,)
        The row without the samples of what is left out, and with the true wind of an anemometer.
    """
    memory.clock += dt
    for j in range(out.shape[0]):
        out[j] = z[j]
    screen(dt, z, memory, given)
    for j in range(PARTS[4, 1]):
        out[j] = memory.z[j]
    find_frozen(dt, memory, given)
    for part in range(PARTS.shape[0]):
        if memory.frozen[part] > 0.0:
            for j in range(PARTS[part, 0], PARTS[part, 1]):
                out[j] = memory.z[j] = math.nan
    bank = memory.bank
    memory.switched = 0.0
    has_gps = _watch(dt, cmd, memory, given)
    _aid_bank(memory, has_gps, given)
    _await_backlog(dt, memory)
    tested = advance_bank(dt, memory.z, memory.old > 0.0, bank, given.bank)
    failing = tested and bank.filters[int(bank.force_filter)].ratio >= 1.0
    if failing and memory.backlog > 0.0 and memory.heard < DECIDE_S:
        memory.old, memory.decision.failing_since = 1.0, -1.0
    elif tested:
        drives = memory.drives
        switched = decide(bank, memory.decision, drives.yaw_witness, given.bank)
        if switched:
            memory.switched = SWITCHED_WITH_GPS if has_gps else SWITCHED
            # the motion begins again: a step of the commands that spans it would be wrong
            drives.known = 0.0
    if memory.old > 0.0 and has_gps:
        # as far as is known, the boat is near where it was
        memory.switched = SWITCHED_WITH_GPS
    force = int(bank.force_filter)
    for part in range(PARTS.shape[0]):
        if LEFT_OUT[force, part] > 0.0 or _holds_back(memory):
            for j in range(PARTS[part, 0], PARTS[part, 1]):
                out[j] = math.nan
    memory.contradicted = 0.0
    if memory.decision.in_doubt > 0.0:
        # what fails at once is not used until it is known what is wrong
        for aid in range(SENSED):
            for window in range(WINDOWS):
                if window_ratio(bank.filters[force], aid, window, bank) >= 1.0:
                    memory.contradicted = 1.0
                    for j in range(PARTS[aid, 0], PARTS[aid, 1]):
                        # what errs slowly is too little to harm
                        out[j] = math.nan if window == 0 else out[j]
    _set_statuses(dt, z, memory)
    h = memory.drives.hypothesis
    out_of_force = h != SOUND and h != LEFT_DEAD and h != RIGHT_DEAD
    memory.commands_doubted = 1.0 if memory.drives.impossible > 0.0 or out_of_force else 0.0
    doubted = memory.decision.in_doubt > 0.0
    for part in range(3):
        doubted = doubted or LEFT_OUT[force, part] > 0.0
    memory.motion_doubted = 1.0 if doubted else 0.0
    check_wind(dt, out, state, ready, memory, given)
    memory.statuses = _all_statuses(memory)
