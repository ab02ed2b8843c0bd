"""Faults of sensors, commands and thrusters: what they do, and when."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from tests.usv_gym.world.sample_rows import BIT, BOAT, DT, LEVEL_BIT, N, rows
from twin.sim.wrapper import log_of, make_env
from usv_gym import Bursts, Fault, RandomFaults, SeaState, SensorSuite
from usv_gym.world.channels import GPS_BIT, IMU_BIT
from usv_gym.world.faults import (
    AMOUNTS,
    CHANNELS,
    EFFECTS,
    FAULT_KINDS,
    ON,
    SPIKE_SIZES,
    STRUCK,
    THRUSTERS,
    Disturbance,
    FaultError,
    apply_faults,
    fault_records,
    fault_text,
    memory_rows,
    parse_faults,
)
from usv_gym.world.simulation import Simulation
from usv_kernel.channels import GYRO

COUNT = 200
FIRST, END = 40, 100
"""The rows that a fault of seconds 2 to 5 strikes."""

T = DT * np.arange(COUNT)
NORTHERN = [0, 1, 0, 1] + 9 * [1] + [0, 0, 1, 0] + 4 * [0]
"""Which numbers of a row an error is added to, but those of the GPS."""


def given_rows(seed: int = 0) -> np.ndarray:
    """Return rows of all sensors and of the commands, any numbers."""
    return np.random.default_rng(seed).normal(size=(COUNT, STRUCK))


def with_faults(rows: np.ndarray, *faults: Disturbance, seed: int = 0) -> np.ndarray:
    """Return rows (N, 21) with faults."""
    rng = np.random.default_rng(seed)
    z, cmd = rows[:, :CHANNELS], rows[:, CHANNELS:]
    return np.hstack(apply_faults(DT * np.arange(len(rows)), z, cmd, faults, rng))


def seconds_2_to_5(kind: str, effect: str, **how: float) -> Fault:
    return Fault(kind, 2.0, 3.0, effect=effect, **how)


ROWS_KINDS = [
    (kind, effect) for effect in EFFECTS for kind in AMOUNTS[effect] if kind not in THRUSTERS
]


@pytest.mark.parametrize(("kind", "effect"), ROWS_KINDS)
def test_each_effect_does_what_it_says_in_its_time_to_its_own(kind: str, effect: str) -> None:
    rows, fault = given_rows(), seconds_2_to_5(kind, effect, chance=1.0)
    mine = (FAULT_KINDS[kind] & BIT) != 0
    struck, end = with_faults(rows, fault), END + (END - FIRST if effect == "stall" else 0)
    np.testing.assert_array_equal(struck[:, ~mine], rows[:, ~mine])
    np.testing.assert_array_equal(struck[:FIRST], rows[:FIRST])
    np.testing.assert_array_equal(struck[end:], rows[end:])
    out, inside = struck[FIRST:END, mine], rows[FIRST:END, mine]
    assert mine.any() and not np.array_equal(out, inside)
    since, amount = (T[FIRST:END] - 2.0)[:, None], fault.amount
    if effect == "loss":
        assert np.isnan(out).all()
    elif effect == "frozen":
        np.testing.assert_array_equal(out, np.broadcast_to(rows[FIRST - 1, mine], out.shape))
    elif effect == "spikes":
        sizes = np.array(SPIKE_SIZES)[mine[:CHANNELS]]
        np.testing.assert_allclose(np.abs(out - inside), np.broadcast_to(sizes, out.shape))
    elif effect in ("zero", "sign", "scale"):
        factor = {"zero": 0.0, "sign": -1.0, "scale": amount}[effect]
        np.testing.assert_array_equal(out, factor * inside)
    elif effect == "jump":
        north = np.zeros(STRUCK)
        north[0] = amount
        np.testing.assert_array_equal(out, inside + north[mine])
    elif effect in ("bias", "ramp"):
        where = np.array(NORTHERN)
        where[:4] = 1, 0, 1, 0
        grows = since if effect == "ramp" else np.ones_like(since)
        grows = np.broadcast_to(grows, out.shape).copy()
        if kind == "gps":  # the velocity is the one with which the fixes move
            grows[:, 2] = 1.0
        np.testing.assert_allclose(out, inside + amount * grows * where[mine], atol=1e-12)
    elif effect == "late":
        rows_late = round(amount / DT)
        np.testing.assert_array_equal(out, rows[FIRST - rows_late : END - rows_late, mine])
    elif effect == "swapped":
        np.testing.assert_array_equal(np.sort(out), np.sort(inside))
        again = with_faults(rows, fault, fault)[FIRST:END, mine]
        np.testing.assert_array_equal(again, inside)
    elif effect == "garbage":
        assert np.isfinite(out).all() and np.abs(out).max() > 1e6 * np.abs(inside).max()
    else:
        held = kind in ("commands", "steering")
        np.testing.assert_array_equal(
            out, np.broadcast_to(rows[FIRST - 1, mine] if held else math.nan, out.shape)
        )


def test_swapped_are_north_and_east_axes_and_sides() -> None:
    rows = given_rows()
    for kind, order in (
        ("fixes", {0: 1}),
        ("gps", {0: 1, 2: 3}),
        ("accelerometers", {6: 7}),
        ("commands", {17: 18, 19: 20}),
        ("steering", {19: 20}),
    ):
        expected = rows.copy()
        for i, j in order.items():
            expected[FIRST:END, [i, j]] = rows[FIRST:END, [j, i]]
        np.testing.assert_array_equal(
            with_faults(rows, seconds_2_to_5(kind, "swapped")), expected, err_msg=kind
        )


@pytest.mark.parametrize("every", [1, 4, 20])
def test_a_stall_hands_out_what_was_missed_at_twice_the_pace(every: int) -> None:
    """Where there is time for it: of samples in every row, every other one is left out."""
    rows = given_rows()
    rows[np.arange(COUNT) % every != 0, :4] = math.nan
    out = with_faults(rows, seconds_2_to_5("gps", "stall"))[:, 0]
    given = rows[:, 0]
    # row 100 + k says what row 40 + 2 k would have, and that of the row before
    for k in range(END - FIRST):
        newest = [v for v in given[FIRST + max(2 * k - 1, 0) : FIRST + 2 * k + 1] if v == v]
        expected = newest[-1] if newest else math.nan
        np.testing.assert_equal(out[END + k], expected)
    missed = given[FIRST : 2 * END - FIRST]
    missed, again = missed[np.isfinite(missed)], out[END : 2 * END - FIRST]
    again = again[np.isfinite(again)]
    np.testing.assert_array_equal(again, missed[:: 2 if every == 1 else 1])


def test_late_samples_keep_their_rate_and_none_comes_twice() -> None:
    rows = given_rows()
    rows[np.arange(COUNT) % 10 != 0, 4] = math.nan
    out = with_faults(rows, seconds_2_to_5("compass", "late", amount=0.7))
    expected = rows.copy()
    expected[FIRST:END, 4] = rows[FIRST - 14 : END - 14, 4]
    np.testing.assert_array_equal(out, expected)


def test_a_fault_of_delay_reaches_back_and_others_do_not() -> None:
    assert memory_rows(ON, DT) == 0
    late, stall = Fault("gps", 0.0, 9.0, effect="late", amount=1.5), Fault("all", 0.0, 4.0)
    assert memory_rows([late, stall], DT) == 32
    stalls = RandomFaults("all", effect="stall", duration=(1.0, 4.0))
    assert memory_rows([late, stalls], DT) == 82
    assert Simulation(1, BOAT, SeaState(), faults=[late]).config["fault_memory_rows"] == 32


def test_random_stalls_catch_up_before_the_next() -> None:
    rows = np.tile(np.arange(4000.0)[:, None], (1, STRUCK))
    stalls = RandomFaults("gps", effect="stall", gap=(0.1, 1.0), duration=(1.0, 4.0))
    out = with_faults(rows, stalls)[:, 0]
    there = np.isfinite(out)
    late = np.flatnonzero(there) - out[there]
    assert np.all(np.diff(out[there]) > 0.0)
    # some come at once, some as late as the longest stall
    assert late.min() == 0.0 and 60.0 < late.max() <= 80.0 and np.mean(~there) > 0.2


def test_a_ramp_grows_from_the_start_of_each_window() -> None:
    rows = np.zeros((4000, STRUCK))
    ramps = RandomFaults("compass", effect="ramp", amount=0.2, gap=(1.0, 2.0), duration=(1.0, 3.0))
    off = with_faults(rows, ramps)[:, 4]
    assert 0.35 < off.max() <= 0.6 and (off == 0.0).mean() > 0.3
    steps = np.diff(off)
    np.testing.assert_allclose(steps[(off[:-1] > 0.0) & (off[1:] > 0.0)], 0.2 * DT)


def test_thrusters_fail_and_what_is_reported_does_not() -> None:
    """The boat sails as one that is commanded so."""
    command = np.array([[N, 0.8 * N, 0.1, 0.1]])

    def sail(*faults: Disturbance, left: float = 1.0) -> tuple[np.ndarray, Simulation]:
        sim = Simulation(1, BOAT, SeaState.named("2"), faults=faults)
        sim.reset([0], [np.random.default_rng(1)])
        states = []
        for k in range(150):
            failed = command * [[left, 1.0, 1.0, 1.0]] if 40 <= k < 100 else command
            sim.step(failed)
            states.append(sim.state[0].copy())
        return np.array(states), sim

    for effect, factor in (("zero", 0.0), ("scale", 0.7), ("sign", -1.0)):
        states, sim = sail(seconds_2_to_5("left", effect))
        np.testing.assert_array_equal(states, sail(left=factor)[0])
        np.testing.assert_array_equal(sim.reported, command)
        np.testing.assert_array_equal(sim.cmd, command)
    with pytest.raises(FaultError, match="simulated"):
        with_faults(given_rows(), Fault("right", 0.0, 1.0, effect="zero"))


def test_faulty_commands_reach_the_twin_and_not_the_boat() -> None:
    faults = [Fault("commands", 2.0, 30.0, effect="sign")]
    sound, struck = (
        make_env(twin="ukf", sea="2", task="free", faults=some, record=True)
        for some in ([], faults)
    )
    for env in (sound, struck):
        env.reset(seed=1)
        for k in range(400):
            env.step(np.array([0.6, math.sin(0.1 * k)], np.float32))
    one, other = log_of(sound), log_of(struck)
    np.testing.assert_array_equal(one.truth, other.truth)
    np.testing.assert_array_equal(one.z, other.z)
    np.testing.assert_array_equal(one.cmd[40:], -other.cmd[40:])
    np.testing.assert_array_equal(struck.unwrapped.twin.cmd, -sound.unwrapped.twin.cmd)
    assert not np.array_equal(*(env.unwrapped.twin.predictor.state for env in (sound, struck)))


def struck(fault: Disturbance, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return measurements without and with a fault, all sensors at each step."""
    suite = dataclasses.replace(SensorSuite(), gps_latency=0.0, wind_latency=0.0, wind_rate=20.0)
    return rows(suite, count, seed, dof=6), rows(suite, count, seed, faults=[fault], dof=6)


def test_spikes_come_with_their_chance_and_either_sign() -> None:
    sizes = (30.0, 31.0, 3.0, 4.0, 1.0, 0.2, 6.0, 7.0, 0.3, 0.4, 8.0, 0.5, 0.6, 32.0, 5.0)
    fault = Fault("all", 0.0, 1e4, effect="spikes", chance=0.2, sizes=sizes)
    clean, z = struck(fault, 20_000)
    off = z - clean
    hit = off[:, 0] != 0.0
    # binomial: sd .0028; three times that
    assert hit.mean() == pytest.approx(0.2, abs=0.009)
    for j, size in enumerate(sizes):
        np.testing.assert_allclose(np.abs(off[hit, j]), size, rtol=1e-9)
        assert np.all(off[~hit, j] == 0.0)
        # 4000 signs: mean to .016; four times that (36 numbers are looked at)
        assert abs(np.sign(off[hit, j]).mean()) < 0.064
        for i in range(j):
            assert abs(np.mean(np.sign(off[hit, i] * off[hit, j]))) < 0.064


def spans(gone: np.ndarray) -> np.ndarray:
    """Return the lengths of the whole runs of True between two False."""
    edges = np.diff(np.concatenate([[0], gone.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    inside = (first > 0) & (last < len(gone))
    return (last - first)[inside]


@pytest.mark.parametrize(("loss", "mean"), [(0.1, 2.0), (0.3, 0.5), (0.05, 0.1)])
def test_bursts_have_their_share_and_length(loss: float, mean: float) -> None:
    count = 400_000
    t, z = DT * np.arange(count), np.zeros((count, 8))
    cmd = np.zeros((count, 4))
    out, _ = apply_faults(t, z, cmd, [Bursts("gps", loss, mean)], np.random.default_rng(5))
    gone = np.isnan(out[:, 0])
    np.testing.assert_array_equal(np.isnan(out), gone[:, None] & ((LEVEL_BIT & GPS_BIT) != 0))
    r = DT / mean
    p = r * loss / (1.0 - loss)
    # a two-state chain: memory 1 - p - r gives the share its spread; bursts are geometric
    memory = 1.0 - p - r
    sd = math.sqrt(loss * (1.0 - loss) * (1.0 + memory) / (1.0 - memory) / count)
    assert gone.mean() == pytest.approx(loss, abs=3.0 * sd)
    bursts = spans(gone)
    sd = math.sqrt((1.0 - r) / r**2 / len(bursts))
    assert bursts.mean() == pytest.approx(1.0 / r, abs=3.0 * sd)


def test_random_faults_keep_their_gaps_and_lengths() -> None:
    count = 400_000
    t, z = DT * np.arange(count), np.zeros((count, 8))
    fault = RandomFaults("imu", gap=(2.0, 6.0), duration=(1.0, 3.0), start=10.0)
    out, _ = apply_faults(t, z, np.zeros((count, 4)), [fault], np.random.default_rng(6))
    gone = np.isnan(out[:, GYRO])
    np.testing.assert_array_equal(np.isnan(out), gone[:, None] & ((LEVEL_BIT & IMU_BIT) != 0))
    assert not gone[: round(12.0 / DT)].any()
    for value, (low, high) in ((spans(gone), fault.duration), (spans(~gone), fault.gap)):
        seconds = DT * value
        # whole steps: a step either way
        assert seconds.min() >= low - 1.01 * DT
        assert seconds.max() <= high + 1.01 * DT
        # uniform, 3300 of them: mean to (high - low) / sqrt(12 n); three times that, and a step
        spread = (high - low) / math.sqrt(12.0 * len(value))
        assert seconds.mean() == pytest.approx(0.5 * (low + high), abs=3.0 * spread + DT)
        assert seconds.std() == pytest.approx((high - low) / math.sqrt(12.0), rel=0.05)
    # what is drawn at one time is drawn apart: .017 is the spread of 3300 pairs
    gaps, lengths = spans(~gone), spans(gone)[1:]
    some = min(len(gaps), len(lengths))
    assert abs(np.corrcoef(gaps[:some], lengths[:some])[0, 1]) < 0.07


def test_a_frozen_sensor_keeps_its_rate_and_a_loss_hides_it() -> None:
    faults = [Fault("imu", 1.0, 2.0, effect="frozen"), Fault("imu", 2.0, 0.5)]
    suite = dataclasses.replace(SensorSuite(), imu_rate=8.0)
    clean, z = rows(suite, 100), rows(suite, 100, faults=faults)
    k = np.arange(100)
    gone = (k >= 40) & (k < 50)
    np.testing.assert_array_equal(np.isfinite(z[:, GYRO]), np.isfinite(clean[:, GYRO]) & ~gone)
    last = clean[:20][np.isfinite(clean[:20, GYRO])][-1]
    held = np.isfinite(z[:, GYRO]) & (k >= 20) & (k < 60)
    assert held.sum() == 12  # 16 in two seconds, 4 of them lost
    np.testing.assert_array_equal(z[held, GYRO:], np.tile(last[GYRO:], (12, 1)))


def test_a_sensor_frozen_from_the_start_says_nothing() -> None:
    """It has no last sample to repeat."""
    z = rows(SensorSuite(), 20, faults=[Fault("all", 0.0, 0.5, effect="frozen")])
    assert np.all(np.isnan(z[:10]))
    assert np.all(np.isfinite(z[10:]))


def test_recorded_measurements_with_faults() -> None:
    """Columns that are not these sensors' are kept, and so is what is given."""
    rng = np.random.default_rng(0)
    z, cmd = rng.normal(size=(200, 10)), rng.normal(size=(200, 4))
    t, given = 100.0 + 0.1 * np.arange(200), z.copy()
    faults = [Fault("gps", 5.0, 2.0), Fault("compass", 10.0, 1.0, effect="frozen")]
    out, told = apply_faults(t, z, cmd, [*faults, Fault("commands", 3.0, 1.0, effect="zero")], rng)
    np.testing.assert_array_equal(z, given)
    expected, commands = z.copy(), cmd.copy()
    expected[50:70, :4] = math.nan
    expected[100:110, 4] = z[99, 4]
    commands[30:40] = 0.0
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(told, commands)
    for same, other in zip(apply_faults(t, z, cmd, [], rng), (z, cmd), strict=True):
        np.testing.assert_array_equal(same, other)


STEPS = 1074


def sailed(faults: Sequence[Disturbance], seed: int = 3, steps: int = STEPS) -> np.ndarray:
    """Return the measurements of a boat in sea state 2."""
    sim = Simulation(1, BOAT, SeaState.named("2"), faults=faults)
    z = np.empty((steps + 1, len(LEVEL_BIT)))
    sim.reset([0], [np.random.default_rng(seed)])
    for k in range(steps + 1):
        if k:
            sim.step(np.array([[N, N, 0.2, 0.2]]))
        z[k] = sim.z[0, : len(LEVEL_BIT)]
    return z


QUICK = tuple(
    dataclasses.replace(fault, gap=(1.0, 4.0), duration=(0.5, 2.0))
    if isinstance(fault, RandomFaults)
    else fault
    for fault in ON
)
"""All faults at once, so often that a minute has plenty of each."""


@pytest.mark.parametrize("when", [Bursts, RandomFaults, Fault])
@pytest.mark.parametrize("kind", ["gps", "compass", "imu"])
def test_a_fault_leaves_the_other_sensors_as_they_were(kind: str, when: type[Disturbance]) -> None:
    extra = when(kind, 5.0, 20.0) if when is Fault else when(kind)  # type: ignore[call-arg]
    others = tuple(fault for fault in QUICK if FAULT_KINDS[fault.kind] & FAULT_KINDS[kind] == 0)
    struck, z = sailed((extra, *others)), sailed(others)
    mine = (FAULT_KINDS[kind] & LEVEL_BIT) != 0
    # the same noise, and the same bursts, spikes and windows of the other faults
    np.testing.assert_array_equal(struck[:, ~mine], z[:, ~mine])
    kept = np.isfinite(struck)
    np.testing.assert_array_equal(struck[kept], z[kept])
    assert np.isnan(struck[40:, mine]).any()
    assert np.isfinite(z[40:, mine]).all()


def test_two_equal_faults_do_not_strike_together() -> None:
    one = np.isnan(sailed((Bursts("gps"),)))
    two = np.isnan(sailed((Bursts("gps"), Bursts("gps"))))
    assert np.all(two[one])
    assert two.sum() > one.sum()


def test_parse_faults_reads_every_form() -> None:
    assert parse_faults("none", 3.0) == ()
    assert parse_faults("on", 3.0) == ON
    assert parse_faults("gps10", 3.0) == (Fault("gps", 3.0, 10.0),)
    assert parse_faults("gps2.5+imu5", 1.0) == (Fault("gps", 1.0, 2.5), Fault("imu", 1.0, 5.0))
    assert parse_faults("gps10@30", 3.0) == (Fault("gps", 30.0, 10.0),)
    assert parse_faults("gps-frozen5@0", 3.0) == (Fault("gps", 0.0, 5.0, effect="frozen"),)
    assert parse_faults("imu-spikes20", 3.0) == (Fault("imu", 3.0, 20.0, effect="spikes"),)
    assert parse_faults("gps-bursts", 3.0) == (Bursts("gps"),)
    assert parse_faults("gps-bursts5x0.5@60", 3.0) == (Bursts("gps", 0.05, 0.5, 60.0),)
    assert parse_faults("all-random+compass-spikes-random@9", 3.0) == (
        RandomFaults("all"),
        RandomFaults("compass", effect="spikes", start=9.0),
    )
    assert parse_faults("imu-frozen-bursts", 3.0) == (Bursts("imu", effect="frozen"),)
    assert parse_faults("gyro_x-zero5+accel_z-sign-random+gyro_z9", 1.0) == (
        Fault("gyro_x", 1.0, 5.0, effect="zero"),
        RandomFaults("accel_z", effect="sign"),
        Fault("gyro_z", 1.0, 9.0),
    )
    assert parse_faults("gps-jump=500:10@90+compass-bias=-0.2:4+gps-late20", 1.0) == (
        Fault("gps", 90.0, 10.0, effect="jump", amount=500.0),
        Fault("compass", 1.0, 4.0, effect="bias", amount=-0.2),
        Fault("gps", 1.0, 20.0, effect="late"),
    )
    assert parse_faults("gyro-bias=0.2-random+velocity-scale=1.9-bursts5x2@3", 1.0) == (
        RandomFaults("gyro", effect="bias", amount=0.2),
        Bursts("velocity", 0.05, 2.0, 3.0, effect="scale", amount=1.9),
    )


@pytest.mark.parametrize("effect", EFFECTS)
def test_a_text_says_what_a_fault_is(effect: str) -> None:
    """Starts are told to a tenth of a second, all other numbers to the last bit."""
    for kind, usual in AMOUNTS[effect].items():
        for amount in (None,) if usual is None else (None, 1.0 / 3.0, 1e-3, 123.456):
            how: dict[str, Any] = {"effect": effect, "amount": amount}
            faults: list[Disturbance] = [
                Fault(kind, 12.3, 1.0 / 7.0, **how),
                RandomFaults(kind, start=7.0, **how),
            ]
            if effect != "stall":
                faults += [Fault(kind, 0.1, 1e6, **how), Bursts(kind, 0.07, 1e3, 4.5, **how)]
            text = "+".join(map(fault_text, faults))
            assert parse_faults(text, 0.0) == tuple(faults), text


@pytest.mark.parametrize(
    "text",
    [
        *("", "gps", "10", "GPS10", "gps-3", "gps10+", "none+gps1", "gps 1", "gps10@", "radar10"),
        *("gps-stuck5", "gps-bursts10", "gps-bursts10%2", "gps-random5", "gps1e3", "gps\u0663"),
        *("gps-jump=5", "gps-jump=:5", "gps-jump=5:", "gps-jump:5", "gps=5:5", "gps-scaled5"),
        *("gps-bursts100x1", "gps-bursts5x0", "gps" + "9" * 400),
    ],
)
def test_faults_that_are_not_understood_are_refused(text: str) -> None:
    with pytest.raises(FaultError) as caught:
        parse_faults(text, 0.0)
    assert repr(text) in str(caught.value) and "gps" in str(caught.value)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Fault("radar", 0.0, 1.0), "radar"),
        (lambda: Fault("gps", 0.0, 0.0), "duration"),
        (lambda: Fault("gps", math.nan, 1.0), "start"),
        (lambda: Fault("gps", 0.0, 1.0, effect="stuck"), "stuck"),
        (lambda: Fault("gps", 0.0, 1.0, effect="spikes", chance=1.5), "chance"),
        (lambda: Fault("gps", 0.0, 1.0, effect="spikes", sizes=(1.0, 2.0)), "sizes"),
        (lambda: Fault("accel_x", 0.0, 1.0, effect="scale", amount=1e10), "amount"),
        (lambda: Fault("accel_x", 0.0, 1.0, effect="scaled"), "'scale'"),
        (lambda: Fault("accel_x", 0.0, 1.0, effect="reversed"), "'sign'"),
        (lambda: Fault("gps", 0.0, 1.0, amount=1.0), "amount"),
        (lambda: Fault("gps", 0.0, 1.0, effect="late", amount=-1.0), "amount"),
        (lambda: Fault("gps", 0.0, 1.0, effect="bias"), "jump"),
        (lambda: Fault("compass", 0.0, 1.0, effect="jump"), "bias"),
        (lambda: Fault("commands", 0.0, 1.0), "frozen"),
        (lambda: Fault("left", 0.0, 1.0, effect="frozen"), "zero"),
        (lambda: Fault("all", 0.0, 1e4, effect="stall"), "stall"),
        (lambda: Bursts("all", effect="stall"), "bursts"),
        (lambda: Bursts("gps", 1.0), "loss"),
        (lambda: fault_records([Bursts("gps", 0.99, 0.01)], DT), "make them longer"),
        (lambda: Bursts("gps", 0.1, math.inf), "length"),
        (lambda: RandomFaults("imu", gap=(2.0, 1.0)), "gap"),
        (lambda: RandomFaults("imu", start=math.nan), "start"),
    ],
)
def test_impossible_faults_are_refused(make: Callable[[], object], word: str) -> None:
    with pytest.raises(FaultError, match=word):
        make()
