"""Indices of tracks: closed forms, symmetries, recorded runs of KVLCC2."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usv_gym.manoeuvring import indices
from usv_gym.manoeuvring.indices import Track, TrackError, Turning, Zigzag

SHARED = Path(os.environ.get("USV_TWIN_SHARED", Path(__file__).parents[4] / "shared"))
KVLCC2 = SHARED / "data" / "kvlcc2_simman2008"
LENGTH, SPEED, RADIUS, DRIFT = 7.0, 1.5, 12.0, 0.2
APPROACH = 4.0
DEGREE = math.pi / 180.0


def circle(t: np.ndarray, drift: float = DRIFT) -> Track:
    """Return a straight approach and a circle to starboard with a drift angle."""
    angle = np.maximum(t - APPROACH, 0.0) * SPEED / RADIUS
    turning = t > APPROACH
    return Track(
        t=t,
        x=np.where(turning, RADIUS * np.sin(angle), SPEED * (t - APPROACH)),
        y=RADIUS * (1.0 - np.cos(angle)),
        psi=angle + np.where(turning, drift, 0.0),
        delta=np.clip(t - APPROACH, 0.0, 0.5),
    )


def triangles(t: np.ndarray, switch: float, overshoot: float, rate: float) -> Track:
    """Return triangular headings, to starboard first."""
    top = switch + overshoot
    phase = np.maximum(t - APPROACH, 0.0) * rate / top
    psi = top * (np.abs((phase - 1.0) % 4.0 - 2.0) - 1.0)
    u, v = np.full_like(t, SPEED), np.zeros_like(t)
    steps = SPEED * np.gradient(t)
    return Track(
        t=t,
        x=np.cumsum(steps * np.cos(psi)),
        y=np.cumsum(steps * np.sin(psi)),
        psi=psi,
        u=u,
        v=v,
        delta=np.where(t > APPROACH, switch, 0.0),
    )


def moved(track: Track, by: float, north: float, east: float, later: float) -> Track:
    """Return the track in another frame and at another time."""
    c, s = math.cos(by), math.sin(by)
    psi = (track.psi + by + math.pi) % (2.0 * math.pi) - math.pi
    x, y = c * track.x - s * track.y + north, s * track.x + c * track.y + east
    return dataclasses.replace(track, t=track.t + later, x=x, y=y, psi=psi)


def uneven(rng: np.random.Generator, end: float, dt: float = 0.05) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(rng.uniform(0.2 * dt, 1.8 * dt, round(end / dt)))])


def assert_same(a: object, b: object, rtol: float, skip: tuple[str, ...] = ()) -> None:
    for item in dataclasses.fields(a):  # type: ignore[arg-type]
        if item.name not in skip:
            one, other = getattr(a, item.name), getattr(b, item.name)
            np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol, err_msg=item.name)


# ------------------------------------------------- closed forms


@pytest.mark.parametrize("drift", [0.0, 0.2])
def test_turning_of_a_circle_has_closed_form_indices(drift: float) -> None:
    got = indices.turning(circle(0.02 * np.arange(4000), drift), length=LENGTH)
    R = RADIUS / LENGTH
    # the course lags the heading by the drift angle
    want = {
        "side": 1,
        "advance": R * math.cos(drift),
        "transfer": R * (1.0 - math.sin(drift)),
        "tactical_diameter": R * (1.0 + math.cos(drift)),
        "time_90": (0.5 * math.pi - drift) * RADIUS / SPEED,
        "time_180": (math.pi - drift) * RADIUS / SPEED,
        "rate": 1.0 / R,
        "radius": R,
        "drift": drift,
        "speed_ratio": 1.0,
    }
    # a sample's way, 0.03 m of 12 m, where the circle begins at once
    assert_same(got, Turning(**want), rtol=2e-3)  # type: ignore[arg-type]


def test_zigzag_of_triangles_has_closed_form_indices() -> None:
    switch, overshoot, rate = 10.0 * DEGREE, 4.0 * DEGREE, 2.0 * DEGREE
    track = triangles(0.01 * np.arange(6000), switch, overshoot, rate)
    got = indices.zigzag(track, length=LENGTH, switch=switch, origin=APPROACH)
    # 5 s to 10 degrees, 2 s to the peak, 14 s from switch to switch
    assert got.side == 1
    np.testing.assert_allclose(got.executes, [0.0, 5.0, 19.0, 33.0, 47.0], atol=1e-6)
    np.testing.assert_allclose(got.overshoots, overshoot, atol=0.01 * rate)
    np.testing.assert_allclose(got.checks, 2.0, atol=0.011)
    assert len(got.overshoots) == len(got.checks) == 4
    assert got.initial_turning_time == pytest.approx(5.0, abs=1e-6)
    assert got.initial_turning_distance == pytest.approx(5.0 * SPEED / LENGTH, rel=1e-6)
    assert got.period == pytest.approx(28.0, abs=1e-6)


def test_overshoots_without_a_peak_are_left_out() -> None:
    switch, rate = 10.0 * DEGREE, 2.0 * DEGREE
    t = 0.01 * np.arange(6000)
    track = triangles(t, switch, 4.0 * DEGREE, rate)
    for end, seen in ((APPROACH + 6.9, 0), (APPROACH + 8.0, 1), (APPROACH + 20.9, 1)):
        got = indices.zigzag(track.between(0.0, end), length=LENGTH, switch=switch, origin=APPROACH)
        assert len(got.overshoots) == seen
        assert math.isnan(got.period)


# ------------------------------------------------- invariance to recording

records = {
    "seed": st.integers(0, 2**32 - 1),
    "by": st.floats(-10.0, 10.0),
    "north": st.floats(-1e3, 1e3),
    "east": st.floats(-1e3, 1e3),
    "later": st.floats(-1e3, 1e3),
}


@given(**records)
@settings(max_examples=40, deadline=None)
def test_turning_does_not_depend_on_frame_sampling_and_side(seed: int, **frame: float) -> None:
    even = indices.turning(circle(0.05 * np.arange(2000)), length=LENGTH)
    track = moved(circle(uneven(np.random.default_rng(seed), 90.0)), **frame)
    # two samples of up to 0.09 s and 1.5 m/s in 12 m, where the circle begins at once
    assert_same(indices.turning(track, length=LENGTH), even, rtol=0.02)
    other = indices.turning(moved(track.mirrored(), 1.0, 5.0, 6.0, 7.0), length=LENGTH)
    assert other.side == -1
    assert_same(other, indices.turning(track, length=LENGTH), rtol=1e-8, skip=("side",))


@given(**records)
@settings(max_examples=40, deadline=None)
def test_zigzag_does_not_depend_on_frame_sampling_and_side(seed: int, **frame: float) -> None:
    switch = 20.0 * DEGREE

    def of(track: Track, origin: float | None = None) -> Zigzag:
        return indices.zigzag(track, length=LENGTH, switch=switch, origin=origin)

    even = of(triangles(0.05 * np.arange(2000), switch, 8 * DEGREE, 3 * DEGREE), APPROACH)
    track = triangles(
        uneven(np.random.default_rng(seed), 99.0), switch, 8 * DEGREE, 3 * DEGREE
    ).between(0.0, 96.0)
    record = moved(track, **frame)
    got = of(record, APPROACH + frame["later"])
    count = len(got.overshoots)
    assert count >= 4
    # a peak between samples of up to 0.09 s, at 3 degrees/s
    np.testing.assert_allclose(got.overshoots, even.overshoots[:count], atol=0.3 * DEGREE)
    np.testing.assert_allclose(got.executes, even.executes[: len(got.executes)], atol=0.01)
    assert got.period == pytest.approx(even.period, abs=0.02)
    assert_same(of(record.mirrored(), APPROACH + frame["later"]), got, 1e-8, skip=("side",))
    assert of(record.mirrored(), APPROACH + frame["later"]).side == -1
    # without the order: the helm, between two samples
    assert of(record).initial_turning_time == pytest.approx(got.initial_turning_time, abs=0.1)


def test_missing_velocities_are_slopes() -> None:
    track = circle(0.01 * np.arange(4000))
    late = slice(int(APPROACH / 0.01) + 2, -1)
    want = np.array([SPEED * math.cos(DRIFT), -SPEED * math.sin(DRIFT), SPEED / RADIUS])
    np.testing.assert_allclose(track.motion[:, late].T - want, 0.0, atol=1e-5)
    given_r = dataclasses.replace(track, r=np.full(4000, 9.0))
    assert np.all(given_r.motion[2] == 9.0)
    np.testing.assert_array_equal(given_r.motion[:2], track.motion[:2])


# ------------------------------------------------- errors


def test_incomplete_manoeuvres_are_refused() -> None:
    t = 0.05 * np.arange(2000)
    track = circle(t)

    def until(degrees: float) -> Track:
        return track.between(0.0, APPROACH + (degrees * DEGREE - DRIFT) * RADIUS / SPEED)

    with pytest.raises(TrackError, match="90 degrees"):
        indices.turning(until(80.0), length=LENGTH)
    with pytest.raises(TrackError, match="180 degrees"):
        indices.turning(until(170.0), length=LENGTH)
    assert math.isnan(indices.turning(until(260.0), length=LENGTH).rate)
    assert indices.turning(until(280.0), length=LENGTH).rate > 0.0
    with pytest.raises(TrackError, match="10 degrees"):
        indices.zigzag(
            triangles(t, 6 * DEGREE, 2 * DEGREE, DEGREE), length=LENGTH, switch=10 * DEGREE
        )
    with pytest.raises(TrackError, match="switch"):
        indices.zigzag(track, length=LENGTH, switch=0.0)
    with pytest.raises(TrackError, match="helm"):
        indices.turning(dataclasses.replace(track, delta=None), length=LENGTH)
    with pytest.raises(TrackError, match="helm"):
        indices.turning(dataclasses.replace(track, delta=np.ones_like(t)), length=LENGTH)
    with pytest.raises(TrackError, match="-3 s"):
        indices.turning(track, length=LENGTH, origin=-3.0)


def test_bad_tracks_are_refused() -> None:
    t = np.arange(5.0)
    with pytest.raises(TrackError, match="shape"):
        Track(t=t, x=t, y=t[:4], psi=t)
    with pytest.raises(TrackError, match="psi"):
        Track(t=t, x=t, y=t, psi=np.where(t == 2.0, np.nan, t))
    with pytest.raises(TrackError, match="rise"):
        Track(t=np.minimum(t, 2.0), x=t, y=t, psi=t)
    with pytest.raises(TrackError, match="samples"):
        Track(t=t[:1], x=t[:1], y=t[:1], psi=t[:1])


# ------------------------------------------------- recorded runs


def recorded(name: str) -> Track:
    path = KVLCC2 / f"{name}.csv.gz"
    if not path.exists():
        pytest.skip(f"{path} is missing (set USV_TWIN_SHARED); it must not be redistributed")
    log = np.genfromtxt(path, delimiter=",", names=True)
    columns = {"t": "t_s", "x": "x_m", "y": "y_m", "psi": "psi_rad", "u": "u_mps", "v": "v_mps"}
    columns |= {"r": "r_radps", "delta": "delta_rad"}
    return Track(**{ours: log[theirs] for ours, theirs in columns.items()})


def test_recorded_turn_has_published_indices() -> None:
    # MARIN, 35 degrees to port, with a pull-out; values published with the data
    track = recorded("marin_tc_35")
    got = indices.turning(track, length=7.0, origin=0.0, heading=0.0)
    assert got.side == -1
    # two decimals and another window of the steady turn: 0.02
    assert got.advance == pytest.approx(3.11, abs=0.02)
    assert got.transfer == pytest.approx(1.22, abs=0.02)
    assert got.tactical_diameter == pytest.approx(3.08, abs=0.02)
    assert got.rate == pytest.approx(0.83, abs=0.02)
    assert got.radius == pytest.approx(1.19, abs=0.02)
    assert got.speed_ratio == pytest.approx(0.361, abs=0.02)
    # published from the first motion of the rudder
    late = indices.turning(track, length=7.0, heading=0.0)
    assert late.advance == pytest.approx(3.00, abs=0.03)


@pytest.mark.parametrize(
    ("name", "side", "switch", "overshoots"),
    [
        ("marin_zz_10", -1, 10.0, (9.5, 15.0)),
        ("marin_zz_20", -1, 20.0, (15.1, 13.3)),
        ("hsva_z_10_10_s", 1, 10.0, (9.7, 20.5)),
        ("hsva_z_20_10_s", 1, 10.0, (11.7, 15.6)),
    ],
)
def test_recorded_zigzags_have_published_overshoots(
    name: str, side: int, switch: float, overshoots: tuple[float, float]
) -> None:
    got = indices.zigzag(
        recorded(name), length=7.0, switch=switch * DEGREE, origin=0.0, heading=0.0
    )
    assert got.side == side
    # one decimal: 0.05
    np.testing.assert_allclose(np.degrees(got.overshoots[:2]), overshoots, atol=0.06)
