r"""NMEA 0183: sentences of a boat as rows.

Taken are, of any talker, GGA and RMC (fix and velocity), or GNS, GLL, VTG where these do not come;
the heading of the first that comes of HDT, THS, PASHR, VHW, HDG and HDM, magnetic ones with the
variation of HDG or RMC; ROT (rate of turn), RPM and RSA (commands); for roll and pitch PASHR, or
XDR with transducers named PTCH or PITCH
(bow up) and ROLL or HEEL (starboard down). Followed by RATE, as in ROLLRATE, they are rates of the
gyros, degrees/s. PASHR may be that of Trimble, or ATT, AT2 and HPR of
Ashtech, of which only those with a fixed ambiguity count. MWV with the reference R is the apparent
wind, MWD the true one; an MWV with the reference T is not followed. The height of a GGA counts as
well. GGA and RMC of the same epoch are one fix. ZDA and TAG blocks give the time.

=========  ====================================================================================
RPM        rev/min of shaft or engine; its number is 0: single, even: port, odd: starboard
RSA        rudder angle, degrees, above 0 to starboard; the first is starboard or single
``\c:...``  TAG block with UNIX time, s or ms: the time of the sentence, before its own
=========  ====================================================================================

HDT, ROT, RPM, RSA, XDR, MWV and MWD hold no time, and ATT and AT2 that of the GPS week. They have
that of the sentence before them in the same datagram (ZDA, GGA, RMC, a TAG block). Without one, it
is that of their arrival by the sender's clock. A TAG block in whole seconds is the time of the
first sentence of its kind in that second alone.

Source: NMEA 0183 version 4.10, section 6 (sentences), section 7 (TAG blocks).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import time
from typing import Any

from twin.channels import COMMANDS
from twin.logs.wire.feed import MEMORY, Feed, Message
from twin.logs.wire.sockets import FeedError, needed

__all__ = [
    "DAY",
    "KNOT",
    "NmeaFeed",
]

DAY = 86400.0

KNOT = 1852.0 / 3600.0

BETTER = {"GNS": ("GGA", "RMC"), "GLL": ("GGA", "RMC", "GNS"), "VTG": ("RMC",)}
"""Kinds of sentences that count only while these do not come; of headings, see below."""

HEADINGS = ("HDT", "THS", "PASHR", "VHW", "HDG", "HDM")
"""Sentences with a heading, the best first."""

BETTER |= {kind: HEADINGS[:k] for k, kind in enumerate(HEADINGS)}

NOTED = 8
"""Most kinds of sentences that a note names."""

LENGTH_MAX = 1024
"""Longest line that counts as a sentence, characters."""

NO_FIX = (0, 6)
"""GGA qualities that measure nothing (none, estimated), ..."""

NO_MODE = ("N", "E")
"""... and modes of RMC, and of each system of satellites of GNS."""

TILTED = {"PTCH": "pitch", "PITCH": "pitch", "ROLL": "roll", "HEEL": "roll"}
"""How names of transducers begin, and what they measure."""

GYROS = {"roll": "gyro_x_radps", "pitch": "gyro_y_radps"}
"""Columns of their rates."""

ASHTECH = {"ATT": "ATT", "AT2": "ATT", "HPR": "HPR"}
"""Kinds of PASHR of Ashtech that are read, and the kind whose fields they begin with."""

SPEED_UNITS = {"M": 1.0, "N": KNOT, "K": 1.0 / 3.6, "S": 0.44704}
"""Units of a wind speed: m/s, knots, km/h, and statute miles an hour."""

_LINES = re.compile(r"[\r\n]+|(?<!\\)(?=[$!])")

_TAG = re.compile(r"\\([^\\*]*)\*([0-9A-Fa-f]{2})\\")

_WHOLE = re.compile(r"\*[0-9A-Fa-f]{2}$")


class NmeaFeed(Feed):
    """Sentences of a boat as rows; see :class:`~twin.logs.wire.feed.Feed`."""

    modulus = DAY

    def __init__(self, *args: Any, **options: Any) -> None:
        self._library = needed("pynmeagps")
        self._rest = ""
        self._seconds: dict[str, float] = {}
        self._epoch = math.nan, math.nan
        self._variation: float | None = None  # of the compass, east above 0, rad
        self._magnetic = False  # whether a heading waits for it
        self._gave: dict[tuple[str, str], float] = {}  # when which sentence gave what last
        self._others: set[str] = set()  # kinds of sentences that are not followed
        super().__init__(*args, **options)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know; also which of position and heading did not come, and why."""
        came = {what for what, _ in self._gave}
        lacks = [name for name in ("position", "heading") if name not in came]
        found = super().notes
        if lacks and (self._magnetic or self._others):
            why = "; a magnetic one came, but no variation (HDG, RMC)" * self._magnetic
            others = ", ".join(sorted(self._others)[:NOTED])
            why += f"; {others}: not followed" if others else ""
            found = (*found, f"no {' and no '.join(lacks)} has come{why}")
        return found

    def decode(self, data: bytes) -> Iterator[Message | str]:
        """Yield the messages of a datagram; see :meth:`Feed.decode`."""
        stamp: float | None = None
        kinds: set[str] = set()
        for line in self._lines(data.decode("latin-1")):
            item = self._sentence(line)
            if isinstance(item, Message):
                if item.stamp is not None:
                    stamp, kinds = item.stamp, set()
                elif stamp is not None and item.kind not in kinds:
                    item = replace(item, stamp=stamp)
                kinds.add(item.kind)
            yield item

    def _lines(self, text: str) -> Iterator[str]:
        """Yield the lines of a datagram, joined with what the last one left unended."""
        if self._rest:
            if text[:1] in "$!\\":
                yield self._rest
            else:
                text = self._rest + text
            self._rest = ""
        lines = [line for line in _LINES.split(text) if line.strip()]
        if lines and text[-1] not in "\r\n" and not _WHOLE.search(lines[-1]):
            last = lines.pop()
            if len(last) <= LENGTH_MAX and last[0] in "$!\\":
                self._rest = last
            else:
                yield last
        yield from lines

    def _sentence(self, line: str) -> Message | str:
        """Return what a line says, or how it counts."""
        if len(line) > LENGTH_MAX:
            return "broken"
        try:
            tagged, line = self._tag(line.strip())
            if line[:1] == "!":
                return "unknown"
            if line[:1] != "$":
                return "broken"
            message = self._read(line)
        except (
            *(ValueError, ArithmeticError, LookupError, TypeError, AttributeError),
            *(self._library.NMEAMessageError, self._library.NMEATypeError),
        ):
            return "broken"
        if isinstance(message, str):
            return message
        if tagged is None or (tagged == self._seconds.get(message.kind)):
            return message
        if tagged == math.floor(tagged):
            self._seconds[message.kind] = tagged
        if message.stamp is not None:  # GGA and RMC of an epoch stay together
            if self._epoch[0] != message.stamp:
                self._epoch = message.stamp, tagged
            tagged = self._epoch[1]
        return replace(message, stamp=tagged)

    def _read(self, line: str) -> Message | str:
        """Return what a sentence says, or how it counts; raise if it cannot be read."""
        content, talker, kind, fields, checksum = self._library.get_parts(line)
        if self._library.calc_checksum(content) != checksum.upper():
            return "broken"
        if kind not in _READERS or (talker == "P") != (kind == "ASHR"):
            self._others.add(f"P{kind}" if talker == "P" else kind)
            return "unknown"
        if kind == "ASHR" and fields[0][:1].isalpha():
            if fields[0] not in ASHTECH:
                return "unknown"
            fields[0] = ASHTECH[fields[0]]
        sentence = self._library.NMEAMessage(talker, kind, 0, payload=fields, checksum=checksum)
        message = _READERS[kind](sentence)
        return message if isinstance(message, str) else self._best(message)

    def _best(self, message: Message) -> Message | str:
        """Return what a message says without what a better one says, and with the true heading."""
        values, fix = dict(message.values), message.fix
        self._variation = values.pop("variation", self._variation)
        magnetic = values.pop("magnetic", None)
        if magnetic is not None and "compass_rad" not in values:
            self._magnetic = self._variation is None
            if self._variation is not None:
                values["compass_rad"] = (magnetic + self._variation) % (2.0 * math.pi)
        for what, name in (("heading", "compass_rad"), ("velocity", "gps_vx_mps")):
            if name in values and not self._is_best(message.kind, what):
                for each in (name, "gps_vy_mps") if what == "velocity" else (name,):
                    del values[each]
        if fix is not None and not self._is_best(message.kind, "position"):
            fix = None
        nothing = not message.void and (message.values or message.fix) and not (values or fix)
        if nothing and message.stamp is None:
            return "void" if magnetic is not None and self._magnetic else "unknown"
        return replace(message, values=values, fix=fix)

    def _is_best(self, kind: str, what: str) -> bool:
        """Return whether no better sentence gave the same lately; note that this one did."""
        now = self.clock()
        for better in BETTER.get(kind, ()):
            if now - self._gave.get((what, better), -math.inf) < MEMORY:
                return False
        self._gave[what, kind] = now
        return True

    def _tag(self, line: str) -> tuple[float | None, str]:
        """Return the time of a TAG block, s of the day, and the line without the block."""
        if line[:1] != "\\":
            return None, line
        found = _TAG.match(line)
        if found is None or self._library.calc_checksum(found[1]) != found[2].upper():
            raise FeedError("no TAG block")
        rest = line[found.end() :]
        for code in found[1].split(","):
            if code.startswith("c:"):
                stamp = float(code[2:])
                # UNIX time, s or ms
                return math.fmod(stamp / 1000.0 if abs(stamp) > 1e11 else stamp, DAY), rest
        return None, rest


def _seconds(moment: time) -> float:
    """Return the time of day, s."""
    return 3600.0 * moment.hour + 60.0 * moment.minute + moment.second + 1e-6 * moment.microsecond


def _stamp(moment: time | str, text: str) -> float | None:
    """Return the time of day of a field, s; None if it is empty."""
    if isinstance(moment, str):
        if text:
            raise FeedError(f"{text}: no time of day")
        return None
    return _seconds(moment)


def _number(value: float | str) -> float | None:
    """Return a number, or None of an empty field."""
    return None if isinstance(value, str) else float(value)


def _place(sentence: Any) -> tuple[float, float] | None:
    """Return the latitude and longitude of a sentence; 0, 0 is that of one without a fix."""
    place = sentence.lat, sentence.lon
    if place == ("", "") or place == (0.0, 0.0):
        return None
    if "" in place or sentence.NS not in ("N", "S") or sentence.EW not in ("E", "W"):
        raise FeedError(f"{place}: no position")
    return place


def _gga(sentence: Any) -> Message:
    return _fix("GGA", sentence, sentence.quality == "" or sentence.quality in NO_FIX)


def _fix(kind: str, sentence: Any, void: bool) -> Message:
    place = None if void else _place(sentence)
    height = None if place is None else _number(sentence.alt)
    values = {} if height is None else {"gps_z_m": -height}
    stamp = _stamp(sentence.time, sentence.payload[0])
    return Message(kind, stamp, values, place, void=place is None)


def _rmc(sentence: Any) -> Message:
    # receivers before NMEA 2.3 have no mode
    void = sentence.status != "A" or getattr(sentence, "posMode", "") in NO_MODE
    place = None if void else _place(sentence)
    values = {}
    if not void:
        speed, course = _number(sentence.spd), _number(sentence.cog)
        if speed is not None and speed < 0.0:
            raise FeedError("a speed below 0")
        # a receiver at rest leaves the course empty
        if speed is not None and (course is not None or speed == 0.0):
            course = math.radians((course or 0.0) % 360.0)
            values["gps_vx_mps"] = KNOT * speed * math.cos(course)
            values["gps_vy_mps"] = KNOT * speed * math.sin(course)
        values |= _eastward("variation", sentence.mv, sentence.mvEW)
    stamp = _stamp(sentence.time, sentence.payload[0])
    return Message("RMC", stamp, values, place, void=place is None and not values)


def _gll(sentence: Any) -> Message:
    void = sentence.status != "A" or getattr(sentence, "posMode", "") in NO_MODE
    place = None if void else _place(sentence)
    return Message("GLL", _stamp(sentence.time, sentence.payload[4]), {}, place, void=place is None)


def _vtg(sentence: Any) -> Message:
    knots, kmph, course = map(_number, (sentence.sogn, sentence.sogk, sentence.cogt))
    speed = KNOT * knots if knots is not None else None if kmph is None else kmph / 3.6
    void = getattr(sentence, "posMode", "") in NO_MODE
    if void or speed is None or (course is None and speed > 0.0):
        return Message("VTG", void=True)
    course = math.radians((course or 0.0) % 360.0)
    north, east = speed * math.cos(course), speed * math.sin(course)
    return Message("VTG", values={"gps_vx_mps": north, "gps_vy_mps": east})


def _eastward(name: str, angle: float | str, side: str) -> dict[str, float]:
    """Return a variation or deviation, rad, east above 0; nothing of an empty one."""
    value = _number(angle)
    if value is None or side not in ("E", "W"):
        return {}
    return {name: math.radians(value if side == "E" else -value)}


def _heading(kind: str, true: float | str, magnetic: float | str = "", **more: float) -> Message:
    """Return a heading that is true, or magnetic with a deviation or the variation, if known."""
    values, deviation = dict(more), more.get("deviation", 0.0)
    for name, given in (("compass_rad", true), ("magnetic", magnetic)):
        heading = _number(given)
        if heading is None:
            continue
        if not 0.0 <= heading <= 360.0:
            raise FeedError("no heading")
        values[name] = math.radians(heading % 360.0) + deviation * (name == "magnetic")
    values.pop("deviation", None)
    return Message(kind, values=values, void=not values.keys() & {"compass_rad", "magnetic"})


def _hdg(sentence: Any) -> Message:
    known = _eastward("variation", sentence.variation, sentence.variationEW)
    known |= _eastward("deviation", sentence.deviation, sentence.deviationEW)
    return _heading("HDG", "", sentence.headingM, **known)


def _ths(sentence: Any) -> Message:
    # estimated, or not valid
    return Message("THS", void=True) if sentence.mi in "EV" else _heading("THS", sentence.headt)


def _rot(sentence: Any) -> Message:
    rate = _number(sentence.rot)
    if rate is None or sentence.valid != "A":
        return Message("ROT", void=True)
    return Message("ROT", values={"gyro_radps": math.radians(rate) / 60.0})


def _rpm(sentence: Any) -> Message:
    number, speed = sentence.engineshaftnum, _number(sentence.rpm)
    if number == "" or speed is None or sentence.status != "A":
        return Message("RPM", void=True)
    if number not in range(100):
        raise FeedError("no shaft")
    names = COMMANDS[:2] if number == 0 else (COMMANDS[number % 2],)
    return Message(f"RPM{number}", values=dict.fromkeys(names, speed / 60.0))


def _rsa(sentence: Any) -> Message:
    starboard, port = (
        math.radians(angle) if angle != "" and status == "A" else None
        for angle, status in (
            (sentence.stbdangle, sentence.stbdstatus),
            (sentence.portangle, sentence.portstatus),
        )
    )
    left, right = (starboard if port is None else port), starboard
    sides = zip(COMMANDS[2:], (left, right), strict=True)
    values = {name: value for name, value in sides if value is not None}
    return Message("RSA", values=values, void=not values)


def _tilt(roll: float | None, pitch: float | None) -> dict[str, float]:
    """Return roll and pitch, given in degrees, without those that are not there."""
    values: dict[str, float] = {}
    for name, angle in (("ahrs_roll_rad", roll), ("ahrs_pitch_rad", pitch)):
        if angle is not None:
            if abs(angle) > 90.0:
                raise FeedError(f"{angle}: no roll or pitch")
            values[name] = math.radians(angle)
    return values


def _ashr(sentence: Any) -> Message:
    """Return roll and pitch of a PASHR: of Ashtech's only where the ambiguity is fixed (0)."""
    # a PASHR ATT has seconds of the GPS week, which are ahead of UTC by leap seconds
    moment, fields = getattr(sentence, "utctime", ""), sentence.payload
    stamp = None if fields[0] == "ATT" else _stamp(moment, fields[1 if fields[0] == "HPR" else 0])
    if getattr(sentence, "ambiguity", 0) != 0:
        return Message("PASHR", stamp, void=True)
    values = _tilt(_number(sentence.roll), _number(sentence.pitch))
    values |= _heading("PASHR", sentence.trueHdg).values
    return Message("PASHR", stamp, values, void=not values)


def _xdr(sentence: Any) -> Message:
    """Return roll, pitch and rates of transducers: type A, angle, D, name; again and again."""
    found: dict[str, float] = {}
    rates: dict[str, float] = {}
    for i in range(1, len(sentence.payload) // 4 + 1):
        kind, value, unit, name = (
            getattr(sentence, f"{part}_{i:02d}")
            for part in ("tdrtype", "data", "dataunit", "tdrid")
        )
        words = [part for part in TILTED if name.strip().upper().startswith(part)]
        if kind == "A" and unit == "D" and words and value != "":
            kept = rates if "RATE" in name.upper() else found
            kept.setdefault(TILTED[words[0]], value)
    values = _tilt(found.get("roll"), found.get("pitch"))
    values |= {GYROS[name]: math.radians(rate) for name, rate in rates.items()}
    # one sentence each is common: then the second is no repetition of the first
    return Message(" ".join(("XDR", *sorted(values))), values=values, void=not values)


def _mwv(sentence: Any) -> Message | str:
    """Return the apparent wind; that of the reference T holds the motion of the boat already."""
    if sentence.reference != "R":
        return "unknown"
    angle, speed = _number(sentence.angle), _number(sentence.speed)
    if angle is None or speed is None or sentence.status != "A":
        return Message("MWV", void=True)
    unit = SPEED_UNITS.get(sentence.speedu)
    if unit is None or speed < 0.0 or not 0.0 <= angle <= 360.0:
        raise FeedError("no wind")
    turned = math.remainder(math.radians(angle), 2.0 * math.pi)
    values = {"apparent_wind_mps": unit * speed, "apparent_wind_rad": turned}
    return Message("MWV", values=values)


def _mwd(sentence: Any) -> Message:
    """Return the true wind, by its direction from true north."""
    angle, speed = _number(sentence.dirT), _number(sentence.speedM)
    if speed is None and (knots := _number(sentence.speedN)) is not None:
        speed = KNOT * knots
    if angle is None or speed is None:
        return Message("MWD", void=True)
    if speed < 0.0 or not 0.0 <= angle <= 360.0:
        raise FeedError("no wind")
    return Message("MWD", values={"wind_mps": speed, "wind_from_rad": math.radians(angle % 360.0)})


def _zda(sentence: Any) -> Message:
    stamp = _stamp(sentence.time, sentence.payload[0])
    return Message("ZDA", stamp, void=stamp is None)


_READERS: dict[str, Callable[[Any], Message | str]] = {
    "GGA": _gga,
    "RMC": _rmc,
    "GNS": lambda sentence: _fix("GNS", sentence, {*sentence.posMode} <= {*NO_MODE}),
    "GLL": _gll,
    "VTG": _vtg,
    "HDT": lambda sentence: _heading("HDT", sentence.headingT),
    "THS": _ths,
    "VHW": lambda sentence: _heading("VHW", sentence.hdgT, sentence.hdgM),
    "HDG": _hdg,
    "HDM": lambda sentence: _heading("HDM", "", sentence.headingM),
    "ROT": _rot,
    "RPM": _rpm,
    "RSA": _rsa,
    "ASHR": _ashr,
    "XDR": _xdr,
    "MWV": _mwv,
    "MWD": _mwd,
    "ZDA": _zda,
}
