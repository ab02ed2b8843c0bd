"""Hull surface with given length, beam, draft, volume and water plane."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from usv_gym.vessel.form import Form
from usv_gym.vessel.mesh import Array, Mesh, loft, mirrored

__all__ = ["HullLines"]

_STATIONS = 33
_BELOW = 8
_ABOVE = 4

_BLUNT = (0.7, 12.0)  # exponents of sections that a keel may be tilted to

_TILT = 1.0  # logarithm of the largest ratio of a keel's depth at an end and amidships

_POWERS = (math.log(0.6), math.log(40.0))  # logarithms of a section's exponent: hollow V to box


class HullLines:
    """Lines of a hull, or of the starboard hull of a catamaran.

    Sections below water are superellipses: one exponent takes them from a V to a box. The water
    line has straight sides between run and entrance. The fullness of the water line is solved for
    its area, and the exponent for the volume. The keel is tilted until the centre of buoyancy
    is where the form asks for it, so that the hull floats level. An impossible one is
    approached as closely as possible. ``mesh`` is the closed surface of hull and deck.
    """

    def __init__(self, form: Form) -> None:
        self.form = form
        twin = form.pontoon > 0.0
        self.beam = form.pontoon or form.beam
        self.offset = 0.5 * (form.beam - form.pontoon) if twin else 0.0
        self.block = form.volume / (form.length * self.beam * form.draft) / (2.0 if twin else 1.0)
        plane = self.block / (0.47 + 0.55 * self.block)
        if form.waterplane is not None:
            plane = form.waterplane / (form.length * self.beam) / (2.0 if twin else 1.0)
        self.plane = plane
        angle = np.linspace(0.0, math.pi, _STATIONS)
        self.params = 0.5 * (1.0 - np.cos(angle)) * 0.75 + 0.25 * angle / math.pi
        if form.buoyancy is None:
            self._fit(0.0)
        else:
            want = (form.buoyancy - form.stern) / form.length
            most = math.copysign(_TILT, want - self._fit(0.0))
            while abs(most) > 0.05 * _TILT and not self._fits(most):
                most *= 0.8
            low, high = min(most, 0.0), max(most, 0.0)
            self._fit(_bisect(lambda tilt: self._fit(tilt) - want, low, high, 16))
        one = loft(self._rings(), caps=(True, False)).moved([0.0, self.offset, 0.0])
        self.mesh = Mesh.joined((mirrored(one), one)) if twin else one

    def _fit(self, tilt: float) -> float:
        """Fit the lines with the keel deeper forward; return the centre of buoyancy.

        It is a share of the length from the stern.
        """
        self.tilt = tilt
        fullness = _bisect(
            lambda f: float(np.trapezoid(self._side(f), self.params)) - self.plane, 0.0, 1.0
        )
        power = _bisect(lambda n: self._displaced(fullness, math.exp(n)), *_POWERS)
        if power in _POWERS:  # out of range: change the water line instead
            fullness = _bisect(lambda f: self._displaced(f, math.exp(power)), 0.0, 1.0)
        self.fullness, self.power = fullness, math.exp(power)
        volume, moment = self._moments(self.fullness, self.power)
        return moment / volume

    def _fits(self, tilt: float) -> bool:
        """Return whether volume and water plane can both be had with a tilted keel."""
        self._fit(tilt)
        return bool(_BLUNT[0] < self.power < _BLUNT[1])

    def _side(self, fullness: float) -> Array:
        """Half breadths of the water line, as shares of the largest."""
        full = {"steerable_drive": 0.86, "thruster_pair": 0.8}.get(self.form.kind, 0.25)
        transom = full + (1.0 - full) * fullness**2
        start = 0.12 + 0.8 * fullness  # of the entrance
        end = min(start, 0.42 - 0.3 * fullness)  # of the run
        fore = np.clip((self.params - start) / (1.0 - start), 0.0, 1.0)
        aft = np.clip((end - self.params) / end, 0.0, 1.0)
        side = (1.0 - fore ** (1.65 + 1.5 * fullness)) * (1.0 - (1.0 - transom) * aft**2)
        return np.asarray(side / side.max())

    def _keel(self) -> Array:
        """Drafts of the sections, as shares of the largest."""
        foot = min(max(0.45 + 0.55 * self.block, 0.5), 0.95)
        keel = np.sqrt(1.0 - np.clip((self.params - foot) / (1.0 - foot), 0.0, 1.0) ** 2)
        if self.form.kind == "propeller_rudder":  # the keel rises ahead of the propeller
            rise = np.clip(self.params / min(max(0.7 * (1.0 - self.block), 0.02), 0.14), 0.0, 1.0)
            keel *= 0.12 + 0.88 * rise**2 * (3.0 - 2.0 * rise)
        keel = keel * np.exp(self.tilt * (2.0 * self.params - 1.0))
        return np.asarray(keel / keel.max())

    def _below(self, fullness: float, power: float) -> tuple[Array, Array]:
        """Return y and z of the sections from keel to water line, m, each (stations, rows + 1)."""
        angle = np.linspace(0.0, 0.5 * math.pi, _BELOW + 1)
        across, down = np.sin(angle) ** (2.0 / power), np.cos(angle) ** (2.0 / power)
        down[-1] = 0.0
        y = 0.5 * self.beam * np.outer(self._side(fullness), across)
        return y, self.form.draft * np.outer(self._keel(), down)

    def _displaced(self, fullness: float, power: float) -> float:
        """Error of the block coefficient."""
        return self._moments(fullness, power)[0] / (self.beam * self.form.draft) - self.block

    def _moments(self, fullness: float, power: float) -> tuple[float, float]:
        """Return the volume (m2) and its moment about the stern (m2), with lengths as shares."""
        y, z = self._below(fullness, power)

        def area(y: Array, z: Array) -> Array:
            steps = (y[:, 1:] + y[:, :-1]) * (z[:, :-1] - z[:, 1:])
            return np.asarray(steps.sum(axis=1))

        ends, half = area(y, z), area(0.5 * (y[1:] + y[:-1]), 0.5 * (z[1:] + z[:-1]))
        step, aft = np.diff(self.params), self.params[:-1]
        volume = (ends[1:] + 4.0 * half + ends[:-1]) / 6.0 * step
        fore = (ends[1:] + 2.0 * half) / 6.0 * step  # Simpson's rule of the share of each piece
        return float(volume.sum()), float(np.sum(volume * aft + fore * step))

    def deck(self) -> tuple[Array, Array, Array]:
        """x, half breadth and z of the deck's edge, m, each (stations,)."""
        x, y, z = (self._rings()[:, _BELOW + _ABOVE, i] for i in range(3))
        return x, y, z

    def _rings(self) -> Array:
        """Sections as closed polygons from the keel up to starboard, (stations, points, 3)."""
        form, xi = self.form, self.params
        y, z = self._below(self.fullness, self.power)
        sheer = 1.0 + 0.45 * np.clip((xi - 0.35) / 0.65, 0.0, 1.0) ** 2
        if form.pontoon:
            sheer = 1.0 + 0.25 * np.clip((xi - 0.6) / 0.4, 0.0, 1.0) ** 2
        height = np.linspace(0.0, 1.0, _ABOVE + 1)[1:]
        side = self._side(self.fullness)
        y_top = 0.5 * self.beam * (np.outer(side, 1.0 - height) + np.outer(side**0.7, height))
        z_top = -form.freeboard * np.outer(sheer, height)
        y, z = np.hstack([y, y_top]), np.hstack([z, z_top])
        # the stem rakes forward; ships overhang aft too, boats carry their drives there
        over = form.overall - form.length
        back = 0.5 * over if form.kind == "propeller_rudder" else 0.0
        rise = np.concatenate([np.zeros(_BELOW + 1), height])
        rake = (over - back) * np.clip((xi - 0.45) / 0.55, 0.0, 1.0) ** 2
        rake -= back * np.clip((0.2 - xi) / 0.2, 0.0, 1.0)
        x = (form.stern + form.length * xi)[:, None] + np.outer(rake, rise**0.8)
        crown = z[:, -1:] - 0.05 * y[:, -1:]
        half = np.stack([x, y, z], axis=-1)
        top = np.stack([x[:, -1:], np.zeros_like(crown), crown], axis=-1)
        port = half[:, :0:-1] * (1.0, -1.0, 1.0)
        return np.concatenate([half, top, port], axis=1)


def _bisect(f: Callable[[float], float], a: float, b: float, steps: int = 40) -> float:
    """Return the root of a rising function, or the nearest end."""
    if f(a) >= 0.0:
        return a
    if f(b) <= 0.0:
        return b
    low, high = a, b
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(middle) < 0.0 else (low, middle)
    return 0.5 * (low + high)
