"""Runs that others recorded, kept outside the project, as logs and particulars.

Three folders are known by their names: ``esso_osaka_frt`` (a 3 m tanker on a pond, gusty wind
measured), ``kvlcc2_simman2008`` (a 7 m tanker in the basins of MARIN and HSVA, calm water) and
``boat1_usv`` (the field run that also ships with the package). Their licences forbid to pass
the first two on: nothing of them is in this project, and what :func:`export` writes from them
is for the user's own eyes.

The ships have one propeller and one rudder: both shafts of a log turn as the one, and both
drive angles are the rudder's.

Source: the README of each folder; what follows it says so where it is done.
"""

from __future__ import annotations

import dataclasses
import gzip
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.log import COMMANDS, MEASUREMENTS, Log, LogError, drop_repeats, recorded_runs
from twin.particulars import Instruments, Particulars

__all__ = ["ArchiveError", "export", "known", "load", "load_file", "runs"]

Array = NDArray[np.float64]
Columns = Mapping[str, Array]


class ArchiveError(ValueError):
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
    # the recorded angle is a command that jumps; the lag is twin.md's, the rate the default
    steer_lag=0.7,
    instruments=Instruments(
        gps_sd=0.012,  # jitter of 3 to 12 mm
        gps_bias_sd=0.0,
        compass_sd=0.004,  # jitter of 0.06 to 0.24 degrees
        gyro_sd=0.004,
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
            gyro_sd=0.001,
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
            gyro_sd=0.001,
            gyro_bias_sd=1e-4,
            gps_latency=0.0,
        ),
    ),
}
"""The tanker of ``kvlcc2_simman2008`` by the first word of a run's name."""


def _esso(name: str, c: Columns) -> tuple[dict[str, Array], dict[str, Array], Particulars]:
    """Position, heading, yaw rate and wind: the recorded u, v are filtered and .6 s late."""
    z = {
        "gps_x_m": c["x_m"],
        "gps_y_m": c["y_m"],
        "compass_rad": c["psi_rad"],
        "wind_mps": c["wind_true_mps"],
        "wind_from_rad": c["wind_true_from_rad"],
    }
    if not name.startswith("berthing"):  # there the yaw rate is .7 to 1 s late too
        z["gyro_radps"] = c["r_radps"]
    return z, _one_shaft(c), ESSO


def _towed(name: str, c: Columns) -> tuple[dict[str, Array], dict[str, Array], Particulars]:
    """Position, earth-fixed speeds as in the source, heading and yaw rate.

    MARIN printed positions with three digits, so that they stand still for a second and jump
    by 0.2 m; the integrals of the speeds are taken instead. They drift from the printed ones
    by 1 % of the speed, which no forecast of 10 s feels. The integral of the yaw rate drifts
    by its bias, hence the printed heading.
    """
    lab = name.split("_", 1)[0]
    if lab not in KVLCC2:
        lab = "marin" if "x_int_m" in c else "hsva"
    x, y = ("x_int_m", "y_int_m") if lab == "marin" else ("x_m", "y_m")
    z = {
        "gps_x_m": c[x],
        "gps_y_m": c[y],
        "gps_vx_mps": c["xdot_mps"],
        "gps_vy_mps": c["ydot_mps"],
        "compass_rad": c["psi_rad"],
        "gyro_radps": c["r_radps"],
    }
    return z, _one_shaft(c), KVLCC2[lab]


def _boat1(name: str, c: Columns) -> tuple[dict[str, Array], dict[str, Array], Particulars]:
    """Position, speed over ground and heading; pulse widths as shaft speeds.

    The local x, y of the source are 1.11172 times what its latitude and longitude say, and
    the shaft speeds are in an arbitrary unit: see NOTICE.txt beside the shipped run.
    """
    z = {
        "gps_x_m": c["x_m"] / 1.11172,
        "gps_y_m": c["y_m"] / 1.11172,
        "gps_vx_mps": c["sog_mps"] * np.cos(c["cog_rad"]),
        "gps_vy_mps": c["sog_mps"] * np.sin(c["cog_rad"]),
        "compass_rad": c["psi_rad"],
    }
    left, right = ((c[f"pwm_{side}_us"] - 1500.0) / 50.0 for side in "lr")
    none = np.zeros_like(left)
    beside = recorded_runs()["boat1_usv_circle"].with_name("boat1_usv_circle.toml")
    return z, dict(zip(COMMANDS, (left, right, none, none), strict=True)), Particulars.load(beside)


def _one_shaft(c: Columns) -> dict[str, Array]:
    """Return the commands of a ship with one propeller and one rudder."""
    return dict(
        zip(COMMANDS, (c["n_rps"], c["n_rps"], c["delta_rad"], c["delta_rad"]), strict=True)
    )


_HEADERS = {
    "esso_osaka_frt": {"x_m", "y_m", "psi_rad", "n_rps", "delta_rad", "wind_true_from_rad"},
    "kvlcc2_simman2008": {"x_m", "y_m", "psi_rad", "n_rps", "delta_rad", "xdot_mps", "ydot_mps"},
    "boat1_usv": {"x_m", "y_m", "psi_rad", "sog_mps", "cog_rad", "pwm_l_us", "pwm_r_us"},
}
"""Columns by which a file of each folder is known, wherever it lies and whatever its name."""

_Reader = Callable[[str, Columns], tuple[dict[str, Array], dict[str, Array], Particulars]]
_FOLDERS: dict[str, tuple[str, _Reader]] = {
    "esso_osaka_frt": ("*.csv.gz", _esso),
    "kvlcc2_simman2008": ("[hm]*.csv.gz", _towed),
    "boat1_usv": ("*.csv.gz", _boat1),
}


def runs(folder: str | Path) -> list[str]:
    """Return the names of the runs in a folder, sorted.

    Parameters
    ----------
    folder : str or Path
        One of the three folders, as it was downloaded.

    Raises
    ------
    ArchiveError
        If the folder is absent, unknown or empty.

    Notes
    -----
    ``turn_cut_*`` of the Esso Osaka is a piece of another run: do not learn from the one and
    score on the other.
    """
    folder = Path(folder)
    if folder.name not in _FOLDERS:
        raise ArchiveError(
            f"{folder}: no archive of recorded runs; known by name: {', '.join(_FOLDERS)}"
        )
    found = sorted(folder.glob(_FOLDERS[folder.name][0]))
    if not found:
        raise ArchiveError(
            f"{folder}: no recorded run there; the data is not part of the project, put the "
            "files *.csv.gz into this folder"
        )
    return [path.name.removesuffix(".csv.gz") for path in found]


def load(folder: str | Path, name: str) -> tuple[Log, Particulars]:
    """Return a recorded run and the particulars of its boat.

    Parameters
    ----------
    folder : str or Path
        As for :func:`runs`.
    name : str
        One of :func:`runs`.

    Returns
    -------
    Log, Particulars
        The log as the boat would have recorded it, without truth. Positions that repeat the
        last one (a receiver that is slow, or froze) are missing; what was repaired is in its
        ``notes``.

    Raises
    ------
    ArchiveError
        If there is no such run.
    """
    folder = Path(folder)
    there = runs(folder)
    if name not in there:
        raise ArchiveError(f"{folder}: no run is called {name!r}; known: {', '.join(there)}")
    return _load(folder.name, folder / f"{name}.csv.gz")


def known(path: str | Path) -> bool:
    """Return whether a file is a run of one of the archives, by its header.

    Parameters
    ----------
    path : str or Path
        Any file; one that cannot be read is none.
    """
    return _folder_of(Path(path)) is not None


def load_file(path: str | Path) -> tuple[Log, Particulars]:
    """Return a run as :func:`load` does, by its file, which may lie anywhere.

    Parameters
    ----------
    path : str or Path
        A file that :func:`known` knows.

    Raises
    ------
    ArchiveError
        If it is none, or cannot be read to its end.
    """
    folder = _folder_of(Path(path))
    if folder is None:
        raise ArchiveError(f"{path}: its header is that of no archive: {', '.join(_HEADERS)}")
    return _load(folder, Path(path))


def _folder_of(path: Path) -> str | None:
    """Return the folder that a file is from; none if it has the header of a usual log."""
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            header = set(file.readline(10_000).strip().split(","))
    except (OSError, EOFError, UnicodeDecodeError, zlib.error):
        return None
    return next((name for name, columns in _HEADERS.items() if columns <= header), None)


def _load(folder: str, path: Path) -> tuple[Log, Particulars]:
    import polars as pl

    try:
        frame = pl.read_csv(gzip.decompress(path.read_bytes()), infer_schema=False)
        columns = {
            key: frame[key].str.strip_chars().replace("", None).cast(pl.Float64).to_numpy()
            for key in frame.columns
        }
    except (OSError, EOFError, zlib.error, pl.exceptions.PolarsError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ArchiveError(f"{path}: cannot be read ({reason}); download it again") from None
    name = path.name.removesuffix(".csv.gz")
    measured, commands, particulars = _FOLDERS[folder][1](name, columns)
    t, never = columns["t_s"], np.full(len(frame), np.nan)
    z = np.column_stack([measured.get(key, never) for key in MEASUREMENTS])
    notes: list[str] = []
    cmd = np.column_stack([commands[key] for key in COMMANDS])
    try:
        log = Log(t, z, cmd, None, name)
    except LogError as error:
        raise ArchiveError(f"{path}: {error}; download it again") from None
    drop_repeats(t, z, notes)
    return dataclasses.replace(log, z=z, notes=tuple(notes)), particulars


def export(folder: str | Path, out: str | Path) -> list[Path]:
    """Write the runs of a folder as ``usv-twin benchmark --log`` takes them.

    Parameters
    ----------
    folder : str or Path
        As for :func:`runs`.
    out : str or Path
        Folder to write to, made if it is not there: for each run ``<name>.csv`` and the
        particulars ``<name>.toml``.

    Returns
    -------
    list of Path
        The logs.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for name in runs(folder):
        log, particulars = load(folder, name)
        path = out / f"{name}.csv"
        log.write(path)
        path.with_suffix(".toml").write_text(particulars.to_toml(), encoding="utf-8")
        written.append(path)
    return written
