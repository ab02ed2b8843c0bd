"""Seas as a buoy measured them."""

from __future__ import annotations

import csv
import gzip
import math
import os
from pathlib import Path

import numpy as np
import pytest

from tests.usv_gym.world.seas import an_hour, realise, write
from usv_gym import SeaState
from usv_gym.physics import spectra
from usv_gym.world.sea import DISCRETISATIONS

SHARED = Path(
    os.environ.get("USV_TWIN_SHARED") or Path(__file__).resolve().parents[3].parent / "shared"
)


NDBC = SHARED / "data" / "ndbc_wave_spectra"


# six hours that are nearly PM (mismatch below .15), low to high, and two that are not
NDBC_HOURS = [
    "1996-07-12 20:00:00",
    "1996-07-22 04:00:00",
    "1996-01-05 18:00:00",
    "1996-12-28 03:00:00",
    "1996-12-07 11:00:00",
    "1996-01-17 09:00:00",
    "1996-05-16 06:00:00",
    "1996-08-11 07:00:00",
]


@pytest.fixture(scope="module")
def buoy() -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, dict[str, str]]]:
    """Return frequencies (Hz), densities (m2/Hz) and parameters of the hours of NDBC 46042."""
    if not NDBC.is_dir():
        pytest.skip(f"no NDBC spectra at {NDBC}; set USV_TWIN_SHARED to the folder of the data")
    with gzip.open(NDBC / "ndbc46042_1996_spectra.csv.gz", "rt") as file:
        header, *rows = csv.reader(file)
    f = np.array([float(name[2:-2]) for name in header[1:]])
    densities = {row[0]: np.array(row[1:], dtype=float) for row in rows if row[0] in NDBC_HOURS}
    with gzip.open(NDBC / "ndbc46042_1996_params.csv.gz", "rt") as file:
        parameters = {row["time_utc"]: row for row in csv.DictReader(file)}
    return f, densities, parameters


@pytest.mark.parametrize("discretisation", DISCRETISATIONS)
@pytest.mark.parametrize("hour", NDBC_HOURS)
def test_an_hour_of_the_buoy_is_sailed_again(
    hour: str,
    discretisation: str,
    buoy: tuple[np.ndarray, dict[str, np.ndarray], dict[str, dict[str, str]]],
    tmp_path: Path,
) -> None:
    """Spectrum in, an hour of elevation out, spectrum estimated: the same sea."""
    f, density, parameters = buoy[0], buoy[1][hour], buoy[2][hour]
    pm_like = float(parameters["mismatch_PM_HsTp"]) < 0.15
    assert pm_like == (hour in NDBC_HOURS[:6])
    header, rows = "frequency_hz,density_m2_per_hz", list(zip(f, density, strict=True))
    path = write(tmp_path / "hour.csv", header, rows)
    state = SeaState(spectrum=path, components=200, discretisation=discretisation)
    z, fine, estimate = an_hour(realise(state), segment=400.0)
    # 5 %: issue 3. Standard errors over 12 seeds: Hs .3 to 1.6 %, Tm02 .4 to 1.3 %
    assert 4.0 * np.std(z) == pytest.approx(float(parameters["Hs_m"]), rel=0.05)
    moments = spectra.moments(2.0 * math.pi * fine, estimate / (2.0 * math.pi))
    assert moments.tm02 == pytest.approx(float(parameters["Tm02_s"]), rel=0.05)
    # over the buoy's bins: .05 to .08, .103 at most over seeds; PM itself misses by .08 to .55
    binned = np.array([np.mean(estimate[np.abs(fine - at) < 0.00501]) for at in f])
    assert np.sum(np.abs(binned - density)) / (2.0 * np.sum(density)) < 0.12
