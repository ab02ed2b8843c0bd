"""What a benchmark measures: scenarios, cases, boats and predictors.

The cases of the full protocol (:data:`FULL_CASES`) change one thing at a time.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from twin.digital_twin import PLANS
from twin.particulars import ParticularsError
from twin.predictors.registry import EXTRAS, PREDICTORS, PredictorError, base_name, predictor_class
from twin.sim.oracle import check_simulator
from twin.sim.recorded import log_name, read_run
from usv_gym.design.seaway import warning_of
from usv_gym.manoeuvring.manoeuvres import SCENARIOS, ManoeuvreError
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import ineffective_fault, parse_faults
from usv_gym.world.schedule import changing_sea, parse_values
from usv_gym.world.sea import SEA_STATES, SeaKeyframe, SeaState
from usv_gym.world.sensors import SensorSuite
from usv_kernel.errors import UsvTwinError

__all__ = [
    "FULL",
    "FULL_CASES",
    "HORIZONS",
    "SPREAD",
    "BenchmarkError",
    "Case",
    "Settings",
    "Unit",
    "available",
    "left_out",
    "sea_settings",
    "units",
]

HORIZONS = (1.0, 2.0, 5.0, 10.0)

SPREAD = 0.15
"""Relative variation of the boats."""

_BOATS = 1029
"""Second seed of a boat, so that it does not share the random numbers of its sea."""

TYPICAL = "typical"

ROLLING_COMPONENTS = 1000
"""Components of the waves with six degrees of freedom."""


class BenchmarkError(UsvTwinError):
    """A benchmark that cannot run; the message says why."""


@dataclass(frozen=True)
class Case:
    """Conditions of a simulated run."""

    name: str  # in results and file names
    fault: str = "none"  # losses of sensors such as gps10
    sea: str = ""  # one of usv_gym.world.sea.SEA_STATES; empty: that of the settings
    grade: str = TYPICAL  # one of usv_gym.world.sensors.GRADES
    drawn: bool = False  # whether the report shows single runs

    def __post_init__(self) -> None:
        parse_faults(self.fault, 0.0)
        SeaState.named(self.sea or "calm")
        SensorSuite.grade(self.grade)


FULL_CASES = {
    case.name: case
    for case in (
        Case("base", drawn=True),
        Case("gps5", "gps5"),
        Case("gps10", "gps10", drawn=True),
        Case("gps20", "gps20"),
        Case("gps30", "gps30"),
        Case("imu30", "imu30"),
        Case("both30", "gps30+imu30"),
        # 30 % of the time, 5 s each, from the first second on
        Case("bursts", "gps-bursts30x5"),
        *(Case(f"sea{sea}", sea=sea) for sea in ("0", "1", "3", "4")),  # 2 is the base's
        # seas that change while forecasts are made
        *(Case(sea, sea=sea) for sea in ("squall", "building")),
        *(Case(grade, grade=grade) for grade in ("consumer", "best")),
    )
}
"""Cases of the full protocol by name."""

FULL = {
    "scenarios": ("turn", "zigzag", "turn-zigzag", "random"),
    "seeds": tuple(range(200, 224)),
    "plans": ("known",),
}
"""The other settings of the full protocol."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is to be measured."""

    scenarios: tuple[str, ...] = ("turn", "zigzag")  # manoeuvres
    faults: tuple[str, ...] = ("none", "gps10")  # losses of sensors
    cases: tuple[Case, ...] = ()  # conditions in place of faults
    # each gives a boat, a sea, sensor errors, and the commands of a random manoeuvre
    seeds: tuple[int, ...] = tuple(range(6))
    predictors: tuple[str, ...] = tuple(PREDICTORS)  # names in twin.PREDICTORS or module:Class
    # future commands: known (Eq 27), or hold for the last ones
    plans: tuple[str, ...] = ("known", "hold")
    vessel: str = "usv75"  # name or TOML file
    spread: float = SPREAD  # relative variation of the boat from seed to seed, see Vessel.varied
    dof: int = 3  # degrees of freedom of the simulated ship, 3 or 6
    # sea state: wave height (m), wind speed (m/s) and direction (degrees)
    hs: float = 0.5
    wind: float = 4.5
    wind_from_deg: float = 135.0
    # keyframes (time, hs, wind, wind_from in rad) of a sea that changes, in place of all three
    schedule: tuple[tuple[float, ...], ...] = ()
    spreading: float | None = None  # exponent of short-crested waves; None: long-crested
    logs: tuple[str, ...] = ()  # recorded runs to score
    # particulars of the recorded boat; None for the TOML file beside the log
    ship: str | None = None
    mapping: str | None = None  # mapping file of the recorded runs, as for Log.read
    # time of the first prediction, s; in recorded runs 60 s, or 40 % of a short one
    identify_s: float = 80.0
    duration_s: float = 120.0  # length of a simulated run, s
    fault_after_s: float = 5.0  # time from the first prediction to a loss, s

    def __post_init__(self) -> None:
        for name in self.scenarios:
            if name not in SCENARIOS:
                raise ManoeuvreError(
                    f"no scenario is called {name!r}; known: {', '.join(SCENARIOS)}"
                )
        for name in self.predictors:
            predictor_class(name)
        for name in self.plans:
            if name not in PLANS:
                raise PredictorError(f"no plan is called {name!r}; known: {', '.join(PLANS)}")
        names = [log_name(path) for path in self.logs]
        for name in names:
            if names.count(name) > 1 or name in self.scenarios:
                raise BenchmarkError(f"two runs are called {name!r}; rename a log file")
        if len({case.name for case in self.conditions}) < len(self.conditions):
            raise BenchmarkError("two cases have the same name; rename one")
        if not (self.identify_s > 0 and self.duration_s > self.identify_s + HORIZONS[-1]):
            raise BenchmarkError(
                f"duration_s = {self.duration_s} must exceed identify_s = {self.identify_s} "
                f"by more than the horizon of {HORIZONS[-1]:g} s"
            )
        if self.dof not in (3, 6):
            raise BenchmarkError(f"dof = {self.dof}: must be 3 or 6")
        if not 0.0 <= self.spread <= 0.5:
            raise BenchmarkError(f"spread = {self.spread}: must lie between 0 and 0.5")
        self.sea()
        if self.ship is not None and Path(self.ship).suffix != ".toml":
            Vessel.load(self.ship)
        elif self.ship is not None and not Path(self.ship).is_file():
            raise ParticularsError(f"{self.ship}: no such file; name one with particulars")

    @property
    def conditions(self) -> tuple[Case, ...]:
        """The cases to be simulated."""
        return self.cases or tuple(Case(fault, fault, drawn=True) for fault in self.faults)

    @property
    def sea_name(self) -> str:
        """Name of the settings' own sea state."""
        if self.schedule:
            return "changing"
        for name, sea in SEA_STATES.items():
            if (sea.hs, sea.wind) == (self.hs, self.wind) and name.isdigit():
                return name
        return f"hs{self.hs:g}-wind{self.wind:g}"

    def sea(self, name: str = "") -> SeaState:
        """Return a sea state by name with the settings' direction, or the settings' own."""
        own = SeaState(hs=self.hs, wind=self.wind)
        if self.schedule:
            own = SeaState(schedule=tuple(SeaKeyframe(*one) for one in self.schedule))
        sea = SEA_STATES.get(name, own)
        # a boat that rolls can learn a hundred lines of a spectrum, as no real sea has them
        components = ROLLING_COMPONENTS if self.dof == 6 else sea.components
        if not self.schedule or name in SEA_STATES:
            sea = sea.turned(math.radians(self.wind_from_deg))
        return sea.replace(spreading=self.spreading, components=components)

    def boat(self, seed: int) -> Vessel:
        """Return the boat of a seed."""
        vessel = Vessel.load(self.vessel)
        if self.spread == 0.0:
            return vessel
        return vessel.varied(np.random.default_rng([seed, _BOATS]), self.spread)


@dataclass(frozen=True, order=True)
class Unit:
    """One predictor on one run; ``log`` is the file of a recorded run, else empty.

    ``case`` is the name of the :class:`Case` that ``fault``, ``sea`` and ``grade`` make; the
    last two are empty for a recorded run.
    """

    scenario: str
    fault: str
    seed: int
    predictor: str
    log: str = ""
    case: str = ""
    sea: str = ""
    grade: str = ""

    def __post_init__(self) -> None:
        if not self.case:
            object.__setattr__(self, "case", self.fault)

    @property
    def run(self) -> str:
        """Name of the run, for files."""
        return f"{self.scenario}_{self.case}_{self.seed}"


UNIT_KEY = ("scenario", "case", "fault", "sea", "grade", "seed", "predictor")
"""Fields of a :class:`Unit` that identify its rows, in the order of the results."""


def sea_settings(hs: str | None, wind: str | None, wind_from_deg: str | None) -> dict[str, Any]:
    """Return the settings of a sea that options describe, see ``usv_gym.world.schedule``."""
    given = {"hs": hs, "wind": wind, "wind_from_deg": wind_from_deg}
    parsed = {
        name: parse_values(v, name.removesuffix("_deg"))
        for name, v in given.items()
        if v is not None
    }
    first = {name: values[0][1] for name, values in parsed.items()}
    if all(len(values) == 1 for values in parsed.values()):
        return first
    state = changing_sea(SeaState(), hs, wind, wind_from_deg)
    return first | {"schedule": tuple(tuple(one) for one in state.schedule)}


def available(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the predictors that can run here, and a line on each that cannot."""
    usable, notes = [], []
    for name in names:
        module, extra = EXTRAS.get(base_name(name), (None, ""))
        if module is None or find_spec(module) is not None:
            usable.append(name)
        else:
            notes.append(
                f"{name} is left out: {module} is not installed; "
                f"python -m pip install {module} (the extra [{extra}] of usv-twin)"
            )
    return tuple(usable), tuple(notes)


def units(settings: Settings) -> list[Unit]:
    """Return all work that the settings ask for, in a fixed order: run by run."""
    own = settings.sea_name
    work = [
        Unit(scenario, case.fault, seed, predictor, "", case.name, case.sea or own, case.grade)
        for scenario in settings.scenarios
        for case in settings.conditions
        for seed in settings.seeds
        for predictor in settings.predictors
    ]
    # a recorded run has its own sea and sensors
    faults = dict.fromkeys(
        case.fault for case in settings.conditions if (case.sea, case.grade) == ("", TYPICAL)
    )
    return work + [
        Unit(log_name(path), fault, 0, predictor, path)
        for path in settings.logs
        for fault in faults
        for predictor in settings.predictors
        if _is_runnable(predictor, path, settings.ship, settings.mapping)
    ]


@functools.cache
def _is_runnable(predictor: str, path: str, ship: str | None, mapping: str | None) -> bool:
    """Return whether a predictor has all the information that it needs on a log."""
    if not predictor_class(predictor).needs_simulator:
        return True
    try:
        check_simulator(predictor, *read_run(path, ship, mapping))
    except Exception:  # a file that cannot be read is reported when it is scored
        return False
    return True


def left_out(settings: Settings) -> tuple[str, ...]:
    """Return a line on each predictor that lacks information on recorded runs, and on no effect.

    And one on each sea in which the vessel capsizes.
    """
    lines = []
    if settings.scenarios:
        for name in dict.fromkeys(case.sea for case in settings.conditions):
            found = warning_of(Vessel.load(settings.vessel), settings.sea(name), settings.dof)
            lines += [] if found is None else [found]
    for case in settings.conditions if settings.scenarios else ():
        struck, suite = parse_faults(case.fault, 0.0), SensorSuite.grade(case.grade)
        if (found := ineffective_fault(struck, settings.dof, suite.has_anemometer)) is not None:
            lines.append(f"{case.name}: {found}")
    for predictor in settings.predictors:
        runs = [
            log_name(path)
            for path in settings.logs
            if not _is_runnable(predictor, path, settings.ship, settings.mapping)
        ]
        if runs:
            lines.append(
                f"{predictor} is left out of {', '.join(runs)}: the true boat is not known"
            )
    return tuple(lines)
