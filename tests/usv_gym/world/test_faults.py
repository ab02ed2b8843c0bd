"""Faults of sensors: lost, frozen and spiked samples."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.usv_gym.world.sample_rows import BIT, BOAT, DT, LEVEL_BIT, N, rows
from twin.sim.wrapper import make_env
from usv_gym import Bursts, Fault, RandomFaults, SeaState, SensorSuite
from usv_gym.envs.env import USVEnv
from usv_gym.world.channels import GPS_BIT, IMU_BIT
from usv_gym.world.faults import (
    EFFECTS,
    FAULT_KINDS,
    ON,
    SPIKE_SIZES,
    Disturbance,
    FaultError,
    apply_faults,
    fault_records,
    parse_faults,
)
from usv_gym.world.simulation import Simulation
from usv_kernel.channels import GYRO


def struck(fault: Disturbance, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return measurements without and with a fault, all sensors at each step."""
    suite = dataclasses.replace(SensorSuite(), gps_latency=0.0, wind_latency=0.0, wind_rate=20.0)
    return rows(suite, count, seed, dof=6), rows(suite, count, seed, faults=[fault], dof=6)


SCALES = {"zero": 0.0, "reversed": -1.0, "scaled": 1.7}


@pytest.mark.parametrize("kind", FAULT_KINDS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_a_fault_strikes_its_sensors_in_its_time_and_nothing_else(kind: str, effect: str) -> None:
    """Afterwards each sample is what it had been: noise and biases went on."""
    clean, z = struck(Fault(kind, 2.0, 3.0, effect=effect, chance=1.0, factor=1.7), 200)
    k = np.arange(200)
    inside = ((k >= 40) & (k < 100))[:, None] & ((FAULT_KINDS[kind] & BIT) != 0)
    np.testing.assert_array_equal(z[~inside], clean[~inside])
    if effect == "loss":
        assert np.all(np.isnan(z[inside]))
    elif effect == "frozen":
        np.testing.assert_array_equal(z[inside], np.broadcast_to(clean[39], z.shape)[inside])
    elif effect in SCALES:
        np.testing.assert_array_equal(z[inside], SCALES[effect] * clean[inside])
    else:
        off = np.abs(z - clean)
        np.testing.assert_allclose(off[inside], np.broadcast_to(SPIKE_SIZES, z.shape)[inside])


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
    out = apply_faults(t, z, [Bursts("gps", loss, mean)], np.random.default_rng(5))
    gone = np.isnan(out[:, 0])
    np.testing.assert_array_equal(np.isnan(out), gone[:, None] & (LEVEL_BIT == GPS_BIT))
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
    out = apply_faults(t, z, [fault], np.random.default_rng(6))
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
    z, t = rng.normal(size=(200, 10)), 100.0 + 0.1 * np.arange(200)
    given = z.copy()
    faults = [Fault("gps", 5.0, 2.0), Fault("compass", 10.0, 1.0, effect="frozen")]
    out = apply_faults(t, z, faults, rng)
    np.testing.assert_array_equal(z, given)
    expected = z.copy()
    expected[50:70, :4] = math.nan
    expected[100:110, 4] = z[99, 4]
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(apply_faults(t, z, [], rng), z)


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


def test_all_faults_at_once_are_the_same_with_the_same_seed() -> None:
    one, two, other = sailed(QUICK), sailed(QUICK), sailed(QUICK, seed=4)
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(np.isnan(one), np.isnan(other))


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


@pytest.mark.filterwarnings("ignore::usv_gym.world.faults.FaultWarning")
@pytest.mark.parametrize(("twin", "dof"), [(None, 3), ("ukf", 3), ("ukf", 6)])
def test_observations_stay_finite_through_everything(twin: str | None, dof: int) -> None:
    env = make_env(twin=twin, dof=dof, sea="6", task="free", faults=QUICK)
    for seed in range(2):
        obs, _ = env.reset(seed=seed)
        for k in range(1200):
            assert env.observation_space.contains(obs), f"step {k}"
            action = np.array([0.5, math.sin(0.05 * k)], np.float32)
            obs, reward, terminated, *_ = env.step(action)
            assert math.isfinite(reward)
            if terminated:  # capsized
                break


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
    assert parse_faults("gyro_x-zero5+accel_z-reversed-random+gyro_z9", 1.0) == (
        Fault("gyro_x", 1.0, 5.0, effect="zero"),
        RandomFaults("accel_z", effect="reversed"),
        Fault("gyro_z", 1.0, 9.0),
    )


@pytest.mark.parametrize(
    "text",
    [
        *("", "gps", "10", "GPS10", "gps-3", "gps10+", "none+gps1", "gps 1", "gps10@", "radar10"),
        *("gps-stuck5", "gps-bursts10", "gps-bursts10%2", "gps-random5", "gps1e3", "gps\u0663"),
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
        (lambda: Fault("accel_x", 0.0, 1.0, effect="scaled", factor=1e9), "factor"),
        (lambda: Bursts("gps", 1.0), "loss"),
        (lambda: Bursts("gps", 0.1, math.inf), "length"),
        (lambda: RandomFaults("imu", gap=(2.0, 1.0)), "gap"),
        (lambda: RandomFaults("imu", start=math.nan), "start"),
    ],
)
def test_impossible_faults_are_refused(make: Callable[[], object], word: str) -> None:
    with pytest.raises(FaultError, match=word):
        make()


KINDS = st.sampled_from([*FAULT_KINDS, "radar", ""])
DOES = st.sampled_from(["", *(f"-{effect}" for effect in EFFECTS), "-stuck"])
NUMBERS = st.sampled_from(["0", "5", "2.5", "1e3", "-1", "", "100", "9" * 400])
WHEN = st.one_of(
    NUMBERS,
    st.sampled_from(["-random", "-bursts"]),
    st.builds("-bursts{}x{}".format, NUMBERS, NUMBERS),
)


AT = st.one_of(st.just(""), NUMBERS.map("@{}".format))
PARTS = st.tuples(KINDS, DOES, WHEN, AT).map("".join)
TEXTS = st.one_of(
    st.lists(PARTS, min_size=1, max_size=3).map("+".join),
    st.text(max_size=20),
    st.text("gpsimuall-0123456789.@+x%", max_size=20),
)


@settings(deadline=None)  # the first one compiles
@given(text=TEXTS)
@example("gps-bursts99x0.01")
@example("gps-bursts100x1")
@example("imu-bursts5x0")
@example("gps" + "9" * 400)
def test_any_text_is_faults_or_a_clear_error(text: str) -> None:
    try:
        faults = parse_faults(text, 10.0)
        packed = fault_records(faults, DT)
    except FaultError as error:
        words = ("use ", "must ", "write ", "make them longer")
        clear = any(word in str(error) for word in words)
    else:
        clear = True
        assert packed.shape == (len(faults),)
        assert np.all(np.isfinite(packed.view(float)))
        assert not np.any(np.isinf(rows(SensorSuite(), 300, faults=faults)))
    assert clear


def test_bursts_that_do_not_fit_the_control_step_die_early() -> None:
    for loss, mean in ((0.1, 0.01), (0.9, 0.1)):
        with pytest.raises(FaultError, match=r"do not fit steps of 0\.05 s; make them longer"):
            Simulation(1, BOAT, SeaState(), faults=[Bursts("gps", loss, mean)])
    with pytest.raises(FaultError, match=r"do not fit steps of 0\.05 s"):
        USVEnv(faults="gps-bursts10x0.01")
