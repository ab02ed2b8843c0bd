"""Runs that others recorded, kept outside the project, as logs and particulars.

Three folders are known by name: ``esso_osaka_frt`` (a 3 m tanker on a pond, gusty wind measured),
``kvlcc2_simman2008`` (a 7 m tanker in the basins of MARIN and HSVA, calm water) and ``boat1_usv``
(the field run that also ships with the package). Their licences forbid passing the first two on. So
nothing of them is in this project, and what :func:`export` writes from them is for private use.

``Log.read`` knows the columns of these files (``twin/logs/mappings``). Here are their boats.

Source: the README of each folder.
"""

from __future__ import annotations

from pathlib import Path

from twin.logs.errors import LogError
from twin.logs.files import CsvFile, ParquetFile
from twin.logs.log import Log, recorded_runs, sibling_path
from twin.particulars import Instruments, Particulars
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import write_whole

__all__ = [
    "ArchiveError",
    "export",
    "known",
    "load",
    "runs",
    "ship",
]


class ArchiveError(UsvTwinError):
    """Recorded runs that are not there; the message says where they were looked for."""


ESSO = Particulars(
    name="Esso Osaka, 3 m model",
    length=3.0,
    beam=0.489,
    draft=0.201,
    mass=244.6,
    # the fastest 5 s of the turns and zigzags are 0.036 m ahead per revolution (median of 14)
    speed=0.36,
    shaft_speed=10.0,
    shaft_lag=0.5,
    # the recorded angle is a command that jumps; the lag was fitted, the rate is the default
    steer_lag=0.7,
    instruments=Instruments(
        gps_sd=0.012,  # jitter of 3 to 12 mm
        gps_bias_sd=0.0,
        compass_sd=0.004,  # jitter of 0.06 to 0.24 degrees
        gyro_sd=0.002,
        gps_latency=0.0,
    ),
)
"""The tanker of ``esso_osaka_frt``."""


def _kvlcc2(lab: str, instruments: Instruments) -> Particulars:
    """Return the 7 m tanker at its approach, as the lab named measured it."""
    return Particulars(
        name=f"KVLCC2, 7 m model, {lab}",
        length=7.0,
        beam=1.2688,
        draft=0.455,
        mass=3272.0,
        speed=1.179,
        shaft_speed=10.23,
        # both are recorded as they were, not as they were ordered: next to no lag
        shaft_lag=0.1,
        steer_lag=0.05,
        steer_rate=1.0,
        instruments=instruments,
    )


KVLCC2 = {
    "marin": _kvlcc2(
        "MARIN",
        Instruments(
            gps_sd=0.02,
            gps_bias_sd=0.0,
            doppler_sd=0.01,
            compass_sd=0.003,  # printed with three digits
            compass_bias_sd=0.003,
            gyro_sd=0.0002,
            gyro_bias_sd=6e-4,  # 0.03 degrees/s in all runs
            gps_latency=0.0,
        ),
    ),
    "hsva": _kvlcc2(
        "HSVA",
        Instruments(
            gps_sd=0.003,  # speeds integrate to the positions within 1 to 2 mm
            gps_bias_sd=0.0,
            doppler_sd=0.005,
            compass_sd=0.001,
            compass_bias_sd=0.001,  # a camera follows the model: nothing is magnetic
            gyro_sd=0.0002,
            gyro_bias_sd=1e-4,
            gps_latency=0.0,
        ),
    ),
}
"""The tanker of ``kvlcc2_simman2008`` by the first word of a run's name."""

_HEADERS = {
    "esso_osaka_frt": {"x_m", "y_m", "psi_rad", "n_rps", "delta_rad", "wind_true_from_rad"},
    "kvlcc2_simman2008": {"x_m", "y_m", "psi_rad", "n_rps", "delta_rad", "xdot_mps", "ydot_mps"},
    "boat1_usv": {"x_m", "y_m", "psi_rad", "sog_mps", "cog_rad", "pwm_l_us", "pwm_r_us"},
}
"""Columns by which a file of each folder is known, wherever it lies and whatever its name."""

_PATTERNS = {
    "esso_osaka_frt": "*.csv.gz",
    "kvlcc2_simman2008": "[hm]*.csv.gz",
    "boat1_usv": "*.csv.gz",
}


def runs(folder: str | Path) -> list[str]:
    """Return the names of the runs in a folder of one of the archives, sorted.

    ``turn_cut_*`` of the Esso Osaka is a piece of another run: do not learn from the one and
    score on the other. ArchiveError: the folder is absent, unknown or empty.
    """
    folder = Path(folder)
    if folder.name not in _PATTERNS:
        raise ArchiveError(
            f"{folder}: no archive of recorded runs; known by name: {', '.join(_PATTERNS)}"
        )
    found = sorted(folder.glob(_PATTERNS[folder.name]))
    if not found:
        raise ArchiveError(
            f"{folder}: no recorded run there; the data is not part of the project, put the "
            "files *.csv.gz into this folder"
        )
    return [path.name.removesuffix(".csv.gz") for path in found]


def load(folder: str | Path, name: str) -> tuple[Log, Particulars]:
    """Return a recorded run of a folder, as ``Log.read`` reads it, and its boat's particulars.

    ArchiveError: there is no such run.
    """
    folder = Path(folder)
    there = runs(folder)
    if name not in there:
        raise ArchiveError(f"{folder}: no run is called {name!r}; known: {', '.join(there)}")
    path = folder / f"{name}.csv.gz"
    return Log.read(path), ship(path)


def known(path: str | Path) -> bool:
    """Return whether a file is a run of one of the archives, by its header."""
    return _folder_of(Path(path)) is not None


def ship(path: str | Path) -> Particulars:
    """Return the particulars of the boat of a run, by its file, which may lie anywhere.

    ArchiveError: it is no file that :func:`known` knows.
    """
    folder = _folder_of(Path(path))
    if folder is None:
        raise ArchiveError(f"{path}: its header is that of no archive: {', '.join(_HEADERS)}")
    if folder == "esso_osaka_frt":
        return ESSO
    if folder == "boat1_usv":
        file = recorded_runs()["boat1_usv_circle"]
        return Particulars.load(sibling_path(file, ".toml"))
    lab = Path(path).name.split("_", 1)[0]
    return KVLCC2[lab if lab in KVLCC2 else "marin" if "x_int_m" in _header(Path(path)) else "hsva"]


def _folder_of(path: Path) -> str | None:
    """Return the folder that a file is from; none if it has the header of any other log."""
    header = _header(path)
    return next((name for name, columns in _HEADERS.items() if columns <= header), None)


def _header(path: Path) -> set[str]:
    """Return the columns of a table, compressed or not; none if it cannot be read."""
    try:
        return set((ParquetFile if path.suffix == ".parquet" else CsvFile)(path).header)
    except LogError:
        return set()


def export(folder: str | Path, out: str | Path) -> list[Path]:
    """Write the runs of a folder as ``usv-twin benchmark --log`` takes them; return the logs.

    They are ``<name>.csv``, each with particulars ``<name>.toml``. The folder ``out`` is made if it
    is not there.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for name in runs(folder):
        log, particulars = load(folder, name)
        path = out / f"{name}.csv"
        log.write(path)
        write_whole(path.with_suffix(".toml"), particulars.to_toml().encode())
        written.append(path)
    return written
