"""Main particulars and instruments of a boat: what its twin knows before any data.

All settings scale with these numbers. So one set of dimensionless settings serves a 1 m model
and a 300 m tanker (Froude scaling).
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twin.boat_prior import BoatPrior, BoatPriorError
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import read_toml

__all__ = [
    "DESIGNS",
    "GRAVITY",
    "STEERING",
    "Deck",
    "Instruments",
    "Particulars",
]

GRAVITY = 9.81
"""Gravity, m/s2."""

SEA_WATER_KGPM3 = 1025.0
"""Density of sea water."""

DRIVES_FROUDE_MIN = 0.35
"""Froude number of the service speed above which a boat is taken to have drives, not rudders."""

FULL_BLOCK_MIN = 0.75
"""Block coefficient from which on a ship is a tanker or a bulk carrier."""

DECK_FORWARD_LENGTHS = 0.4
"""Default of the deck point, in lengths forward of the origin."""

LATENCY_MAX_S = 10.0
"""Largest age of a sample when it arrives."""

WIND_HEIGHT_MAX_M = 1000.0
"""Largest height of an anemometer."""

ANGLE_SD_MAX_RAD = 1.0
"""Largest standard deviation of an angle: more is taken for degrees."""

OFF_BOAT_LENGTHS = 2.0
OFF_BOAT_MIN_M = 10.0
"""Largest distance of anything on board from the origin: lengths, and at least this."""

HULLS_WIDTH_MIN = 0.6
"""Least width over both hulls, as a share of the stated beam."""

BLOCK_MIN = 0.02
BLOCK_MAX = 1.1
"""Mass over that of the water in a box of length, beam and draft, at least and at most."""

BEAM_MAX_LENGTHS = 1.5
"""Largest beam in lengths."""

STEERING = ("drives", "differential")
"""``drives``: the thrust is turned by the drive (or rudder) angle.
``differential``: the units are fixed and steer by unequal thrust."""

DESIGNS = ("usv75",)
"""Classes of boats of which a model is known: a prior of theirs comes with the package."""

STUDY_LENGTH_M = 6.336
STUDY_SPEED_MPS = 5.4
"""Waterline and speed of the boat that filters and learners were tuned for."""


class ParticularsError(UsvTwinError):
    """Particulars that cannot be used; the message names the key and the remedy."""


_MAY_BE_ZERO = (
    *("gps_bias_sd", "compass_bias_sd", "gyro_bias_sd", "height_bias_sd", "tilt_sd"),
    *("gps_latency", "compass_latency", "ahrs_latency", "hull_beam", "spacing"),
)
"""The other numbers are above 0."""

_MOST = {
    **dict.fromkeys(("gps_latency", "compass_latency", "ahrs_latency"), (LATENCY_MAX_S, "s")),
    "wind_height": (WIND_HEIGHT_MAX_M, "m"),
    "max_tilt": (0.5 * math.pi, "rad"),
}
"""Largest values and their units."""


def _check_fields(record: Any) -> None:
    """Refuse numbers that are not finite or out of their range."""
    for item in dataclasses.fields(record):
        name, value = item.name, getattr(record, item.name)
        if name in _TRIPLES:
            if value is not None:
                _check_triple(name, value)
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        if not math.isfinite(value):
            raise ParticularsError(f"{name} = {value} is not a finite number")
        if value < 0.0 or (value == 0.0 and name not in _MAY_BE_ZERO):
            bound = "0 or more" if name in _MAY_BE_ZERO else "above 0"
            raise ParticularsError(f"{name} = {value} must be {bound}")
        most, unit = _MOST.get(name, (math.inf, ""))
        if value > most:
            remedy = f"; {_as_degrees([value])}" if unit == "rad" else ""
            raise ParticularsError(f"{name} = {value} must be {most:.4g} {unit} or less{remedy}")


_ANGLES = ("compass_sd", "compass_bias_sd", "ahrs_sd", "tilt_sd")
"""Standard deviations of angles, rad."""

_TRIPLES = {
    "gps_arm": "m forward, to starboard and down of the origin, such as [1.5, -0.2, -2.0]",
    "imu_arm": "m forward, to starboard and down of the origin, such as [1.5, -0.2, -0.3]",
    "imu_mounting": "roll, pitch and yaw of its axes in rad, such as [0.0, 0.0, 1.571]",
    "point": "m forward, to starboard and down of the origin, such as [-1.5, 0.0, -0.5]",
}
"""What the fields of three numbers are."""


def _check_triple(name: str, value: Any) -> None:
    sizes = (3,) if name == "imu_mounting" else (2, 3)
    numbers = isinstance(value, (tuple, list)) and len(value) in sizes
    if not numbers or not all(
        isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v) for v in value
    ):
        raise ParticularsError(f"{name} = {value!r} must be three finite numbers: {_TRIPLES[name]}")
    if name == "imu_mounting" and max(map(abs, value)) > math.pi:
        raise ParticularsError(
            f"{name} = {value!r} must be rad, at most {math.pi:.4g}; {_as_degrees(value)}"
        )


def _refuse_degrees(instruments: Any) -> None:
    """Refuse standard deviations of a file that are in degrees, as far as their size shows it.

    Sensors as bad as that can be simulated, and a log can show such scatter.
    """
    for name in _ANGLES if isinstance(instruments, dict) else ():
        value = instruments.get(name)
        if isinstance(value, (int, float)) and value > ANGLE_SD_MAX_RAD:
            raise ParticularsError(
                f"{name} = {value} must be {ANGLE_SD_MAX_RAD:g} rad or less; {_as_degrees([value])}"
            )


def _as_degrees(values: Sequence[float]) -> str:
    """Return what angles are in rad if they were meant in degrees."""
    shown = ", ".join(f"{math.radians(value):.4g}" for value in values)
    return f"if it is in degrees, write {f'[{shown}]' if len(values) > 1 else shown}"


@dataclass(frozen=True, kw_only=True)
class Instruments:
    """Standard deviations and delays that the data sheets of the sensors state.

    Parameters
    ----------
    gps_sd, gps_bias_sd : float
        Position, m: what changes from fix to fix, and what drifts over minutes. No filter
        takes the second away, so it is added to every standard deviation of a position.
    doppler_sd : float
        Velocity over ground, m/s.
    compass_sd : float
        Heading, rad: what changes from sample to sample ...
    compass_bias_sd : float
        ... and what drifts over minutes, rad.
    gyro_sd, gyro_bias_sd : float
        Yaw rate: white noise per sample and bias, rad/s.
    accel_sd, accel_bias_sd : float
        Specific force: white noise per sample and bias, m/s2.
    gps_latency, compass_latency, ahrs_latency : float
        Age of a fix, a heading, and roll and pitch of an AHRS when they arrive, s; up to 10.
    gps_arm, imu_arm : tuple of float
        Where antenna and IMU sit: m forward, to starboard and down of the origin, which is the
        point whose position and velocity are wanted. The last of the three may be left out.
    imu_mounting : tuple of float
        Roll, pitch and yaw of the axes of the IMU against those of the boat, rad; up to pi.
    ahrs_sd, ahrs_time : float
        Roll and pitch of an AHRS, rad, and how long its error lasts, s.
    height_sd, height_bias_sd, climb_sd : float
        Height and vertical speed of the GNSS: white noise and drift of the height, m; m/s.
    tilt_sd, tilt_time : float
        Typical roll and pitch (rad) of a boat whose accelerometers measure gravity with them, and
        how long a tilt lasts (s). 0 for a boat that stays upright or whose IMU removes gravity.
    wind_height : float
        Height of the anemometer above the sea, m.
    """

    gps_sd: float = 0.4
    gps_bias_sd: float = 1.0
    doppler_sd: float = 0.08
    compass_sd: float = 0.012
    compass_bias_sd: float = 0.0175
    gyro_sd: float = 0.002
    gyro_bias_sd: float = 0.001
    accel_sd: float = 0.12
    accel_bias_sd: float = 0.05
    gps_latency: float = 0.1
    compass_latency: float = 0.0
    ahrs_latency: float = 0.0
    gps_arm: tuple[float, ...] = (0.0, 0.0, 0.0)
    imu_arm: tuple[float, ...] = (0.0, 0.0, 0.0)
    imu_mounting: tuple[float, ...] = (0.0, 0.0, 0.0)
    ahrs_sd: float = 0.005
    ahrs_time: float = 10.0
    height_sd: float = 0.6
    height_bias_sd: float = 1.5
    climb_sd: float = 0.08
    tilt_sd: float = 0.0
    tilt_time: float = 2.0
    wind_height: float = 10.0

    def __post_init__(self) -> None:
        _check_fields(self)
        for name in ("gps_arm", "imu_arm", "imu_mounting"):
            given = tuple(map(float, getattr(self, name)))
            object.__setattr__(self, name, (*given, 0.0)[:3])


@dataclass(frozen=True, kw_only=True)
class Deck:
    """A point of the deck, and how quiet it must be there.

    Parameters
    ----------
    point : tuple of float, optional
        m forward, to starboard and down of the origin; left out: .4 lengths forward.
    max_tilt : float
        Largest roll and pitch of a quiet deck, rad.
    max_speed : float
        Its largest vertical speed, m/s.
    """

    point: tuple[float, ...] | None = None
    max_tilt: float = math.radians(3.0)
    max_speed: float = 0.5

    def __post_init__(self) -> None:
        _check_fields(self)
        if self.point is not None:
            object.__setattr__(self, "point", (*map(float, self.point), 0.0)[:3])

    def point_of(self, length: float) -> tuple[float, ...]:
        """Return the point on a boat of this length (m)."""
        return (DECK_FORWARD_LENGTHS * length, 0.0, 0.0) if self.point is None else self.point


@dataclass(frozen=True, kw_only=True)
class Particulars:
    """Main particulars of a boat, as far as its twin needs them.

    Parameters
    ----------
    name : str
        For tables and pictures.
    length, beam, draft : float
        On the waterline, m; the beam over all hulls.
    mass : float
        Displacement, kg.
    speed : float
        A typical speed, m/s.
    shaft_speed : float
        Shaft speed of each propeller at that speed, rev/s. Where the unit of
        the recorded command is unknown (per cent, pulse width), any unit will do, if the
        log uses the same.
    steering : str
        One of :data:`STEERING`.
    shaft_lag, steer_lag : float
        Time constants of the shaft speed and of the drive angle, s.
    steer_rate : float
        Largest turning speed of the drive, rad/s.
    design : str
        The boat's class, one of :data:`DESIGNS`, or empty. The prior of a class tells
        ``dsw-ukf-plus`` more than main particulars do: see :mod:`twin.model.priors`.
    hulls : int
        1, or 2 of a catamaran. Two hulls are no tanker; nothing else in the twin depends on it.
    hull_beam, spacing : float
        Of a catamaran, m: beam of each hull, and distance of their centre lines; 0 where unknown.
        They are checked against beam and mass, and change no result: no prior knows them.
    instruments : Instruments
        Sensors on board.
    deck : Deck
        The place where the deck must be quiet, and what that means.
    prior : BoatPrior, optional
        What earlier runs of this boat say of its parameters. In a file: the path of what
        ``usv-twin identify --save-prior`` wrote, counted from the folder of the file.
    """

    name: str
    length: float
    beam: float
    draft: float
    mass: float
    speed: float
    shaft_speed: float
    steering: str = "drives"
    shaft_lag: float = 0.6
    steer_lag: float = 0.1
    steer_rate: float = 0.35
    design: str = ""
    hulls: int = 1
    hull_beam: float = 0.0
    spacing: float = 0.0
    instruments: Instruments = field(default_factory=Instruments)
    deck: Deck = field(default_factory=Deck)
    prior: BoatPrior | None = None

    def __post_init__(self) -> None:
        _check_fields(self)
        if self.steering not in STEERING:
            raise ParticularsError(
                f"steering = {self.steering!r} is unknown; use one of {', '.join(STEERING)}"
            )
        self._check_dimensions()
        self._check_hulls()
        self._check_places()
        if self.design != "" and self.design not in DESIGNS:
            raise ParticularsError(
                f"design = {self.design!r}: no prior of this class comes with usv-twin; use "
                f"{', '.join(DESIGNS)}, leave it out, or give the twin a prior of your own "
                "(docs/how-to/own_prior.md, examples/priors)"
            )
        if self.design and (self.steering != "drives" or self.tanker):
            raise ParticularsError(
                f"design = {self.design!r} is a class of boats with drives, and the other "
                "particulars are not of such a boat. Correct them, or leave the class out"
            )
        if self.prior is not None:
            self._check_prior(self.prior)

    def _check_prior(self, prior: BoatPrior) -> None:
        """Refuse a prior of another boat."""
        if not isinstance(prior, BoatPrior):
            raise ParticularsError(
                f"prior = {prior!r}: read it with twin.boat_prior.BoatPrior.load"
            )
        try:
            prior.check_boat(self)
        except BoatPriorError as error:
            raise ParticularsError(f"prior: {error}") from None

    def _check_places(self) -> None:
        """Refuse sensors and a deck point that are not on the boat."""
        most, on_board = max(OFF_BOAT_LENGTHS * self.length, OFF_BOAT_MIN_M), self.instruments
        places = {"gps_arm": on_board.gps_arm, "imu_arm": on_board.imu_arm}
        if self.deck.point is not None:
            places["point"] = self.deck.point
        for name, place in places.items():
            if max(map(abs, place)) > most:
                raise ParticularsError(
                    f"{name} = {list(place)} is not on a boat of {self.length:g} m; state it in "
                    f"{_TRIPLES[name]}"
                )

    def _check_dimensions(self) -> None:
        """Refuse length, beam, draft and mass that no boat has together."""
        box = SEA_WATER_KGPM3 * self.length * self.beam * self.draft
        least, most = BLOCK_MIN * box, BLOCK_MAX * box
        if not least <= self.mass <= most or self.beam > BEAM_MAX_LENGTHS * self.length:
            raise ParticularsError(
                f"length = {self.length:g} m, beam = {self.beam:g} m, draft = {self.draft:g} m and "
                f"mass = {self.mass:g} kg contradict each other: a boat of this size weighs "
                f"{least:.2g} to {most:.2g} kg; correct one of them"
            )

    def _check_hulls(self) -> None:
        """Refuse hulls that contradict each other or the mass."""
        if self.hulls not in (1, 2):
            raise ParticularsError(f"hulls = {self.hulls:g} must be 1, or 2 of a catamaran")
        object.__setattr__(self, "hulls", int(self.hulls))
        if self.hulls == 1 and (self.hull_beam or self.spacing):
            raise ParticularsError("hull_beam and spacing are of a catamaran; add hulls = 2")
        wide = self.hull_beam + (self.spacing or self.hull_beam)
        if self.hulls == 2 and (wide > 1.01 * self.beam or 0.0 < self.spacing < self.hull_beam):
            raise ParticularsError(
                f"hull_beam = {self.hull_beam:g}, spacing = {self.spacing:g}: the hulls must not "
                f"overlap, and must lie within the beam of {self.beam:g} m"
            )
        if self.hull_beam and self.spacing and wide < HULLS_WIDTH_MIN * self.beam:
            raise ParticularsError(
                f"hull_beam = {self.hull_beam:g}, spacing = {self.spacing:g}: the hulls are "
                f"{wide:g} m wide together, and the beam over both is {self.beam:g} m; spacing is "
                "from centre line to centre line; correct one of them"
            )
        box = SEA_WATER_KGPM3 * self.length * self.draft * 2.0 * self.hull_beam
        if 0.0 < box < self.mass:
            raise ParticularsError(
                f"mass = {self.mass:g} kg is more than two hulls of hull_beam = {self.hull_beam:g} "
                f"m can carry at this length and draft ({box:.4g} kg); correct one of them"
            )

    @classmethod
    def load(cls, path: str | Path, log: str | Path | None = None) -> Particulars:
        """Read particulars from a TOML file.

        Parameters
        ----------
        path : str or Path
            File with a table ``[particulars]`` and, if wished, ``[instruments]`` and ``[deck]``;
            the keys are the fields of :class:`Particulars`, :class:`Instruments` and
            :class:`Deck`, in SI units. A file of several boats has ``[[ship]]`` for each, with the
            patterns of its logs (``logs = ["my_folder/*"]``, matched from the end of a path) and
            the tables ``[ship.particulars]`` and so on.
        log : str or Path, optional
            Log whose boat is wanted, in a file of several.

        Returns
        -------
        Particulars

        Raises
        ------
        ParticularsError
            Names the file, the key and the remedy.
        """
        path = Path(path)
        table = read_toml(path, ParticularsError)
        try:
            if "ship" in table:
                table = _ship_of(table, log)
            unknown = set(table) - {"particulars", "instruments", "deck"}
            if "hull" in unknown:
                raise ParticularsError(VESSEL_FILE)
            if {"time", "columns"} & unknown:
                raise ParticularsError("this is a mapping: give it with --mapping")
            if unknown or "particulars" not in table:
                raise ParticularsError(
                    "expected the tables [particulars] and, if wished, [instruments] and [deck]; "
                    f"found {', '.join(sorted(table)) or 'none'}"
                )
            about = table["particulars"]
            if isinstance(about, dict) and isinstance(about.get("prior"), str):
                about = {**about, "prior": BoatPrior.load(path.parent / about["prior"])}
            _refuse_degrees(table.get("instruments"))
            return cls.from_tables(about, table.get("instruments", {}), table.get("deck", {}))
        except (ParticularsError, BoatPriorError) as error:
            commented = re.search(r"(?m)^# \w+ = \?", path.read_text(encoding="utf-8"))
            missing = commented and "missing key" in str(error)
            remedy = "; fill them in, and remove the # before them" if missing else ""
            raise ParticularsError(f"{path}: {error}{remedy}") from None

    @classmethod
    def from_tables(cls, particulars: Any, instruments: Any, deck: Any = None) -> Particulars:
        """Return particulars from plain tables of values by field name, in SI units.

        ``prior`` may be a :class:`BoatPrior` or a table of its fields. ParticularsError names key
        and remedy.
        """
        on_board = Instruments(**_known(Instruments, instruments))
        quiet = Deck(**_known(Deck, {} if deck is None else deck))
        about = dict(_known(cls, particulars))
        prior = about.pop("prior", None)
        if prior is not None and not isinstance(prior, BoatPrior):
            prior = BoatPrior.from_table(prior)
        return cls(**about, instruments=on_board, deck=quiet, prior=prior)

    @property
    def time_scale(self) -> float:
        """Time to sail a length, in units of the study boat's."""
        return self.length / self.speed / (STUDY_LENGTH_M / STUDY_SPEED_MPS)

    @property
    def froude(self) -> float:
        """Froude number of the typical speed."""
        return self.speed / math.sqrt(GRAVITY * self.length)

    @property
    def tanker(self) -> bool:
        """Whether it is a slow ship of full form, which has one propeller and one rudder."""
        box = SEA_WATER_KGPM3 * self.length * self.beam * self.draft
        full = (
            FULL_BLOCK_MIN * box <= self.mass <= box
        )  # a hull cannot fill more than the box around it
        return (
            self.hulls == 1
            and self.steering == "drives"
            and self.froude <= DRIVES_FROUDE_MIN
            and full
        )

    def to_toml(self) -> str:
        """Return the text of a file that :meth:`load` reads back to the same value."""
        lines = ["# Main particulars for the twin, SI units.", "[particulars]"]
        for item in dataclasses.fields(self):
            hull = item.name in ("hulls", "hull_beam", "spacing")
            if item.name not in ("instruments", "deck", "prior") and not (hull and self.hulls == 1):
                value = getattr(self, item.name)
                # A JSON string is a TOML string, quotes and all.
                is_text = isinstance(value, str)
                text = json.dumps(value, ensure_ascii=False) if is_text else repr(float(value))
                lines.append(f"{item.name} = {text}")
        for title, part in (("instruments", self.instruments), ("deck", self.deck)):
            if part == Deck():
                continue
            lines += ["", f"[{title}]"]
            for item in dataclasses.fields(part):
                value = getattr(part, item.name)
                if value is not None:
                    text = repr(list(value) if isinstance(value, tuple) else float(value))
                    lines.append(f"{item.name} = {text}")
        if self.prior is not None:
            lines += ["", "[particulars.prior]", self.prior.to_toml().rstrip()]
        return "\n".join(lines) + "\n"


VESSEL_FILE = (
    "is a vessel file, with the table [hull], and no file of particulars. On the command line name "
    "it with --ship, or put it beside the log as <log>.toml. In Python: "
    "twin.sim.bridge.particulars_of(usv_gym.Vessel.load(path))"
)
"""Said of a file of ``usv-twin vessel new``; the twin on board does not import the simulator."""


def _ship_of(table: dict[str, Any], log: str | Path | None) -> dict[str, Any]:
    """Return the tables of the first ship whose patterns a log matches."""
    ships = table["ship"]
    sound = isinstance(ships, list) and all(
        isinstance(ship, dict)
        and isinstance(ship.get("logs"), list)
        and all(isinstance(pattern, str) for pattern in ship["logs"])
        for ship in ships
    )
    if len(table) > 1 or not sound:
        raise ParticularsError(
            'expected only [[ship]], each with logs = ["pattern"], [ship.particulars] and, if '
            "wished, [ship.instruments]"
        )
    if log is None:
        raise ParticularsError("is of several ships, and no log says which; give a file of one")
    where = Path(log).absolute()
    for ship in ships:
        if any(where.match(pattern) for pattern in ship["logs"]):
            return {key: value for key, value in ship.items() if key != "logs"}
    known = ", ".join(pattern for ship in ships for pattern in ship["logs"])
    raise ParticularsError(f"no ship has the log {log}; logs are: {known}")


def _known(kind: type, table: Any) -> dict[str, Any]:
    """Return the table if each key is a field of the right type and none is missing."""
    if not isinstance(table, dict):
        raise ParticularsError("expected a table of keys and values")
    own = ("instruments", "deck")
    fields = {item.name: item for item in dataclasses.fields(kind) if item.name not in own}
    for key, value in table.items():
        if key not in fields:
            raise ParticularsError(f"unknown key {key!r}; known keys: {', '.join(fields)}")
        if key in _TRIPLES or key == "prior":
            continue  # the class itself checks it
        text = key in ("name", "steering", "design")
        wanted = str if text else (int, float)
        if not isinstance(value, wanted) or isinstance(value, bool):
            raise ParticularsError(f"{key} = {value!r} must be a {'text' if text else 'number'}")
    missing = [
        name
        for name, item in fields.items()
        if name not in table and item.default is dataclasses.MISSING
    ]
    if missing:
        raise ParticularsError(f"missing key(s): {', '.join(missing)}")
    if kind is Particulars and "steering" not in table:
        raise ParticularsError(
            'steering is missing: how does the boat steer? "drives": the thrust is turned by a '
            'drive or rudder angle; "differential": the units are fixed and steer by unequal '
            "thrust; add the line steering = ..."
        )
    return table
