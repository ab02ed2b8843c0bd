"""What a picture shows of a boat, gathered from its episode and its twin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import frames as fr
from usv_gym.vessel.form import Form
from usv_gym.vessel.vessel import Vessel

__all__ = ["SDS", "Scene", "Trail", "TwinOverlay", "drives", "ellipses", "outlines"]

Array = NDArray[np.float64]

SDS = 2.0
"""Half width of the twin's interval in standard deviations."""


@dataclass(frozen=True, eq=False)
class TwinOverlay:
    """Estimate and forecast of a boat's twin."""

    # (6,): north and east (m), heading (rad), speeds forward and to starboard (m/s), yaw rate
    # (rad/s)
    state: Array
    cov: Array  # (2, 2): covariance of the position, m2
    horizons: Array  # (H,): rising times ahead, s
    ahead: Array  # (H, 6): states then
    covs: Array  # (H, 2, 2): covariances of the positions then, m2

    def interpolate(self, steps: int = 60) -> tuple[Array, Array, Array]:
        """Return times ahead (T,), positions (T, 2) and their covariances (T, 2, 2) in between.

        Positions follow the speeds forecast at each horizon; covariances are linear in time.
        """
        from scipy.interpolate import CubicHermiteSpline  # takes a quarter of a second

        t = np.concatenate([[0.0], self.horizons])
        states = np.vstack([self.state, self.ahead])
        c, s, u, v = np.cos(states[:, 2]), np.sin(states[:, 2]), states[:, 3], states[:, 4]
        speeds = np.stack([u * c - v * s, u * s + v * c], axis=1)
        times = np.linspace(0.0, t[-1], steps + 1)
        covs = np.concatenate([self.cov[None], self.covs]).reshape(-1, 4)
        between = np.stack([np.interp(times, t, column) for column in covs.T], axis=1)
        places = CubicHermiteSpline(t, states[:, :2], speeds)(times)
        return times, places, between.reshape(-1, 2, 2)


def ellipses(places: Array, covs: Array, corners: int = 24) -> Array:
    """Return outlines (T, corners, 2) of ``SDS`` standard deviations around positions (T, 2)."""
    variances, axes = np.linalg.eigh(covs)
    angles = np.linspace(0.0, 2.0 * math.pi, corners, endpoint=False)
    circle = SDS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reach = np.sqrt(np.maximum(variances, 0.0))
    return places[:, None, :] + np.einsum("tij,tj,kj->tki", axes, reach, circle)


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """All that one picture shows."""

    vessel: Vessel  # its size and its drives
    speed: float  # its nominal speed, m/s
    t: float  # time, s
    state: Array  # (16,): true state
    view: Array  # (2,): middle of the picture, m north and east
    track: Array  # (T, 2): where the boat was, m north and east
    path: Array  # (K, 2): way points, m north and east; none without a goal
    leg: int  # present leg, from point leg on
    off_path: float  # distance to starboard of the leg, m
    fixes: Array  # (F, 2): fixes of the GPS, m north and east
    gps_age: float  # time since the last fix, s
    gps_lost: bool  # whether fixes are missing
    # true wind with gusts (m/s), and where it comes from (rad)
    wind: float
    wind_from: float
    # significant wave height (m), and where the waves go to (rad)
    hs: float
    wave_to: float
    reward: float | None  # of the last step; None without a goal
    heeling: bool  # whether the boat rolls and pitches at all
    overlay: TwinOverlay | None = None  # estimate and forecast of its twin


class Trail:
    """What one boat's pictures remember of its episode: track, fixes and where to look.

    Points of the track are ``spacing`` apart; the picture's middle lies ``ahead`` of the boat, m.
    """

    fix_period = 0.5
    """Shortest time between fixes that are drawn, s."""
    longest = 20_000
    """Points that are remembered."""

    def __init__(self, spacing: float, ahead: float) -> None:
        self.spacing, self.ahead = spacing, ahead
        self._begin()

    def _begin(self) -> None:
        self.t, self.fix_t = -math.inf, -math.inf
        self.track: list[tuple[float, float]] = []
        self.fixes: list[tuple[float, float]] = []
        self._offset = np.zeros(2)

    def add(self, t: float, state: Array, fix: Array, age: float) -> None:
        """Remember a step; a time (s) that does not go on begins a new episode.

        ``fix`` (2,) is the last one, m north and east, and ``age`` how old it is, s.
        """
        if t == self.t and t > 0.0:
            return
        if t <= self.t:
            self._begin()
        x, y, psi = float(state[fr.X]), float(state[fr.Y]), float(state[fr.PSI])
        # low-pass filtered: the picture must not shake with the boat
        share = 1.0 - math.exp((self.t - t) / 2.0)
        target = self.ahead * np.array([math.cos(psi), math.sin(psi)])
        self._offset += share * (target - self._offset)
        self.t, self.view = t, np.array([x, y]) + self._offset
        if not self.track or math.dist(self.track[-1], (x, y)) > self.spacing:
            self.track.append((x, y))
        # without a first fix the age is counted from before the start
        if t - age > max(self.fix_t + self.fix_period, 0.0) - 1e-6:
            self.fix_t = t - age
            self.fixes.append((float(fix[0]), float(fix[1])))
        del self.track[: -self.longest], self.fixes[: -self.longest]


def rotated(points: Array, psi: float, place: Array) -> Array:
    """Return points of the body (k, 2), forward and to starboard, as north and east."""
    c, s = math.cos(psi), math.sin(psi)
    return place + points @ np.array([[c, s], [-s, c]])


def outlines(vessel: Vessel) -> list[Array]:
    """Return the shapes from above, (corners, 2), m forward and to starboard: hulls, and a deck.

    A hull has a pointed bow; two hulls are joined by a deck.
    """
    half = np.array([[0.5, 0.0], [0.42, 0.2], [0.3, 0.36], [0.12, 0.47], [-0.1, 0.5], [-0.5, 0.44]])
    hull = np.vstack([half, half[:0:-1] * [1.0, -1.0]])
    form = Form.of(vessel)
    if not form.pontoon:
        return [hull * [form.overall, form.beam]]
    aside = np.array([0.0, 0.5 * (form.beam - form.pontoon)])
    pontoon, square = hull * [form.overall, form.pontoon], [[1, 1], [-1, 1], [-1, -1], [1, -1]]
    deck = np.array(square) * [0.28 * form.overall, aside[1]]
    return [pontoon - aside, pontoon + aside, deck]


def drives(vessel: Vessel, state: Array) -> Array:
    """Return each unit's drive or rudder as a line from its pivot aft, shape (units, 2, 2), m.

    It is drawn larger than it is. An angle > 0, which turns to starboard, swings its end there.
    """
    values, length = vessel.values, vessel.values["length_overall"]
    sides = [-1.0, 1.0] if values["units"] == 2.0 else [0.0]
    lines = np.empty((len(sides), 2, 2))
    for k, side in enumerate(sides):
        delta = state[fr.DELTA_LEFT + k] if values.get("steer_max") else 0.0
        pivot = -0.47 * length, side * max(values["y_P"], 0.22 * values["beam"])
        lines[k] = pivot
        lines[k, 1] += 0.24 * length * np.array([-math.cos(delta), math.sin(delta)])
    return lines
