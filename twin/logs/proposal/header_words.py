"""What the names of a logger's columns mean: words, units and sides."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Sequence

__all__ = [
    "AT_THE_COMPASS",
    "NAMES",
    "OVER_GROUND",
    "is_rpm",
    "is_setpoint",
    "is_shaft",
    "is_side",
    "is_steering",
    "is_turn_rate",
    "means",
    "other_side",
    "sides_of",
    "unit_of",
    "words_of",
]

SIDES = {
    "left": r"left|port|ps|l|1|bb|lf|lh|backbord|babord|babor|links|gauche|sinistr[ao]|sx|"
    r"izq|izquierd[ao]|esquerd[ao]|bombordo|bakboord|venstre|vanster|bagbord|lew[aeoy]|bakburta",
    "right": r"right|starboard|stbd|sb|r|2|rt|rh|steuerbord|tribord|estribor|rechts|droite?|"
    r"destr[ao]|dx|der|derech[ao]|direit[ao]|boreste|estibordo|stuurboord|styrbord|hoyre|hoger|"
    r"hojre|praw[aeoy]|sterburta",
}
"""Words of the two sides; the last two letters or digits also end a word of a command."""

SHAFT = (
    r"n|rpm|rps|shaft|motor|thrust|thruster|throttle|thr|prop|propeller|esc|engine|revs|gas|gaz|"
    r"drossel|gashebel|drehzahl|moteur|motore|regime|poussee|acelerador|turtall|toerental|toeren|"
    r"giri|rotacao|rotacoes|revoluciones|varvtal|varv|omdrejninger|obroty|silnik|sruba|manetka|"
    r"propulsor|propulseur|helice|elica|schraube|schroef|propell|manette|accelerateur|"
    r"acceleratore|gass|schub"
)

STEER = (
    r"delta|rudder|steer|steering|str|angle|azimuth|drive|nozzle|helm|lenkung|ruder|ruderlage|"
    r"ruderwinkel|barre|safran|gouvernail|timone?|roer|roerhoek|stuur|ror|roder|(?:ror|roder)vinkel|"
    r"leme|tiller|turn|ster|steru"
)

SETPOINT = r"cmd|cmds|command|commands|commanded|setpoint|desired|target|demand|soll|consigne"
"""Words of what a boat is told to do, not of what it does; ..."""

AHEAD = r"speed|vel|velocity|linear|surge|forward"
ROUND = r"yaw|angular|rotation|rot|yawrate|turnrate"
"""... of its propulsion and its steering, where no other word says so."""

PULSE = r"pwm|servo"
"""Words that say how a command is sent, not what it moves: a shaft where no other word does."""

OVER_GROUND = r"fond|fondo|fundo|grund|grunn|grond|ground|dnem"
AT_THE_COMPASS = (
    r"heading|hdg|psi|yaw|compass|hdt|head|bearing|kompas\w*|steuerkurs|compas|bussola|brujula|"
    r"aguja|agulha|voorliggende?|prua|proa|styrekurs|styrd|rzeczywisty"
)
"""Words that make a course of a direction, and a heading."""

NAMES = {
    "time": r"t|time|timestamp|stamp|date|datetime|utc|epoch|clock|"
    r"datum|zeit|uhrzeit|zeitstempel|zeitpunkt|heure|horodatage|temps|fecha|hora|tiempo|tempo|tijd|"
    r"tijdstip|tid|tidspunkt|klokkeslett|data|dato|ora|orario|czas|godzina",
    "latitude": r"lat|latitude|breite|breitengrad|latitud|latitudine|bredd|bredde|breddgrad|"
    r"breddegrad|breedtegraad|breedte|szerokosc|szer",
    "longitude": r"lon|lng|long|longitude|laenge|lange|langengrad|longitud|longitudine|langd|"
    r"laengde|lengde|longitudgrad|lengdegrad|laengdegrad|lengtegraad|lengte|dlugosc|dl",
    "north": r"x|north|northing|utmn",
    "east": r"y|east|easting|utme",
    "speed": r"sog|speed|spd|velocity|groundspeed|fahrt|vitesse|velocidad|velocidade|velocita|"
    r"geschwindigkeit|fart|vaart|snelheid|hastighet|hastighed|predkosc",
    "course": r"cog|course|crs|gcrs|track|kurs|koers|grondkoers|route|capfond|rumbo|rumo|rotta|kdd",
    "heading": rf"{AT_THE_COMPASS}|cap",
    "magnetic": r"mag|magn|magnetic|magnetisch|magnetique|magnetico|magnetica|magnetnadel",
    "gyro": r"gyro|gyr|rot|yawrate|yawspeed|yawvel|headingrate|turnrate|psidot|r|gz|gyrz|"
    r"drehrate|gierrate|giersnelheid|draaisnelheid|lacet|giro|girhastighet|girrate|katowa|angolare",
    "accel_x": r"ax|accx|accelx",
    "accel_y": r"ay|accy|accely",
    "accel_z": r"az|accz|accelz",
    "gyro_x": r"p|gx|gyrx|gyrox|rollrate|rollspeed",
    "gyro_y": r"q|gy|gyry|gyroy|pitchrate|pitchspeed",
    "roll": r"roll|phi|heel|krangung|rollwinkel|gite|roulis|sbandamento|rollio|escora|balanceo|"
    r"krengning|krangning|slagside|helling|przechyl",
    "pitch": r"pitch|theta|trim|stampfwinkel|nickwinkel|tangage|beccheggio|cabeceo|caturro",
    "height": r"alt|altitude|height|msl|elevation",
    "climb": r"climb|climbrate|velup|vup|vu",
    "to_north": r"vn|veln|vnorth|velnorth|velocitynorth|vx|velx",
    "to_east": r"ve|vele|veast|veleast|velocityeast|vy|vely",
    "steering": r"steer|steering|str|helm|lenkung|turn|yaw|angular|rotation",
    "channel": r"rcou|rcout|servo|pwm|chan|channel|chan\d+|ch\d+|rc\d+",
    "wind_speed": r"tws|windspeed",
    "wind_from": r"twd|winddirection|winddir|windfrom",
    "apparent_speed": r"aws|apparentwindspeed|relativewindspeed",
    "apparent_from": r"awa|apparentwindangle|relativewindangle",
}
"""Words in the names of columns, by what they mean."""

_DEGREES = (
    r"deg|degree|degrees|°|gr|grad|grade|graden|grader|grados|gradi|graus|degres|stopni|stopnie"
)

UNIT_WORDS = {
    "deg": rf"degs|{_DEGREES}",
    "rad": r"rad|rads|radians",
    "kn": r"kn|kt|kts|knot|knots|knoten|knopen|knop|knob|nds?|noeuds?|nudos|nodi|nos|wezly",
    "kmph": r"kmh|kmph|kph",
    "mph": r"mph",
    "mps": r"mps|ms1",
    "mps2": r"mps2|ms2|mpss",
    "degps": rf"dps|degs|({_DEGREES})ps",
    "degpmin": rf"degmin|dpm|({_DEGREES})pmin",
    "radps": r"radps|rads",
    "rpm": r"rpm|([u1r]|tr|tours|omw|omdr|obr|giri|rev|rot|varv)pmin",
    "percent": r"%|pct|percent|prozent|procent|pourcent|porcento|porciento|percentuale",
    "rps": r"rps|hz",
    "ms": r"ms|msec|millis|milliseconds",
    "us": r"us|usec|micros",
    "ns": r"ns|nsec",
    "g": r"g",
    "ft": r"ft|feet",
    "ftps": r"ftps|fps",
}


_LETTERS = str.maketrans(
    {"ł": "l", "Ł": "L", "ø": "o", "Ø": "O", "æ": "ae", "Æ": "AE", "œ": "oe", "ß": "ss"}
)
"""Letters that Unicode does not take apart into a plain one and an accent."""


def words_of(name: str) -> list[str]:
    """Return the words of a column's name, in lower case and without accents."""
    plain = unicodedata.normalize("NFKD", name.translate(_LETTERS))
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", re.sub(r"[\u0300-\u036f]", "", plain))
    return [word for word in re.split(r"[^a-z0-9°%]+", split.lower()) if word]


def means(name: str, pattern: str) -> bool:
    """Return whether a name has a word of a pattern, or two that join to one."""
    words = words_of(name)
    # letters alone only if they are the name without its unit
    for word in words:
        if re.fullmatch(pattern, word) and (len(word) > 2 or word == words[0]):
            return True
    pairs = itertools.pairwise(words)
    return any(re.fullmatch(pattern, one + other) for one, other in pairs)


def unit_of(name: str, among: Sequence[str]) -> str:
    """Return the unit that a name ends with, if it is one of some."""
    per = name.replace("/s", "ps").replace("/h", "ph").replace("/min", "pmin")
    words = [*words_of(per), re.sub(r"[^a-z0-9°%]", "", per.lower())]
    for unit in among:
        if any(re.fullmatch(UNIT_WORDS[unit], word) for word in words[1:]):
            return unit
    return ""


def is_turn_rate(name: str) -> bool:
    """Return whether a name is that of a rate of turn, such as ``YawRate`` or ``yaw [deg/s]``."""
    turns = rf"{NAMES['heading']}|{NAMES['gyro']}|turn"
    rates = rf"rate|velocity|vel|dot|angvel|{NAMES['speed']}"
    words = words_of(name)
    if not any(re.fullmatch(rf"({turns})({rates})?", word) for word in words):
        return False
    if any(re.fullmatch(rf"({turns})?({rates})", word) for word in words):
        return True
    return bool(unit_of(name, ("degpmin", "degps", "radps")))


def is_rpm(name: str) -> bool:
    """Return whether a name is that of revolutions a minute."""
    return bool(unit_of(f"n {name}", ("rpm",)))


def is_setpoint(name: str) -> bool:
    """Return whether a name is that of something that the boat is told."""
    return any(re.fullmatch(SETPOINT, word) for word in words_of(name))


def _is_command(name: str, pattern: str) -> bool:
    """Return whether a name is that of a command: a word of a pattern, with or without a side."""
    side = rf"({'|'.join(SIDES.values())}|[ab]|\d)?"
    words = words_of(name)
    there = [word for word in words if len(word) > 1 or word == words[0]]
    return any(re.fullmatch(rf"({pattern}){side}", word) for word in there)


def is_steering(name: str) -> bool:
    """Return whether a name is that of a steering angle."""
    told = is_setpoint(name) and _is_command(name, ROUND)
    return told or (_is_command(name, STEER) and not is_turn_rate(name))


def is_shaft(name: str) -> bool:
    """Return whether a name is that of a shaft speed or throttle."""
    other = _is_command(name, PULSE) or (is_setpoint(name) and _is_command(name, AHEAD))
    return is_rpm(name) or _is_command(name, SHAFT) or (other and not is_steering(name))


def is_side(name: str) -> bool:
    """Return whether a name is the word of a side, and nothing else but a unit."""
    words = words_of(name)
    first = next(iter(words), "") if len(words) <= 2 else ""
    return len(first) > 3 and any(re.fullmatch(each, first) for each in SIDES.values())


def sides_of(names: Sequence[str]) -> tuple[str, str] | None:
    """Return the names of the left and the right of two like columns, if there are both."""
    found = {}
    for side, words in SIDES.items():
        whole = [name for name in names if any(re.fullmatch(words, w) for w in words_of(name))]
        ends = rf"({SHAFT}|{STEER}|{PULSE})({words})"
        ending = [name for name in names if any(re.fullmatch(ends, w) for w in words_of(name))]
        found[side] = next(iter(whole or ending), None)
    left, right = found["left"], found["right"]
    return None if left is None or right is None or left == right else (left, right)


_PAIRS = (("a", "b"), ("1", "2"), ("0", "1"), ("1", "3"))
"""Ends of the names of two sides, left first; ArduPilot steers by outputs 1 and 3."""


def other_side(name: str, among: Sequence[str]) -> tuple[str, str] | None:
    """Return the left and the right of two columns whose names differ by a letter or digit alone.

    Parameters
    ----------
    name : str
        One of them.
    among : sequence of str
        Where the other is looked for.
    """
    words = words_of(name)
    for ends in reversed(_PAIRS):
        for other in among:
            pair = _apart(words, words_of(other))
            if pair in (ends, ends[::-1]):
                return (name, other) if pair == ends else (other, name)
    return None


def _apart(words: Sequence[str], others: Sequence[str]) -> tuple[str, str] | None:
    """Return the ends by which two names differ, if they differ in the end of one word."""
    unlike = [pair for pair in zip(words, others, strict=False) if pair[0] != pair[1]]
    if len(words) != len(others) or len(unlike) != 1:
        return None
    one, two = unlike[0]
    return (one[-1], two[-1]) if one[:-1] == two[:-1] else None
