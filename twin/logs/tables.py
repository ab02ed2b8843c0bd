"""Estimates and forecasts as named columns, and as CSV, Parquet and GeoJSON files."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from twin.channels import STATE, TIME
from twin.files import write_csv
from twin.logs.datum import Datum
from twin.logs.parquet import need_polars, write_parquet
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import write_whole

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

__all__ = [
    "FORMATS",
    "ExportError",
    "StateTable",
    "check_export",
]

FORMATS = (".csv", ".parquet", ".geojson")
"""Endings of the files that a table is written to."""

_PLACES = ("latitude_deg", "longitude_deg")

_UTC = "time_utc"

_TIME_DIGITS = 6
"""Decimals of ``t_s`` in text files: seconds since 1970 are known to a quarter of a microsecond, so
the digits after these of a time that was counted from a date are chance."""


class ExportError(UsvTwinError):
    """A file that cannot be written as asked; the message names it and the remedy."""


def check_export(path: str | Path, datum: Datum | None) -> None:
    """Refuse a file of an unknown kind, and GeoJSON without a place on Earth.

    Parameters
    ----------
    path : str or Path
        Of the file.
    datum : Datum or None
        Of the log.

    Raises
    ------
    ExportError
        Names the file and the remedy.
    """
    suffix = Path(path).suffix
    if suffix not in FORMATS:
        raise ExportError(
            f"{path}: unknown kind of file; its name must end in {', '.join(FORMATS)}"
        )
    if suffix == ".parquet":
        need_polars(f"{path}: writing Parquet", ExportError)
    if suffix == ".geojson" and (datum is None or datum.plane is None):
        raise ExportError(
            f"{path}: GeoJSON needs latitude and longitude, and the log has positions in metres "
            "only. Read it with a mapping that has [position], give it the columns "
            "datum_latitude_deg and datum_longitude_deg, or choose .csv or .parquet"
        )


class StateTable(np.ndarray):
    """A structured array of states over time: one row for each time, one field for each column.

    ``table["x_m"]`` is a column. Columns are ``t_s``; ``time_utc``, ``latitude_deg`` and
    ``longitude_deg`` where the log had them; those of ``twin.channels.STATE``; and the others as
    ``sd_x_m``. A row without an estimate holds NaN.

    Attributes
    ----------
    datum : Datum or None
        Where and when t = x = y = 0 was.
    """

    datum: Datum | None

    @classmethod
    def of(cls, columns: Mapping[str, npt.ArrayLike], datum: Datum | None = None) -> StateTable:
        """Return a table of columns, with date, latitude and longitude where the datum has them.

        Parameters
        ----------
        columns : mapping of str to array_like, shape (N,)
            By name, with ``t_s``, ``x_m`` and ``y_m`` among them.
        datum : Datum, optional
            Of the log.
        """
        given = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
        located: dict[str, npt.NDArray[Any]] = {TIME: given.pop(TIME)}
        if datum is not None and (dates := datum.utc(located[TIME])) is not None:
            located[_UTC] = dates
        if datum is not None and datum.plane is not None:
            places = datum.plane.degrees(given[STATE[0]], given[STATE[1]])
            located.update(zip(_PLACES, places, strict=True))
        located.update(given)
        dtype = np.dtype([(name, values.dtype) for name, values in located.items()])
        table = np.empty(len(located[TIME]), dtype).view(cls)
        for name, values in located.items():
            table[name] = values
        table.datum = datum
        return table

    def __array_finalize__(self, source: Any) -> None:
        self.datum = getattr(source, "datum", None)

    def __getitem__(self, key: Any) -> Any:
        """Return rows as a table, a column as a plain array."""
        found = super().__getitem__(key)
        if isinstance(found, StateTable) and found.dtype.names is None:
            return found.view(np.ndarray)
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickled, (np.asarray(self), self.datum)

    def _columns(self) -> dict[str, npt.NDArray[Any]]:
        rows = np.atleast_1d(np.asarray(self))
        return {name: np.ascontiguousarray(rows[name]) for name in self.dtype.names or ()}

    def to_polars(self) -> pl.DataFrame:
        """Return a polars DataFrame, where polars is installed; dates are in UTC, NaN is null."""
        pl = need_polars("a DataFrame of polars", ExportError)
        frame = pl.DataFrame(self._columns()).fill_nan(None)
        if _UTC in frame.columns:
            frame = frame.with_columns(pl.col(_UTC).dt.replace_time_zone("UTC"))
        return frame

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas DataFrame, where pandas is installed; dates are in UTC."""
        import pandas as pd

        frame = pd.DataFrame(self._columns())
        if _UTC in frame:
            frame[_UTC] = frame[_UTC].dt.tz_localize("UTC")
        return frame

    def write(self, path: str | Path, **about: Any) -> None:
        """Write a file of the kind that its name ends in.

        Text files have times to the microsecond.

        Parameters
        ----------
        path : str or Path
            ``.csv``, ``.parquet`` or ``.geojson``.
        **about
            Properties of the track in GeoJSON: texts and numbers.

        Raises
        ------
        ExportError
            Names the file and the remedy.
        """
        path = Path(path)
        check_export(path, self.datum)
        if path.suffix == ".parquet":
            write_parquet(path, self.to_polars())
        elif path.suffix == ".csv":
            columns = self._columns()
            columns[TIME] = columns[TIME].round(_TIME_DIGITS)
            if _UTC in columns:
                dates = columns[_UTC]
                texts = np.char.add(np.datetime_as_string(dates, unit="us"), "Z")
                columns[_UTC] = np.where(np.isnat(dates), "", texts)
            buffer = io.BytesIO()
            write_csv(buffer, columns)
            write_whole(path, buffer.getvalue())
        else:
            text = json.dumps(self._geojson(about), allow_nan=False, separators=(",", ":"))
            write_whole(path, text.encode())

    def _geojson(self, about: Mapping[str, Any]) -> dict[str, Any]:
        """Return a collection of the track and of a point for each row (RFC 7946)."""
        names = [name for name in self.dtype.names or () if name not in _PLACES]
        rows = np.atleast_1d(np.array(self))
        rows[TIME] = rows[TIME].round(_TIME_DIGITS)
        known = np.isfinite(rows[_PLACES[0]])
        latitude, longitude = (rows[name][known].tolist() for name in _PLACES)
        places = [[east, north] for north, east in zip(latitude, longitude, strict=True)]
        points = [
            _feature("Point", place, dict(zip(names, map(_plain, row), strict=True)))
            for place, row in zip(places, rows[names][known].tolist(), strict=True)
        ]
        lines = _lines(places)
        whole = {"datum": None if self.datum is None else self.datum.to_json(), **about}
        track = [_feature("MultiLineString", lines, whole)] if lines else []
        return {"type": "FeatureCollection", "features": track + points}


def _unpickled(rows: npt.NDArray[Any], datum: Datum | None) -> StateTable:
    table = rows.view(StateTable)
    table.datum = datum
    return table


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _lines(places: list[list[float]]) -> list[list[list[float]]]:
    """Return a track as lines of two places or more, cut where it crosses 180 degrees."""
    lines: list[list[list[float]]] = []
    for place in places:
        if not lines or abs(place[0] - lines[-1][-1][0]) > 180.0:
            lines.append([])
        lines[-1].append(place)
    return [line for line in lines if len(line) > 1]


def _plain(value: Any) -> Any:
    """Return a value as JSON knows it: a date as text, None for NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return None if value is None else f"{value:%Y-%m-%dT%H:%M:%S.%fZ}"
