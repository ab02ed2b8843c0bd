"""A real boat's autopilot, and its twin as external navigation over MAVLink."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from twin.channels import U
from twin.digital_twin import Twin
from twin.live.external.navigation import ExternalNavigation
from twin.live.external.receiver import ReceiverFeed
from twin.predictors.base import Estimate
from twin.predictors.baselines import hold_velocity

__all__ = ["Link"]

Array = NDArray[np.float64]

AHEAD_MAX_S = 2.0
"""Longest time by which an estimate is carried on to the present."""


class Link:
    """Hands the rows of a feed to external navigation, and its messages to the autopilot.

    The twin begins again when the autopilot is armed: what it saw of a moored boat would teach it
    that wind and current do not move it.
    """

    def __init__(self, feed: ReceiverFeed, navigation: ExternalNavigation) -> None:
        self.feed, self.navigation = feed, navigation
        self._armed = True

    def take(self, twin: Twin, t: float, z: Array) -> None:
        """Take a row that its twin has taken; t in s, z (17,)."""
        feed, navigation = self.feed, self.navigation
        armed, self._armed = self._armed, navigation.peer.armed
        if self._armed and not armed and navigation.state in ("waiting", "ready"):
            twin.reset()
            navigation.restart()
        age = min(feed.age(t), AHEAD_MAX_S)
        estimate = carried(twin.estimate(), age)
        stamp = feed.stamp_of(t + age)
        feed.post(navigation.take(t, z, estimate, feed.plane, stamp))

    def step(self, twin: Twin) -> int:
        """Take what has come over the wire; return the number of rows."""
        rows = self.feed.take()
        for t, z, cmd in rows:
            twin.step(t, z, cmd)
            self.take(twin, t, z)
        return len(rows)


def carried(estimate: Estimate, age: float) -> Estimate:
    """Return an estimate carried on by so many seconds with its velocity and turning rate."""
    if not (estimate.ready and age > 0.0):
        return estimate
    state = hold_velocity(estimate.state, estimate.state[U:], np.array([age]))[0]
    return dataclasses.replace(estimate, t=estimate.t + age, state=state)
