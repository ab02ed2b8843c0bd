"""Validation of the sea: spectra, gusts, wind loads and drift."""

from __future__ import annotations

import math

import numpy as np

from usv_gym.physics import GRAVITY, spectra, waves, wind
from usv_gym.validation.study import (
    DEGREE,
    SEPARATE,
    Array,
    Row,
    Section,
    Study,
    an_hour,
    peak_period,
    realise,
    rows,
)
from usv_gym.world.sea import DISCRETISATIONS, SeaState

SEAS = {
    "PM, Hs .5 m": SeaState(hs=0.5, components=400),
    "ITTC, Hs .5 m, Tp 5 s": SeaState(hs=0.5, spectrum="ittc", tp=5.0, components=400),
    "JONSWAP, Hs .5 m, Tp 4 s": SeaState(hs=0.5, spectrum="jonswap", tp=4.0, components=400),
}


def sea(study: Study) -> Section:
    """Return the constants of spectra, and an hour of each sea."""
    omega, f = np.geomspace(0.05, 500.0, 100_001), np.geomspace(1.0 / 600.0, 0.5, 20_001)
    U, hs = 7.0, 0.5
    m0 = float(np.trapezoid(spectra.pm_spectrum_wind(omega, U), omega))
    Tp = spectra.pm_peak_period(hs)
    peak = 2.0 * math.pi / Tp
    equal = spectra.pm_equal_energy(hs, (np.arange(50) + 0.5) / 50)
    scale = math.sqrt(9.81 / GRAVITY)  # the published frequencies are for g = 9.81 m/s2
    drawn = realise(SeaState(hs=hs, components=50), study.boat).waves[waves.AMPLITUDE]
    bounds = [
        ("equal energy: lowest frequency at g = 9.81, rad/s", equal[0] * scale, 1.283),
        ("equal energy: highest frequency at g = 9.81, rad/s", equal[-1] * scale, 5.935),
    ]
    gusts = [
        (f"{name}: sigma, m/s", math.sqrt(float(np.trapezoid(spectrum(f, 10.0), f))), want)
        for name, spectrum, want in (
            ("NPD gusts, U10 = 10 m/s, 1/600-.5 Hz", spectra.npd_spectrum, 0.871),
            ("Harris gusts, U10 = 10 m/s", spectra.harris_spectrum, 1.22),
            ("Davenport gusts, U10 = 10 m/s", spectra.davenport_spectrum, 1.20),
        )
    ]
    constants = [
        ("PM: m0 g^2/U^4", m0 * GRAVITY**2 / U**4, 0.0027365),
        ("PM: Hs g/U^2", 4.0 * math.sqrt(m0) * GRAVITY / U**2, 0.2092),
        ("PM: w_p sqrt(Hs/g)", peak * math.sqrt(hs / GRAVITY), 0.4012),
    ]
    half_metre = [
        ("PM, Hs = .5 m: w_p, rad/s", peak, 1.777),
        ("PM, Hs = .5 m: T_p, s", Tp, 3.54),
        ("PM, Hs = .5 m: lambda_p, m", GRAVITY * Tp**2 / (2.0 * math.pi), 19.5),
    ]
    amplitude = "equal energy, N = 50, Hs = .5 m: every amplitude, m"
    hours = []
    for name, state in SEAS.items():
        for discretisation in DISCRETISATIONS:
            given = state.replace(discretisation=discretisation)
            z, bins, density = an_hour(realise(given, study.boat))
            table = given.wave_spectrum()
            want = np.interp(2.0 * math.pi * bins, table.omega, table.density, left=0.0, right=0.0)
            where = f"an hour of {name}, {discretisation}"
            hours += [
                (f"{where}: Hs, m", 4.0 * float(np.std(z)), given.hs),
                (f"{where}: Tp, s", peak_period(bins, density), peak_period(bins, want)),
            ]
    return Section(
        "Sea and gusts",
        "Constants of the wave and gust spectra, and the spectrum of an hour of simulated "
        "elevation at one place (Welch's method). It must have the significant height and the "
        "peak period of the given spectrum within 5 %. Peak periods are from the mean frequency "
        "weighted with S^4 (Young 1995). Twelve measured hours of NDBC buoy 46042 (1996, one a "
        "month, close to a PM spectrum) are simulated from their spectra. The mismatch is the "
        "integral of the absolute difference over twice the energy. Waves are linear and "
        "long-crested here.",
        (
            *rows(constants, SEPARATE, 1e-3),
            *rows(half_metre, SEPARATE, 1e-2),
            *rows([(amplitude, float(np.max(drawn)), 0.025)], SEPARATE, 1e-12),
            *rows(bounds, SEPARATE, 5e-4, "absolute"),
            *rows(gusts, SEPARATE, 0.01),
            *rows(hours, "given spectrum", 0.05),
            *_buoy_rows(study),
        ),
        {
            "spectra.png": "Given spectra (lines) and those of an hour of simulated elevation "
            "(dots); right, one hour of NDBC buoy 46042."
        },
    )


def _buoy_rows(study: Study) -> list[Row]:
    """Return the errors over all hours of the buoy; skipped without the data."""
    hours, source = list(study.hours.values()), "NDBC buoy 46042, 1996"
    values: dict[str, float] = {}
    if hours:
        for name, key in (("Hs", "hs"), ("Tm02", "tm02"), ("Tp", "tp")):
            pairs = np.array([getattr(hour, key) for hour in hours])
            values[f"largest error of {name}"] = np.max(np.abs(pairs[:, 0] / pairs[:, 1] - 1.0))
        mismatch = [hour.mismatch for hour in hours]
        values["mean mismatch of the spectra"] = float(np.mean(mismatch))
        values["median mismatch of the spectra"] = float(np.median(mismatch))
    skipped, reference = ("", 0.0) if hours else ("the NDBC spectra are missing", None)
    return [
        Row(
            f"12 hours of the buoy: {item}",
            values.get(item),
            reference,
            allowed,
            source,
            "absolute",
            3,
            skipped,
        )
        for item, allowed in (
            ("largest error of Hs", 0.05),
            ("largest error of Tm02", 0.05),
            ("largest error of Tp", 0.05),
            ("mean mismatch of the spectra", 0.1),
            ("median mismatch of the spectra", 0.1),
        )
    ]


BLENDERMANN_LOADS = (
    (0.0, (-134.64, None, None)),
    (30.0, (-139.46, 296.44, 330.15)),
    (90.0, (None, 495.72, -148.72)),
    (135.0, (131.65, 444.33, -604.42)),
)
"""Direction (deg) and X, Y (N), N (N m) of 10 m/s apparent wind on the 7.5 m boat."""

BLENDERMANN_COEFFICIENTS = ((30.0, (-0.56968, 0.53821, 0.07992)), (90.0, (None, 0.9, -0.0360)))

DRIFT = ((0.5, (0.0738, 1.017, 0.0588)), (1.0, (0.09, 0.08, -0.01)))
"""Wave length over ship length, and C_X, C_Y, C_N."""


def apparent(gamma: float, p: Array, speed: float = 10.0) -> tuple[float, float, float]:
    """Return X, Y, N of apparent wind off the bow (rad, above 0 from port) on a boat at rest."""
    to = gamma + math.pi
    return wind.wind_loads(0.0, 0.0, 0.0, speed * math.cos(to), -speed * math.sin(to), p)


def wind_and_drift(study: Study) -> Section:
    """Return Blendermann's coefficients and the mean drift of waves."""
    p, loads, drifts = study.boat.packed.copy(), [], []
    for names, table, values in (
        (("C_X", "C_Y", "C_N"), BLENDERMANN_COEFFICIENTS, wind.coefficients),
        (("X, N", "Y, N", "N, N m"), BLENDERMANN_LOADS, apparent),
    ):
        for gamma, wants in table:
            got = values(gamma * DEGREE, p)
            loads += [
                (f"wind, speed boat, {gamma:g} deg: {name}", value, want)
                for name, value, want in zip(names, got, wants, strict=True)
                if want is not None
            ]
    for x, wants in DRIFT:
        printed = waves.drift_coefficients(np.array(x))
        drifts += [
            (f"drift, lambda/L = {x:g}: {name}", float(value), want)
            for name, value, want in zip(("C_X", "C_Y", "C_N"), printed, wants, strict=True)
        ]
    return Section(
        "Wind and mean wave drift",
        "Blendermann's wind coefficients for a speed boat (A_F 4, A_L 9 m2, Loa 7.5 m, 10 m/s), "
        "and the mean-drift regression as printed. The rows check the formulas; the areas of the "
        "7.5 m boat are estimates. The regression is used up to lambda/L = 1.",
        (
            *rows(loads, SEPARATE, 1e-4, digits=5),
            *rows(drifts, SEPARATE, 1e-3, "absolute"),
        ),
        {
            "wind.png": "Wind coefficients of the 7.5 m boat over the direction of the apparent "
            "wind; dots are the references."
        },
    )
