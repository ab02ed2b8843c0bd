"""Kernel that holds the commands against the motion that they should make.

Filters say how yaw rate and surge would change if the commands came as given, reversed, with sides
swapped, with one thruster dead, or not at all. The one that explains the motion best says what is
wrong with them: a sequential test of likelihood ratios (Page 1954; Willsky and Jones 1976).
"""

from __future__ import annotations

import math

from twin.channels import R, U, V
from twin.health.drives.filters import (
    AS_GIVEN,
    DIFFERENCE,
    HELD,
    LEFT_DEAD,
    MOMENT,
    RIGHT_DEAD,
    SIDES_SWAPPED,
    SURGE,
    WARM_UP,
    YAW,
    begin_filters,
    copy_filter,
    is_surge_unknown,
    log_likelihood,
    restart_motion,
    step_filter,
    thrust_of,
    write_effects,
)
from twin.health.evidence import CLEAR
from twin.health.state import (
    ABSENT,
    ACCELEROMETERS,
    COMMAND,
    DOUBTFUL,
    DRIVE,
    EXCLUDED,
    GPS,
    HYPOTHESES,
    IMPOSSIBLE,
    N_COMMANDS,
    NO_ANSWER,
    NO_LEFT,
    NO_REASON,
    NO_RIGHT,
    OK,
    WRONG_SIGN,
)
from usv_kernel.jit import inlined, kernel

__all__ = ["CHANGED", "check_commands", "step_seconds"]

STEP, STEP_MIN = 0.35, 0.9
"""A step, in lengths over nominal speed and in s: in shorter ones waves hide what commands do, in
longer ones drag answers."""

STEP_LONG = 1.7
"""A step that became longer than so many is a gap: the mean drive says little of it."""

FIRST_STEPS, LEVEL_STEPS, LEVEL_CUT = 4.0, 80.0, 9.0
"""Steps in which the level of the waves is not yet learned faster, steps over which it is averaged,
and most that a squared innovation counts in it, in its variances."""

LEVEL_FIRST, LEVEL_MIN, LEVEL_MAX = 0.01, 0.009, 0.3
"""First, least and largest level of the waves, in nominal units."""

EVIDENCE_MAX, DRIFT, FADE = 16.0, 0.5, 0.99
"""Evidence for a hypothesis: the sum of its log-likelihood less that of the one in force. A step
counts up to the first number, and takes the second off. What was gathered fades by the third."""

DISTINCT, DISTINCT_FADE = 0.5, 0.7
"""A step in which two hypotheses make the drives differ by less (in nominal thrusts) counts less.
Their difference fades so in a step: the motion that it made remains."""

DECIDED, DECIDED_STOP = 16.0, 8.0
"""Evidence above which a hypothesis comes into force. The second is for a boat that does not stop
although its commands are zero; this is asked at stops only."""

SUSPECT, LEVEL_SUSPECT = 1.0, 45.0
"""Evidence above which a step is not one before anything was at odds, and above which the level of
the waves is not learned: the fault would become the level."""

IDLE = 0.1
"""A boat lies idle below this nominal thrust, speed and yaw rate. Nothing is learned then: the
level of the waves would fall to its least."""

RECENT = 3.0
"""Steps over which the mismatch is averaged."""

UNEXPLAINED, AGREED, SQUARE_MAX = 15.0, 4.0, 25.0
"""Mean squared innovations, in their variances: above the first, commands are doubtful whatever
explains them; below the second they agree. A step counts up to the third."""

AT_ODDS_ABOVE, HELD_STEPS = 7.0, 6.0
"""Above this mismatch the parameters are held, for so many steps at most. They would else learn
that nothing brakes the boat, and explain commands that do not reach it."""

SIGN_SURE, SIGN_KEPT, CORRELATED_STEPS = 2.5, 1.0, 4.0
"""Standard deviations by which an effect must be negative to be named, and to stay so. So many
neighbouring steps have the same error, as a wave lasts longer than a step."""

AGAINST_THRUST, AGAINST_SPEED, AGAINST_TIME = 0.1, 0.3, 15.0
"""Nominal thrust and speed of a boat that goes against its thrust, and how long (s) it must: one
that brakes stops sooner, and a current is slower."""

AT_REST = 1e-9
"""Shafts are at rest below it, in nominal speeds."""

CHANGED = 6.0
"""What is still doubtful after so long is a boat that has changed, s."""

CALM, GIVE_IN = 2.0, 60.0
"""Impossible commands come back after good ones for so long, s; excluded ones of any kind after
the second time. They are then learned as they are."""

CALM_STEPS = 2.0
"""Commands that did not reach the boat come back after they explained so many steps."""

KNOWN_TIME = 2.0
"""After a sensor of the motion came back, the estimated motion needs so long to be right, s."""

SHAFT_MAX, ANGLE_MAX = 20.0, 7.0
"""Commands beyond are impossible: shaft speed in nominal ones, drive angle in rad (a unit slip
to degrees is found by ``usv-twin check``)."""

LAG_MIN = 0.05
"""Least lag of the actuators, s."""


@inlined
def step_seconds(given):
    """Return the least length of a step, s."""
    return max(STEP * given.time_scale, STEP_MIN)


@inlined
def _set(health, status, reason):
    """Set status and reason of the commands."""
    check = health.sensors[COMMAND]
    if check.status != status or check.reason != reason:
        check.status, check.reason, check.since = status, reason, health.clock


@inlined
def _put_in_force(k, health):
    """Take a hypothesis for true, and say so."""
    health.hypothesis = k
    if k == AS_GIVEN:
        _set(health, OK, NO_REASON)
    elif k == LEFT_DEAD:
        # the boat has changed: the commands are used, and the twin learns what they do now
        _set(health, DOUBTFUL, NO_LEFT)
    elif k == RIGHT_DEAD:
        _set(health, DOUBTFUL, NO_RIGHT)
    elif k == HELD:
        _set(health, EXCLUDED, NO_ANSWER)
        health.sensors[COMMAND].calm = 0.0
    else:
        _set(health, EXCLUDED, WRONG_SIGN)
    for j in range(HYPOTHESES):
        health.evidence[j] = health.distinct[j] = 0.0
    for axis in range(2):
        health.wave_level[axis] = health.quiet_level[axis]
    health.mismatch = 0.0


@inlined
def _is_sign_wrong(T, health):
    """Return whether the boat answers to its commands the wrong way round, and did all the time.

    Steering turns it to the other side, or it goes ahead for long with its thrust astern.
    """
    check, given = health.sensors[COMMAND], health.filters[AS_GIVEN]
    named = check.status == DOUBTFUL and check.reason == WRONG_SIGN
    certain = SIGN_KEPT if named else SIGN_SURE
    wrong = False
    for k in (MOMENT, DIFFERENCE):
        sd = math.sqrt(CORRELATED_STEPS * max(given.P[YAW, k, k], 0.0))
        wrong = wrong or given.x[YAW, k] < -certain * sd
    thrust, u = thrust_of(health.mean_drive), health.motion[1]
    if check.status == EXCLUDED or is_surge_unknown(health):
        health.against_time = 0.0
    elif thrust * u < 0.0 and abs(thrust) > AGAINST_THRUST and abs(u) > AGAINST_SPEED:
        health.against_time = min(health.against_time + T, 2.0 * AGAINST_TIME)
    else:
        health.against_time = max(health.against_time - T, 0.0)
    return wrong or health.against_time > AGAINST_TIME


@inlined
def _learn_level(axis, innovation, S, health):
    """Learn how much the waves move the boat, by the hypothesis in force."""
    level = health.wave_level[axis]
    share = 1.0 / min(max(health.steps - FIRST_STEPS, FIRST_STEPS), LEVEL_STEPS)
    excess = min(innovation * innovation, LEVEL_CUT * S) - S
    square = level * level + share * excess
    health.wave_level[axis] = math.sqrt(min(max(square, LEVEL_MIN**2), LEVEL_MAX**2))


@inlined
def _strongest(health):
    """Return the hypothesis with most evidence."""
    best, most = AS_GIVEN, health.evidence[AS_GIVEN]
    excluded = health.sensors[COMMAND].status == EXCLUDED
    for k in range(1, HYPOTHESES):
        # on the way back from another fault, half the thrust is no dead thruster
        half = k in (LEFT_DEAD, RIGHT_DEAD)
        if health.evidence[k] > most and not (excluded and half):
            best, most = k, health.evidence[k]
    return best


@inlined
def _is_idle(health):
    """Return whether in this step neither the commands made anything nor the boat moved."""
    drive = 0.0
    for k in range(DRIVE):
        drive += abs(health.mean_drive[k])
    return drive < IDLE and abs(health.motion[YAW]) < IDLE and abs(health.motion[SURGE]) < IDLE


@inlined
def _step_filters(length, idle, health):
    """Advance the filters of all hypotheses by a step."""
    force = int(health.hypothesis)
    # a stop at which the boat does not stop would teach that its thrust does nothing
    stop_doubted = health.at_rest > 0.0 and health.evidence[HELD] > SUSPECT
    # what is wrong with the commands must not become the model; what lasts is a boat that changed
    at_odds = health.mismatch > AT_ODDS_ABOVE or stop_doubted
    health.at_odds_steps = health.at_odds_steps + 1.0 if at_odds else 0.0
    held = at_odds and health.at_odds_steps <= HELD_STEPS
    axes = 1 if is_surge_unknown(health) else 2
    learn = health.sensors[COMMAND].status != EXCLUDED and not held and not idle and axes == 2
    suspected = not learn or health.evidence[_strongest(health)] > LEVEL_SUSPECT
    for k in range(HYPOTHESES):
        if k != force and health.evidence[k] <= 0.0:
            copy_filter(health, k, force)
    square = 0.0
    if axes == 1:
        restart_motion(SURGE, health)
    for i in range(HYPOTHESES):
        # the hypothesis in force last: the others are weighed by the level before
        k = i if i < force else i + 1
        if i == HYPOTHESES - 1:
            k = force
        motion = health.filters[k].x[YAW, 0], health.filters[k].x[SURGE, 0]
        health.likelihood[k] = 0.0
        for axis in range(axes):
            innovation, S = step_filter(axis, k, motion, length, learn, health)
            health.likelihood[k] += log_likelihood(innovation, S)
            if k == force:
                square += min(innovation * innovation / S, SQUARE_MAX) / axes
                if not suspected:
                    _learn_level(axis, innovation, S, health)
    health.mismatch += (square - health.mismatch) / RECENT


@inlined
def _add_evidence(health, given):
    """Add the log-likelihood ratios of a step, a cumulative sum (Page 1954)."""
    force = int(health.hypothesis)
    for k in range(HYPOTHESES):
        apart = 0.0
        for j in range(3):
            apart += abs(health.effects[k, j] - health.effects[force, j])
        health.distinct[k] = max(apart, DISTINCT_FADE * health.distinct[k])
        more = min(health.likelihood[k] - health.likelihood[force], EVIDENCE_MAX)
        if more > 0.0:
            more *= min(health.distinct[k] / DISTINCT, 1.0)
        health.evidence[k] = max(FADE * health.evidence[k] + more - DRIFT, 0.0)
    health.evidence[force] = 0.0
    if given.sides == 0.0:
        for k in range(SIDES_SWAPPED, RIGHT_DEAD + 1):
            health.evidence[k] = 0.0


@inlined
def _conclude(wrong, health):
    """Set the status by what explains the motion."""
    check, force = health.sensors[COMMAND], int(health.hypothesis)
    best = _strongest(health)
    if health.evidence[best] > (DECIDED_STOP if best == HELD else DECIDED):
        _put_in_force(best, health)
    elif check.status == EXCLUDED:
        # those found without GPS have no hypothesis
        again = health.at_rest == 0.0 if force == HELD else not is_surge_unknown(health)
        agreed = force in (AS_GIVEN, HELD) and again and health.mismatch < AGREED
        check.calm = check.calm + 1.0 if agreed else 0.0
        if check.calm > CALM_STEPS:
            _put_in_force(AS_GIVEN, health)
    elif force != AS_GIVEN:
        return
    elif check.status == OK:
        if health.mismatch > UNEXPLAINED:
            _set(health, DOUBTFUL, NO_ANSWER)
        elif wrong:
            # learned with its sign, so the commands are used; but nobody meant it
            _set(health, DOUBTFUL, WRONG_SIGN)
    elif check.status == DOUBTFUL:
        over = health.mismatch < AGREED if check.reason == NO_ANSWER else not wrong
        if over:
            _set(health, OK, NO_REASON)


@inlined
def _remember_commands(idle, health):
    """Remember commands and drive of the last step in which nothing was at odds.

    A command to stop is one of them once the boat lies idle: until then it may not have arrived.
    """
    agreed = health.mismatch < AGREED
    stops = health.at_rest > 0.0 and not idle
    for k in range(HYPOTHESES):
        agreed = agreed and health.evidence[k] < SUSPECT
    if health.sensors[COMMAND].status == EXCLUDED or not agreed:
        return
    for k in range(N_COMMANDS):
        health.trusted[k] = health.before[k]
        if not stops:
            health.before[k] = health.row_command[k]
    for k in range(DRIVE):
        health.held_drive[k] = health.drive_before[k]
        if not stops:
            health.drive_before[k] = health.mean_drive[k]
    for axis in range(2):
        health.quiet_level[axis] = health.wave_level[axis]


@inlined
def _end_step(s, step, health, given):
    """Hold the step that ends against what each hypothesis says of it, and learn from it."""
    T = health.step_time
    for k in range(DRIVE):
        health.mean_drive[k] = health.drive_sum[k] / T
        health.drive_sum[k] = 0.0
    health.step_time = 0.0
    sway = s[V] / given.speed
    health.mean_sway = 0.0 if is_surge_unknown(health) else 0.5 * (health.sway + sway)
    health.motion[YAW], health.motion[SURGE] = s[R] * given.time_scale, s[U] / given.speed
    health.sway = sway
    if STEP_LONG * step < T:
        restart_motion(YAW, health)
        return
    length, warm = step / given.time_scale, health.steps > WARM_UP
    if health.steps == 0.0:
        begin_filters(health, length)
        restart_motion(YAW, health)
        health.wave_level[YAW] = health.wave_level[SURGE] = LEVEL_FIRST
        health.hypothesis = AS_GIVEN
        health.steps = 1.0
        return
    write_effects(health)
    idle = _is_idle(health)
    _step_filters(length, idle, health)
    health.steps += 0.0 if idle else 1.0
    wrong = _is_sign_wrong(T, health)
    if warm:
        _add_evidence(health, given)
        if health.sensors[COMMAND].reason != IMPOSSIBLE:
            _conclude(wrong, health)
    _remember_commands(idle, health)


@inlined
def _are_possible(dt, left, right, cmd, health):
    """Return whether the commands are possible, and set their status accordingly."""
    check = health.sensors[COMMAND]
    check.age = 0.0
    if check.status == ABSENT:
        _set(health, OK, check.reason)
    possible = (
        abs(left) < SHAFT_MAX
        and abs(right) < SHAFT_MAX
        and abs(cmd[2]) < ANGLE_MAX
        and abs(cmd[3]) < ANGLE_MAX
    )
    if not possible:
        if check.status != EXCLUDED:
            check.since = health.clock
        check.status, check.reason, check.calm = EXCLUDED, IMPOSSIBLE, 0.0
        health.step_time = -1.0
    elif check.reason == IMPOSSIBLE:
        check.calm += dt
        if check.calm > CALM:
            _put_in_force(int(health.hypothesis), health)
    return possible


@inlined
def _is_motion_known(dt, health):
    """Return whether all that says how the boat moves agrees, and has been in use for a while."""
    known = (
        abs(health.heading_sum) <= CLEAR * health.heading_level
        and abs(health.velocity_sum[0]) <= CLEAR * health.velocity_level
        and abs(health.velocity_sum[1]) <= CLEAR * health.velocity_level
    )
    if not known:
        return False
    for sensor in range(ACCELEROMETERS):
        check = health.sensors[sensor]
        never = check.status == ABSENT and (check.interval == 0.0 or sensor == GPS)
        # a doubtful GPS is used
        known = known and (check.status == OK or check.status == DOUBTFUL or never)
    # with the first fixes after a loss the velocity jumps
    gps = health.sensors[GPS]
    known = known and not (gps.status == OK and gps.since == health.clock)
    health.known_time = health.known_time + dt if known else 0.0
    return health.known_time > KNOWN_TIME


@inlined
def _add_drive(dt, left, right, cmd, health, given):
    """Add what the commands of a row made to the step: the drive follows them with a lag.

    The commands between two rows are taken to be the mean of theirs. The later one may
    answer the motion that it would then explain.
    """
    a, b = left * abs(left), right * abs(right)
    targets = (
        0.5 * a * math.cos(cmd[2]),
        0.5 * b * math.cos(cmd[3]),
        0.5 * a * math.sin(cmd[2]),
        0.5 * b * math.sin(cmd[3]),
    )
    lag = max(given.lag, LAG_MIN)
    share = 1.0 - math.exp(-dt / lag)
    for k in range(DRIVE):
        target = 0.5 * (targets[k] + health.targets[k])
        missing = target - health.drive[k]
        health.drive_sum[k] += target * dt - missing * lag * share
        health.drive[k] += share * missing
        health.targets[k] = targets[k]
    health.step_time += dt
    health.at_rest = 1.0 if abs(left) + abs(right) < AT_REST else 0.0


@inlined
def _begin_step(s, health, given):
    """Begin the first step, or the first after a gap, with the motion of now."""
    health.step_time = 0.0
    for k in range(DRIVE):
        health.drive_sum[k] = 0.0
    health.motion[YAW], health.motion[SURGE] = s[R] * given.time_scale, s[U] / given.speed
    health.sway = s[V] / given.speed
    restart_motion(YAW, health)


@kernel
def check_commands(dt, cmd, s, ready, health, given):
    """Hold commands against yaw rate and surge; note their status.

    The state is that of the row before, and a row's command was in force since then: a step ends
    before the row's command counts.
    """
    n0 = max(given.shaft_speed, 1e-6)
    left, right = cmd[0] / n0, cmd[1] / n0
    if not _are_possible(dt, left, right, cmd, health) or not ready:
        return
    check = health.sensors[COMMAND]
    failed = check.status == EXCLUDED and check.reason != IMPOSSIBLE
    if failed and health.clock - check.since > GIVE_IN:
        # what they do is learned again, as it is
        _put_in_force(AS_GIVEN, health)
        health.steps = 0.0
    known = _is_motion_known(dt, health)
    step = step_seconds(given)
    if known and health.step_time < 0.0:
        _begin_step(s, health, given)
    elif known and health.step_time >= step:
        _end_step(s, step, health, given)
    _add_drive(dt, left, right, cmd, health, given)
    for k in range(N_COMMANDS):
        health.row_command[k] = cmd[k]
    if not known:
        health.step_time = -1.0
        if health.known_time == 0.0:
            for k in range(HYPOTHESES):
                health.evidence[k] = health.distinct[k] = 0.0
