"""Height and vertical speed of the GNSS against the accelerometers: sign and unit."""

from __future__ import annotations

import math

import numpy as np

from twin.logs.columns import Array
from twin.logs.diagnosis.axes.evidence import FORCES, fast
from twin.logs.diagnosis.findings import ERROR, Finding, Recording
from twin.logs.diagnosis.signals import ENOUGH, averaged, integrated, sampled

__all__ = ["check_height"]

_STILL = 0.03
"""Vertical speeds below tell nothing, m/s."""

_SMOOTH = 0.3
"""Changes are compared over so many seconds."""

_CLEAR = 0.6
"""From this correlation on two signals belong together."""

_SPAN, _TOO_LARGE = 1.0, 50.0
"""Changes of the vertical speed over such a time (s) that are so many times those of the integrated
accelerometers are in cm/s, whatever the noise."""

_SLOW, _STEP = 8.0, 0.1
"""Heights are compared where they change faster than this, at such steps, s."""

_SURE = 5.0
"""A factor of the height counts from so many standard deviations on."""

_UNITS = {"feet": 0.3048, "cm": 0.01, "mm": 0.001}


def check_height(recording: Recording) -> list[Finding]:
    """Return whether height and vertical speed of the GNSS point down, and are in metres.

    Parameters
    ----------
    recording : Recording
        The log; accelerometers of three axes tell of the vertical speed, that of the height.
    """
    t_force, force = recording.samples(*FORCES)
    t, speed = recording.samples("gps_vz_mps")
    if len(t_force) < 5 * ENOUGH:
        return _check_place(recording, (t, speed[:, 0])) if len(t) >= 5 * ENOUGH else []
    lift = np.asarray(np.linalg.norm(force, axis=1))
    # an upright boat that is pushed down weighs less
    sunk = t_force, -integrated(t_force, lift - lift.mean())
    if len(t) < 5 * ENOUGH or float(speed.std()) < _STILL:
        return _check_place(recording, sunk)
    found = _check_climb_unit(recording, (t, speed[:, 0]), (t_force, lift))
    if found:
        return found + _check_place(recording, sunk)
    grid = np.arange(t[0] + _SMOOTH, t[-1] - _SMOOTH, _SMOOTH)
    signals = ((t, speed[:, 0]), sunk)
    both = np.column_stack([averaged(*signal, grid, _SMOOTH) for signal in signals])
    step = both[1:] - both[:-1]
    step = step[np.isfinite(step).all(axis=1)]
    if len(step) < ENOUGH:
        return []
    correlation = float(np.corrcoef(step[:, 0], step[:, 1])[0, 1])
    if not correlation < -_CLEAR:
        return _check_place(recording, (t, speed[:, 0]))
    place = _check_place(recording, (t, -speed[:, 0]))
    too = " for gps_z_m too" if any(finding.code == "height-sign" for finding in place) else ""
    what = f"{recording.called('gps_vz_mps')}: against the accelerometers: it points up"
    remedy = f'it is above 0 downwards; state frame = "enu" or scale = -1.0{too}'
    return [Finding(ERROR, "climb-sign", what, remedy, {"correlation": correlation}), *place]


def _check_place(recording: Recording, climb: tuple[Array, Array]) -> list[Finding]:
    """Return whether a height follows a vertical speed."""
    t, height = recording.samples("gps_z_m")
    if len(t) < 5 * ENOUGH:
        return []
    grid = np.arange(max(t[0], climb[0][0]) + _STEP, min(t[-1], climb[0][-1]) - _STEP, _STEP)
    width = round(_SLOW / _STEP)
    if len(grid) < 6 * width:
        return []
    step = max(float(np.median(np.diff(t))), _STEP)
    both = np.column_stack([sampled(*climb, grid), averaged(t, height[:, 0], grid, step)])
    lost = np.isnan(both).any(axis=1)
    both[lost] = 0.0
    sunk = integrated(grid, fast(both[:, :1], width))
    x, y = fast(np.column_stack([sunk[:, 0], both[:, 1]]), width).T
    kept = np.convolve(lost, np.ones(2 * width + 1))[width:-width] < 0.5
    kept[: 2 * width] = kept[-2 * width :] = False
    x, y = x[kept], y[kept]
    power = float(x @ x)
    if len(x) < 10 * ENOUGH or power <= 0.0:
        return []
    factor = float(x @ y) / power
    left = float(np.mean((y - factor * x) ** 2))
    sd = math.sqrt(left / power * step / _STEP)
    name, numbers = recording.called("gps_z_m"), {"factor": factor, "sd": sd}
    if abs(factor - 1.0) < _SURE * sd:
        return []
    found = []
    if factor < -_SURE * sd:
        what = f"{name}: against the vertical motion (factor {factor:.2g}): it points up"
        remedy = 'it is above 0 downwards; state frame = "enu" or scale = -1.0'
        found.append(Finding(ERROR, "height-sign", what, remedy, numbers))
    for unit, scale in _UNITS.items():
        if abs(abs(factor) * scale - 1.0) < max(0.25, 2.0 * sd * scale) and abs(factor) - 1.5 > (
            _SURE * sd
        ):
            what = f"{name}: moves {abs(factor):.3g} times as far as the vertical motion: {unit}"
            remedy = f"it is in metres; state scale = {scale:g} in a mapping file"
            found.append(Finding(ERROR, "height-unit", what, remedy, numbers))
    return found


def _check_climb_unit(
    recording: Recording, climb: tuple[Array, Array], lift: tuple[Array, Array]
) -> list[Finding]:
    """Return whether a vertical speed changes far more than the accelerometers allow."""
    t = climb[0]
    at = np.arange(t[0] + _SPAN, t[-1] - _SPAN, 0.5 * _SPAN)
    speed = averaged(*climb, at, _SMOOTH)
    before = averaged(*climb, at - _SPAN, _SMOOTH)
    gain = integrated(lift[0], lift[1] - lift[1].mean())
    gained = sampled(lift[0], gain, at) - sampled(lift[0], gain, at - _SPAN)
    ok = np.isfinite(speed) & np.isfinite(before) & np.isfinite(gained)
    if ok.sum() < ENOUGH:
        return []
    ratio = float(np.std((speed - before)[ok])) / max(float(np.std(gained[ok])), 1e-9)
    if ratio < _TOO_LARGE:
        return []
    name = recording.called("gps_vz_mps")
    what = f"{name}: changes {ratio:.0f} times as much as the accelerometers show"
    remedy = "it is in m/s; state scale = 0.01 in a mapping file if this is cm/s, 0.001 if mm/s"
    return [Finding(ERROR, "climb-unit", what, remedy, {"ratio": ratio})]
