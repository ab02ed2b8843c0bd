"""DSW-UKF+: its window, its clock, and that it predicts something finite whatever comes."""

import dataclasses
import math
import re
from collections.abc import Callable

import numpy as np
import pytest

from twin.channels import WIND_FROM, WIND_SPEED
from twin.digital_twin import Twin
from twin.filters.navigation_state import NAVIGATION
from twin.identification.joint_ukf import filter_config, filter_state, filter_workspace
from twin.identification.prediction_error import (
    ACT,
    GOOD,
    LOW,
    MIDDLE,
    STATE,
    WIND,
)
from twin.identification.wave_residual import FACTOR, ORDER, SECTORS, simulate_waves
from twin.identification.window import OBSERVER_GAIN, WINDOW
from twin.logs.log import Log, recorded_runs
from twin.model.rollout import GRID, SWAY_INERTIA_RATIO
from twin.model.structure import MODELS, N_STATES
from twin.particulars import Particulars
from twin.predictors.dsw_ukf_plus import PlusPredictor
from twin.predictors.forecast import past_waves
from twin.predictors.plus_update import (
    ROW_AGE_MAX_S,
    _slow_step,
)
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel
from usv_kernel.channels import GPS_VY
from usv_kernel.jit import kernel
from usv_kernel.records import as_record, structured

PLAN = np.tile([20.0, 20.0, 0.2, 0.2], (40, 1))


def thinned(log: Log, times: np.ndarray) -> Log:
    """Return the log's rows next to some times, which become theirs."""
    near = np.clip(np.searchsorted(log.t, times), 0, len(log) - 1)
    return dataclasses.replace(
        log, t=times, z=log.z[near], cmd=log.cmd[near], truth=log.truth[near]
    )


def feed(predictor: PlusPredictor, log: Log, each: Callable[[float], None] | None = None) -> None:
    last = math.nan
    for t, z, cmd in log:
        predictor.update(t, t - last if math.isfinite(last) else 0.0, z, cmd)
        last = t
        if each is not None:
            each(t)


def check(predictor: PlusPredictor, plan: np.ndarray = PLAN) -> None:
    """Predictions of every kind are finite, with covariances; the mean is the mean."""
    for dt, rows in (
        (0.25, plan),
        (0.05, np.repeat(plan, 5, axis=0)),
        (1.0, plan[:7]),
        (3.0, plan[:1]),
    ):
        found = predictor.predict(rows, dt)
        for values in (found.start, found.mean, found.low, found.high, found.sd):
            assert np.isfinite(values).all()
        for cov in (found.start_cov[None], found.cov):
            assert np.isfinite(cov).all()
            np.testing.assert_array_equal(cov, np.swapaxes(cov, 1, 2))
            values = np.linalg.eigvalsh(cov)
            # rounding beside the largest variance
            assert (values[:, 0] >= -1e-12 * values[:, -1]).all()
        np.testing.assert_array_equal(predictor.mean(rows, dt), found.mean)
        # a clock that counts from 1970 has steps of 2e-7 s
        np.testing.assert_allclose(found.t - found.t0, dt * np.arange(1, len(rows) + 1), atol=1e-6)
    assert np.isfinite(predictor.ukf.x).all() and np.isfinite(predictor.ukf.P).all()
    assert np.isfinite(predictor.segments.cov).all()


def slow(predictor: PlusPredictor) -> np.ndarray:
    """Return a copy of the low-frequency velocities."""
    return predictor.window["slow"].copy()


@kernel
def waves_of(memory, rows, w):
    past_waves(as_record(memory.nav, NAVIGATION), rows, as_record(memory.window, WINDOW), w)


def past(predictor: PlusPredictor) -> np.ndarray:
    """Return the last waves, newest first."""
    w = np.empty((ORDER, 3))
    waves_of(predictor.memory, predictor.rows, w)
    return w


@kernel
def observed(dt, memory, config, work):
    model = config.model
    state, given = filter_state(memory.filter, model), filter_config(config.filter, model)
    terms = filter_workspace(work.filter, model.which.shape[1]).terms
    _slow_step(
        dt, as_record(memory.nav, NAVIGATION), as_record(memory.window, WINDOW), state, given, terms
    )


# The window


@pytest.mark.parametrize("dt", [0.05, 0.07, 0.25, 0.4])
def test_window_is_the_navigation_on_the_grid(boat: Particulars, zigzag: Log, dt: float) -> None:
    log = thinned(zigzag, np.arange(0.0, 50.0, dt))
    log.z[:, WIND_SPEED : WIND_FROM + 1] = [5.0, 0.7]
    predictor = PlusPredictor(boat, period=1e9)  # no refit but an empty one at the start
    t, n, acts, slow_ = [], [], [], []

    def keep(now: float) -> None:
        if predictor.ready:
            t.append(now)
            n.append(predictor.n[:N_STATES].copy())
            acts.append(predictor.ukf.act.copy())
            slow_.append(slow(predictor))

    feed(predictor, log, keep)
    last = predictor.last_row
    assert 150 < last < len(predictor.rows)
    rows = predictor.rows[: last + 1]
    at = t[0] + GRID * np.arange(last + 1)

    def on_grid(values: list[np.ndarray], when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, t, column) for column in np.array(values).T], axis=1)

    # rounding of times: 1e-14 s at 50 s, and speeds of metres and radians a second
    np.testing.assert_allclose(rows[:, STATE : STATE + 6], on_grid(n, at), atol=1e-9)
    np.testing.assert_allclose(rows[:, ACT : ACT + 4], on_grid(acts, at), atol=1e-9)
    half = on_grid(acts, at + 0.5 * GRID)
    np.testing.assert_allclose(rows[:, MIDDLE : MIDDLE + 4], half, atol=1e-9)
    # the observer and the wind are those of the row that reached the grid
    reached = np.searchsorted(np.array(t) + 1e-9, at)
    np.testing.assert_allclose(rows[:, LOW : LOW + 3], np.array(slow_)[reached], atol=1e-9)
    wind = [-5.0 * math.cos(0.7), -5.0 * math.sin(0.7)]
    np.testing.assert_allclose(rows[:, WIND : WIND + 2], np.tile(wind, (last + 1, 1)))
    assert (rows[-20:, GOOD] == 1.0).all()


def test_refits_keep_to_their_period(boat: Particulars, zigzag: Log) -> None:
    for period, dt in ((1.0, 0.05), (2.5, 0.05), (1.0, 0.3), (0.5, 1.0)):
        predictor = PlusPredictor(boat, period=period)
        due, when = float(predictor.window["refit_at"]), []

        def watch(now: float, predictor=predictor, when=when) -> None:
            nonlocal due
            if predictor.window["refit_at"] != due:
                due = float(predictor.window["refit_at"])
                when.append(now)

        feed(predictor, thinned(zigzag, np.arange(0.0, 40.0, dt)), watch)
        steps = np.diff(when)
        assert (steps >= period - 1e-6).all() and (steps < period + dt + 1e-6).all()
        assert when[0] < 1.0 + dt and when[-1] > 40.0 - period - 2.0 * dt


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("vessel", ["usv75", "otter", "wamv16", "kvlcc2_l7"])
def test_vessels_of_any_kind_are_refitted(name: str, vessel: str) -> None:
    ship = Vessel.load(vessel)
    log = simulate("zigzag", vessel=ship, sea=SeaState(hs=0.2, wind=4.5), duration=40.0, seed=2)
    predictor = PlusPredictor(particulars_of(ship), model=name)
    feed(predictor, log)
    used = predictor.segments.first[predictor.segments.first >= 0]
    # one segment a spacing, none that is not over yet
    assert len(used) >= 10 and (np.diff(np.sort(used)) == predictor.spacing).all()
    assert used.max() + predictor.segments.steps < predictor.last_row + 1
    moved = (
        np.abs(predictor.ukf.xi - predictor.segments.prior)
        > 0.05 * predictor.ukf.settings.structure.sd
    )
    assert moved.any()
    check(predictor)


# Whatever comes


def gap(log: Log, at: float, length: float) -> Log:
    return dataclasses.replace(log, t=np.where(log.t >= at, log.t + length, log.t))


def without(log: Log, columns: slice, start: float = -1.0, end: float = 1e9) -> Log:
    z = log.z.copy()
    z[(log.t >= start) & (log.t < end), columns] = math.nan
    return dataclasses.replace(log, z=z)


STORIES: dict[str, Callable[[Log], Log]] = {
    "no fix": lambda log: without(log, slice(0, 4)),
    "no heading": lambda log: without(log, slice(4, 5)),
    "1 Hz, no IMU": lambda log: without(thinned(log, np.arange(0.0, 60.0)), slice(5, 8)),
    "one row in 10 s": lambda log: thinned(log, np.arange(0.0, 60.0, 10.0)),
    "gap of a week at the end": lambda log: gap(log, 59.9, 6e5),
    "late clock": lambda log: dataclasses.replace(log, t=log.t + 1.7e9),
}
"""What the marathon of the navigation has not got."""


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("story", STORIES)
def test_predictions_stay_finite(boat: Particulars, zigzag: Log, name: str, story: str) -> None:
    predictor, rows = PlusPredictor(boat, model=name), 0

    def now_and_then(_: float) -> None:
        nonlocal rows
        rows += 1
        if rows in (1, 20, 500, 700):
            check(predictor)

    feed(predictor, STORIES[story](zigzag), now_and_then)
    check(predictor)
    for plan in (1e9 * PLAN, -PLAN, 0.0 * PLAN):
        check(predictor, plan)
    estimate = predictor.estimate()
    assert np.isfinite(estimate.state).all() and np.isfinite(estimate.sd).all()
    assert estimate.ready == (story not in ("no fix", "no heading"))


def test_it_comes_back_after_an_hour(boat: Particulars, zigzag: Log) -> None:
    predictor = PlusPredictor(boat)
    feed(predictor, gap(zigzag, 30.0, 3600.0))
    error = predictor.estimate().state - zigzag.truth[-1]
    # a receiver's bias and noise, and waves
    assert np.hypot(*error[:2]) < 6.0 and np.abs(error[3:5]).max() < 0.8
    used = predictor.segments.first[predictor.segments.first >= 0]
    # nothing from before the gap, but segments of the half minute since
    assert len(used) >= 5
    assert used.min() * GRID > 3500.0


@pytest.mark.parametrize("start", [3.0, 5.0, 60.0, 3600.0])
def test_no_segment_runs_across_a_gap(boat: Particulars, zigzag: Log, start: float) -> None:
    """``start`` seconds of silence: rows within it are no measurements of anything."""
    predictor = PlusPredictor(boat)
    feed(predictor, gap(zigzag, 30.0, start + 0.5))
    began = predictor.window["origin"]
    for first in predictor.segments.first[predictor.segments.first >= 0]:
        begin = began + GRID * first
        end = begin + GRID * predictor.segments.steps
        assert end < 30.0 + 1e-9 or begin > 30.0 + start - GRID


@pytest.mark.parametrize(
    ("gps_s", "every_s", "why"),
    [(9.0, 0.05, ""), (1.0, 0.05, "no fix for 2.5 s"), (60.0, 3.0, "rows more than 2.5 s apart")],
)
def test_before_a_refit_it_says_what_is_missing(
    boat: Particulars, zigzag: Log, gps_s: float, every_s: float, why: str
) -> None:
    """9 usable seconds are too few for three stretches of 7 s that begin 2 s after each other."""
    log = thinned(zigzag, np.arange(0.0, 60.0 if why else 9.0, every_s))
    log.z[log.t > gps_s, : GPS_VY + 1] = math.nan
    predictor = PlusPredictor(boat)
    feed(predictor, log)
    name = predictor.parameters_in_use().name
    number = r"([\d.]+)"
    has = rf"a refit needs 3 usable stretches of 7 s, 2 s apart, and has {number}: "
    found = re.search(rf"{has}of the last {number} s, {number} s are usable", name)
    lost = {cause: float(s) for cause, s in re.findall(rf"; ([^;]+): {number} s", name)}
    assert found is not None
    stretches, seen, usable = map(float, found.groups())
    assert stretches < 3 and usable + sum(lost.values()) == seen
    assert lost[why] > 0.5 * seen if why else usable > 0.9 * seen


def test_what_bridges_a_gap_is_no_wave(boat: Particulars, zigzag: Log) -> None:
    predictor, log = PlusPredictor(boat), gap(zigzag, 30.0, 5.0)
    feed(predictor, log.slice(0.0, 30.0))
    assert (np.abs(past(predictor)) > 0.0).all()
    for k in np.flatnonzero((log.t >= 35.0) & (log.t < 38.0)):
        predictor.update(log.t[k], log.t[k] - log.t[k - 1], log.z[k], log.cmd[k])
        if log.t[k] < 36.0:
            assert not past(predictor).any()
    assert (np.abs(past(predictor)) > 0.0).all()


def test_the_waves_of_the_draws_are_those_of_the_headings_ahead(
    boat: Particulars, zigzag: Log
) -> None:
    predictor = PlusPredictor(boat)
    # until waves are seen: as a refit takes them to be, and without memory
    assert not predictor.window["sectors"][:, :FACTOR].any()
    np.testing.assert_array_equal(
        predictor.window["sectors"][:, FACTOR:].reshape(-1, 3, 3),
        np.tile(np.diag(predictor.refit.sd[3:]), (SECTORS, 1, 1)),
    )
    feed(predictor, zigzag.slice(0.0, 40.0))
    central = predictor._mean_forecast(PLAN, 0.25)
    drawn, _ = predictor._draws(central, PLAN, 0.25)
    headings = central.states[0, :, 2].copy()
    np.testing.assert_allclose(drawn.heading, headings, atol=1e-12)
    new = np.empty((100, 40, 3))
    sectors = np.array(predictor.window["sectors"])
    simulate_waves(sectors, headings, predictor.normal[2][1:], new)
    np.testing.assert_array_equal(drawn.ends[0], 0.0)
    np.testing.assert_allclose(drawn.ends[1:], new, atol=1e-12)
    predicted = central.means[0, 0]
    np.testing.assert_allclose(drawn.means[1:, 0], 0.5 * new[:, 0] + predicted, atol=1e-12)
    assert np.abs(central.ends[0, :4]).max() > 0.01
    # other headings, other waves
    other = np.empty((100, 40, 3))
    simulate_waves(sectors, headings + math.pi, predictor.normal[2][1:], other)
    assert (other != new).any()


def test_the_observer_keeps_velocity_over_ground_while_a_wave_turns_the_boat(
    boat: Particulars,
) -> None:
    predictor = PlusPredictor(boat)
    after: list[np.ndarray] = []
    for turn in (0.0, 0.2):
        predictor.window["slow"][:] = 3.0, -1.0, 0.1
        predictor.n[:] = 0.0
        predictor.n[3:6] = 3.0, -1.0, 0.1 + turn
        observed(GRID, predictor.memory, predictor.config, predictor.work)
        after.append(slow(predictor))
    turned = np.array([0.2 * -1.0, -0.2 * SWAY_INERTIA_RATIO * (3.0 - 0.2 * GRID), 0.0]) * GRID
    pulled = OBSERVER_GAIN * GRID * np.array([0.0, 0.0, 0.2])
    expected = (1.0 - OBSERVER_GAIN * GRID) * turned + pulled  # as measured, it did not turn
    np.testing.assert_allclose(after[1] - after[0], expected, rtol=1e-9)


# Bits


def test_another_seed_draws_others(boat: Particulars, zigzag: Log) -> None:
    runs = []
    for seed in (3, 4):
        predictor = PlusPredictor(boat, seed=seed)
        feed(predictor, zigzag.slice(0.0, 20.0))
        runs.append(predictor.predict(PLAN, 0.25))
    np.testing.assert_array_equal(runs[0].mean, runs[1].mean)
    assert not np.array_equal(runs[0].cov, runs[1].cov)
    # a hundred draws: the spread is known to some 7 %, and its square to 14 %
    np.testing.assert_allclose(runs[0].sd[-1], runs[1].sd[-1], rtol=0.4)


# The guard


@pytest.mark.parametrize("name", MODELS)
def test_guard_keeps_the_motion_inside_bounds(boat: Particulars, zigzag: Log, name: str) -> None:
    predictor = PlusPredictor(boat, model=name)
    feed(predictor, zigzag.slice(0.0, 40.0))
    theta = predictor._mean_forecast(PLAN, 0.25).params[0]
    # a sane set is left alone, but for the rounding of prior + (xi - prior)
    np.testing.assert_allclose(theta, predictor.ukf.xi, rtol=1e-12, atol=1e-15)
    U, L = boat.speed, boat.length
    # what the boat was seen to do, half as much again, or what any boat can
    bound = np.maximum(1.5 * predictor.ukf.fastest, [1.5 * U, 0.8 * U, 1.2 * U / L])
    names, rng = predictor.parameter_names, np.random.default_rng(0)
    for _ in range(20):
        k = rng.integers(len(names))
        kept = predictor.ukf.x.copy()
        predictor.ukf.x[N_STATES + k] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-2, 6)
        found = predictor._mean_forecast(PLAN, 0.25)
        theta, waves = found.params[0], found.ends[0]
        assert (np.abs(found.states[0, :, 3:] - waves) <= bound + 1e-9).all(), names[k]
        # shrunk along the way to the prior, never beyond
        prior, xi = predictor.segments.prior, predictor.ukf.xi
        part = np.dot(theta - prior, xi - prior) / np.dot(xi - prior, xi - prior)
        np.testing.assert_allclose(theta, prior + part * (xi - prior), atol=1e-9 * np.abs(xi).max())
        assert -1e-9 <= part <= 1.0 + 1e-9
        check(predictor)
        predictor.ukf.x[:] = kept


def test_without_gps_the_mean_of_joint_filter_and_refit_goes_on() -> None:
    path = recorded_runs()["boat1_usv_circle"]
    log = Log.read(path)
    twin = Twin(Particulars.load(path.with_name("boat1_usv_circle.toml")), "dsw-ukf-plus")
    predictor = twin.predictor
    assert isinstance(predictor, PlusPredictor)
    lost, before = log.t[0] + 60.0, math.inf
    for t, z, cmd in log:
        blind = np.array(z)
        if t >= lost:
            blind[:4] = math.nan
        twin.step(t, blind, cmd)
        if structured(predictor.memory.nav[None], NAVIGATION)["gps_age"][0] > ROW_AGE_MAX_S:
            break
        before = predictor.ukf.xi.copy()
    mean = 0.5 * (predictor.joint.xi + predictor.selector.params[0])
    np.testing.assert_array_equal(predictor.ukf.xi, mean)
    assert np.abs(mean - before).max() > 1e-3
    twin.step(t + 0.1, blind, cmd)  # and goes on from there
    assert np.isfinite(predictor.ukf.xi).all()
