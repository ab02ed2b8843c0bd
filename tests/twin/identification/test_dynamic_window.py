"""Dynamic sliding window: exponent, indices, period, rules and bounds."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.identification.dynamic_window import (
    PERIOD_FORMS,
    DynamicWindow,
    WaveProxy,
    adapt_noise,
    adjustment_period,
    environment_index,
    nonlinearity_index,
)
from twin.identification.lyapunov import LENGTH_MIN, rosenstein

DT = 0.05


def logistic(n: int, start: float = 0.4) -> np.ndarray:
    """Return n values of the logistic map with a gain of 4."""
    x = np.empty(n)
    x[0] = start
    for i in range(1, n):
        x[i] = 4.0 * x[i - 1] * (1.0 - x[i - 1])
    return x


def henon(n: int) -> np.ndarray:
    """Return n values of Henon's map after a transient of a hundred."""
    x = np.full(n + 100, 0.1)
    for i in range(2, n + 100):
        x[i] = 1.0 - 1.4 * x[i - 1] ** 2 + 0.3 * x[i - 2]
    return x[100:]


# ln 2 exactly, and .419 (Sprott 2003); Rosenstein et al. 1993, table 1, found them within
# 5 % from series as short, which is the tolerance.
@pytest.mark.parametrize(
    ("series", "published"),
    [(logistic(500), math.log(2.0)), (henon(1000), 0.419)],
    ids=["logistic", "henon"],
)
def test_exponent_of_known_maps_equals_theory(series: np.ndarray, published: float) -> None:
    assert rosenstein(series) == pytest.approx(published, rel=0.05)


def test_exponent_equals_nolds() -> None:
    """Computed by nolds 0.6.1: lyap_r(emb_dim=2, lag=1, min_tsep=1, trajectory_len=5, fit="poly").

    Its newest release, 0.6.3, needs Python 3.12.
    """
    rng = np.random.default_rng(5)
    for n, expected in (
        (15, 0.13384624137235818),
        (30, 0.39456864898312544),
        (200, 0.5232246169272174),
    ):
        assert rosenstein(rng.normal(size=n)) == pytest.approx(expected, abs=1e-12)


def test_exponent_of_degenerate_series_is_finite() -> None:
    assert rosenstein(np.ones(15)) == -math.inf
    assert math.isnan(rosenstein([math.nan] + [1.0] * 14))
    series = np.random.default_rng(0).normal(size=LENGTH_MIN)
    assert math.isfinite(rosenstein(series))
    with pytest.raises(ValueError, match=f"at least {LENGTH_MIN}"):
        rosenstein(series[:-1])
    with pytest.raises(ValueError, match="shape"):
        rosenstein(np.ones((4, 4)))


def test_exponent_scales_with_time_and_not_with_size() -> None:
    series = np.random.default_rng(1).normal(size=30)
    assert rosenstein(series, dt=DT) == pytest.approx(rosenstein(series) / DT, rel=1e-12)
    assert rosenstein(7.0 * series + 3.0) == pytest.approx(rosenstein(series), rel=1e-9)


def test_environment_index_equals_one_by_hand() -> None:
    hs = [0.4, 0.6]  # mean .5, sd .1
    vw = [3.0, 5.0]  # mean 4, sd 1
    assert environment_index(hs, vw) == pytest.approx((0.2 + 0.25) / 3.0)


def test_environment_index_ignores_scale_and_missing_samples() -> None:
    hs = np.array([0.4, math.nan, 0.6])
    vw = np.array([math.nan] * 3)
    assert environment_index(hs, vw) == pytest.approx(0.2 / 3.0)
    assert environment_index(50.0 * hs, vw) == pytest.approx(environment_index(hs, vw))
    assert environment_index([0.0, 0.0], [0.0, 0.0]) == 0.0


def test_nonlinearity_index_equals_one_by_hand() -> None:
    expected = (1.0 + math.exp(0.1) + math.exp(0.2)) / 3.0
    assert nonlinearity_index(2.0, 3, DT) == pytest.approx(expected, rel=1e-14)
    assert nonlinearity_index(0.0, 15, DT) == 1.0
    assert nonlinearity_index(math.nan, 15, DT) == 1.0
    assert nonlinearity_index(-math.inf, 15, DT) == pytest.approx(1.0 / 15.0)
    assert math.isfinite(nonlinearity_index(math.inf, 15, DT))
    with pytest.raises(ValueError, match="W = 0"):
        nonlinearity_index(1.0, 0, DT)


def test_adjustment_period_equals_one_by_hand() -> None:
    assert adjustment_period(0.0) == 10.0
    assert adjustment_period(2.25) == pytest.approx(5.0)
    assert adjustment_period(6.75) == pytest.approx(2.5)
    assert adjustment_period(math.nan) == 10.0
    assert adjustment_period(2.25, form="binary") == 10.0
    assert adjustment_period(2.26, form="binary") == 5.0
    assert adjustment_period(1e9, form="binary") == 5.0
    assert adjustment_period(math.inf) == 0.0
    with pytest.raises(ValueError, match="unknown"):
        adjustment_period(1.0, form="smooth")


def test_wave_proxy_is_proportional_to_the_waves() -> None:
    t = np.arange(4000) * DT

    def level(amplitude: float, bias: float) -> float:
        proxy = WaveProxy()
        for a in bias + amplitude * np.sin(2.0 * math.pi * t / 3.0):
            proxy.update(DT, float(a))
        return proxy.value

    assert level(2.0, 0.0) == pytest.approx(2.0 * level(1.0, 0.0), rel=1e-9)
    # a first-order high pass at 8 s lets .94 of a 3 s wave through; the rest oscillates
    assert level(1.0, 0.0) == pytest.approx(0.94 / math.sqrt(2.0), rel=0.08)
    assert level(1.0, 3.0) == pytest.approx(level(1.0, 0.0), rel=0.01)


def feed(window: DynamicWindow, motion: np.ndarray, start: float = 0.0, **row: float) -> list[int]:
    return [window.update(start + DT * i, motion=float(m), **row) for i, m in enumerate(motion)]


def test_window_keeps_its_length_until_the_period_has_elapsed() -> None:
    noise = np.random.default_rng(0).normal(size=400)
    lengths = feed(DynamicWindow(), noise, trace_P=0.0)
    assert lengths[:200] == [15] * 200
    assert lengths[200] > 15  # t = 10 s
    # a trace of P_max halves the period
    lengths = feed(DynamicWindow(), noise, trace_P=2.2501)
    assert lengths[99] == 15
    assert lengths[100] > 15


def test_variable_part_equals_one_by_hand() -> None:
    window = DynamicWindow(period="binary")
    # no motion given: S = 1; waves .2 and .4: V = (1/3) / 3, above the calm .1
    window.update(0.0, hs=0.2)
    assert window.update(10.0, hs=0.4) == 15 + 7  # round(15 (.6 / 9 + .4)) = 7
    assert pytest.approx(1.0 / 9.0) == window.V
    assert window.S == 1.0


def test_variable_part_is_capped() -> None:
    window = DynamicWindow(cap=4)
    window.update(0.0, hs=0.2)
    assert window.update(10.0, hs=0.4) == 19


def test_calm_rule_leaves_no_variable_part() -> None:
    window = DynamicWindow()
    window.update(0.0, hs=0.2)
    assert window.update(10.0, hs=0.21) == 15  # V = .008, S = 1


def test_noise_is_taken_for_nonlinearity() -> None:
    # docs/explanation/twin.md, Dynamic window: white noise meets S > 1.2, smooth motion does not.
    noise, smooth = DynamicWindow(), DynamicWindow()
    feed(noise, np.random.default_rng(3).normal(size=202))
    feed(smooth, 1.0 - np.exp(-0.01 * np.arange(202)))
    assert noise.S > 1.2 > smooth.S
    assert (noise.W > 15, smooth.W) == (True, 15)


def test_lateral_acceleration_doubles_the_window_at_once() -> None:
    g = 9.81
    window = DynamicWindow()
    assert window.update(0.0, a_y=0.3 * g) == 15
    assert window.update(5.0, a_y=-0.31 * g) == 30
    # it holds for one period from there, then the calm rule takes over
    assert window.update(14.9, a_y=0.0) == 30
    assert window.update(15.0, a_y=0.0) == 15
    assert DynamicWindow().update(0.0, a_y=math.nan) == 15


def test_window_uses_only_the_samples_within_it() -> None:
    window = DynamicWindow()
    for i in range(201):
        window.update(DT * i, vw=1.0 if i < 180 else 4.0)
    # 15 samples back there is no change, 30 samples back there is
    assert window.V == 0.0


VALUES = st.one_of(st.just(math.nan), st.floats(-1e6, 1e6), st.just(math.inf))


@given(
    rows=st.lists(st.tuples(VALUES, VALUES, VALUES, VALUES, VALUES), max_size=60),
    period=st.sampled_from(PERIOD_FORMS),
    dt=st.floats(0.0, 20.0),
)
def test_window_stays_within_its_bounds(
    rows: list[tuple[float, ...]], period: str, dt: float
) -> None:
    window = DynamicWindow(period=period)
    for i, (trace_P, hs, vw, a_y, motion) in enumerate(rows):
        W = window.update(dt * i, trace_P=trace_P, hs=hs, vw=vw, a_y=a_y, motion=motion)
        assert isinstance(W, int)
        assert 15 <= W <= 30


def test_literal_adaptation_only_grows_up_to_its_cap() -> None:
    start = np.array([1.0, 2.0])
    np.testing.assert_allclose(
        adapt_noise(start, np.array([-2.0, 0.5]), 0.1, start, "literal"), [1.2, 2.05]
    )
    assert start[0] == 1.0  # the arguments stay as they were
    noise = start
    for _ in range(3000):
        noise = adapt_noise(noise, np.ones(2), 0.1, start, "literal")
    np.testing.assert_allclose(noise, 100.0 * start)


def test_signed_adaptation_goes_both_ways_within_bounds() -> None:
    start = np.array([1.0, 0.0])
    np.testing.assert_allclose(adapt_noise(start, -0.3, 1.0, start, "signed"), [0.7, 0.0])
    np.testing.assert_allclose(adapt_noise(start, math.nan, 1.0, start, "signed"), start)
    np.testing.assert_allclose(adapt_noise(start, -1e6, 1.0, start, "signed"), [0.01, 0.0])
    np.testing.assert_allclose(adapt_noise(start, 1e6, 1.0, start, "signed"), [100.0, 0.0])


@pytest.mark.parametrize("accel", [math.nan, math.inf, -math.inf, 1e160, -1e9])
def test_an_accelerometer_gone_wild_is_no_wave(accel):
    proxy = WaveProxy()
    for k in range(100):
        before = proxy.update(0.05, math.sin(k))
    assert proxy.update(0.05, accel) == before
