"""Ship and sea as a co-simulation unit of the Functional Mock-up Interface (FMI 2.0).

The unit runs in the Python of its host, in which usv-twin must be installed.
Source: Modelica Association 2022, Functional Mock-up Interface for Model Exchange and
Co-Simulation, version 2.0.4.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import math
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.vessel.vessel_file import read_vessel, vessel_path
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import read_json, read_toml, write_whole

__all__ = [
    "INPUTS",
    "OUTPUTS",
    "SEA",
    "CosimulationError",
    "ShipAndSea",
    "write_unit",
]

INPUTS = ("n_left_rps", "n_right_rps", "delta_left_rad", "delta_right_rad")
"""Commands: shaft speeds, rev/s, and drive angles, rad (above 0: to starboard)."""

OUTPUTS = (
    *("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "psi_rad"),
    *("u_mps", "v_mps", "w_mps", "p_radps", "q_radps", "r_radps"),
    *("shaft_left_rps", "shaft_right_rps", "drive_left_rad", "drive_right_rad"),
)
"""The ship's state: place north, east and down, roll, pitch, heading; velocities of the body
forward, to starboard and down, and its rates; shafts and drives."""


class SeaParameter(NamedTuple):
    """A field of :class:`~usv_gym.world.sea.SeaState`, and what it is."""

    field: str
    text: str


SEA = {
    "hs_m": SeaParameter("hs", "significant wave height, m"),
    "wind_mps": SeaParameter("wind", "mean wind speed at 10 m, m/s"),
    "wind_from_rad": SeaParameter("wind_from", "direction the wind comes from, rad"),
    "current_mps": SeaParameter("current", "speed of the current, m/s"),
    "current_to_rad": SeaParameter("current_to", "direction the current goes to, rad"),
}
"""Parameters of the sea by name."""

VESSEL_FILE, SETTINGS_FILE, MODULE = "vessel.toml", "settings.json", "usv_ship_and_sea"

SCRIPT = '''"""A vessel in its sea, for pythonfmu."""

from pythonfmu import Fmi2Causality as Causality
from pythonfmu import Fmi2Slave, Fmi2Variability, Integer, Real

from usv_gym.cosimulation.unit import INPUTS, OUTPUTS, SEA, ShipAndSea


class UsvShipAndSea(Fmi2Slave):
    """The unit that a host steps."""

    author = "usv-twin"
    description = "A vessel in its sea"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.ship = ShipAndSea(self.resources)
        fixed = {"causality": Causality.parameter, "variability": Fmi2Variability.fixed}
        for names, kind in ((INPUTS, Causality.input), (OUTPUTS, Causality.output)):
            for name in names:
                self.register_variable(self._real(name, causality=kind))
        for name, item in SEA.items():
            self.register_variable(self._real(name, description=item.text, **fixed))
        values = self.ship.values
        self.register_variable(
            Integer(
                "seed",
                getter=lambda: int(values["seed"]),
                setter=lambda value: values.__setitem__("seed", int(value)),
                description="of sea and wind",
                **fixed,
            )
        )

    def _real(self, name, **options):
        values = self.ship.values
        return Real(
            name,
            getter=lambda: values[name],
            setter=lambda value: values.__setitem__(name, float(value)),
            **options,
        )

    def exit_initialization_mode(self):
        self.ship.start()

    def do_step(self, current_time, step_size):
        self.ship.advance(current_time, step_size)
        return True
'''
"""What pythonfmu packs."""


class CosimulationError(UsvTwinError):
    """A unit that cannot be made or stepped; the message names the value and the remedy."""


class ShipAndSea:
    """A vessel in its sea, advanced by a host.

    Parameters
    ----------
    resources : str or Path
        Folder with the vessel's file and the settings, as :func:`write_unit` packs them.

    Attributes
    ----------
    values : dict of str to float
        Inputs, outputs and parameters by name; the host sets and reads them.
    """

    def __init__(self, resources: str | Path) -> None:
        folder = Path(resources)
        settings: Any = read_json(folder / SETTINGS_FILE, CosimulationError)
        self._vessel = Vessel.load(folder / VESSEL_FILE)
        self._dt, self._dof = float(settings["dt"]), int(settings["dof"])
        self._sea = SeaState(**settings["sea"])
        self._simulation: Simulation | None = None
        start = self._vessel.values["shaft_speed_manoeuvring"]
        self.values = dict.fromkeys((*INPUTS, *OUTPUTS), 0.0)
        self.values |= {"n_left_rps": start, "n_right_rps": start, "seed": settings["seed"]}
        self.values |= {name: float(getattr(self._sea, item.field)) for name, item in SEA.items()}
        # what a run begins with
        self.values["u_mps"] = self._vessel.straight_speed(start)
        self.values["shaft_left_rps"] = self.values["shaft_right_rps"] = start

    def start(self) -> None:
        """Put the vessel to the start of a run, straight ahead at its manoeuvring speed.

        The sea is that of ``usv-twin simulate`` with the same seed.
        """
        changed = {item.field: self.values[name] for name, item in SEA.items()}
        sea = self._sea.replace(**changed)
        simulation = Simulation(1, self._vessel, sea, dof=self._dof, dt=self._dt)
        sea_rng = np.random.default_rng(int(self.values["seed"])).spawn(2)[0]
        simulation.reset([0], [sea_rng])
        self._simulation = simulation
        self._show()

    def advance(self, t: float, step: float) -> None:
        """Advance from a time t by a step, s, with the inputs held.

        Raises
        ------
        CosimulationError
            For a step that is no whole multiple of the vessel's own.
        """
        if self._simulation is None:
            raise CosimulationError("do_step before initialisation: exit initialisation mode first")
        count = round(step / self._dt)
        if count < 1 or not math.isclose(count * self._dt, step, rel_tol=1e-6):
            raise CosimulationError(
                f"step {step!r} s at t = {t:g} s: must be a whole multiple of {self._dt:g} s"
            )
        command = np.array([[self.values[name] for name in INPUTS]])
        for _ in range(count):
            self._simulation.step(command)
        self._show()

    def _show(self) -> None:
        assert self._simulation is not None
        state = self._simulation.state[0, : fr.STATE_SIZE].tolist()
        self.values.update(zip(OUTPUTS, state, strict=True))


def write_unit(
    vessel: str | Path,
    path: str | Path,
    sea: SeaState,
    *,
    seed: int = 0,
    dof: int = 3,
    dt: float = 0.05,
) -> None:
    """Write a vessel in its sea as a co-simulation unit (FMI 2.0).

    Parameters
    ----------
    vessel : str or Path
        Name of a vessel, or its TOML file.
    path : str or Path
        File to create or replace, ``.fmu``.
    sea : SeaState
        The sea; height, wind and current are parameters of the unit.
    seed : int
        Of sea and wind; a parameter, too.
    dof : int
        Degrees of freedom, 3 or 6.
    dt : float
        Step, s; the host's steps are whole multiples of it.

    Raises
    ------
    CosimulationError
        Without pythonfmu, or for a file of another ending.
    """
    if Path(path).suffix != ".fmu":
        raise CosimulationError(f"{path}: a co-simulation unit ends in .fmu; name it so")
    try:
        from pythonfmu import FmuBuilder
    except ImportError:
        raise CosimulationError(
            f"{path}: writing a unit needs the package pythonfmu: pip install 'usv-twin[fmu]'"
        ) from None
    if sea.schedule or not isinstance(sea.spectrum, str) or Path(sea.spectrum).suffix:
        raise CosimulationError("sea: a unit holds no schedule and no recorded spectrum; name one")
    Simulation(1, vessel, sea, dof=dof, dt=dt)  # refuses what would fail in the host
    settings = {"dof": dof, "dt": dt, "seed": seed, "sea": dataclasses.asdict(sea)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        script = folder / f"{MODULE}.py"
        script.write_text(SCRIPT, encoding="utf-8")
        (folder / SETTINGS_FILE).write_text(json.dumps(settings), encoding="utf-8")
        files = [folder / SETTINGS_FILE, *_vessel_files(vessel, folder)]
        known = list(sys.path)
        logging.getLogger("pythonfmu").setLevel(logging.WARNING)
        try:
            made = FmuBuilder.build_FMU(
                script,
                folder / "unit.fmu",
                project_files=files,
                canHandleVariableCommunicationStepSize="true",
                canBeInstantiatedOnlyOncePerProcess="false",
            )
        finally:
            sys.path[:] = known
            sys.modules.pop(MODULE, None)
        write_whole(path, Path(made).read_bytes())


def _vessel_files(vessel: str | Path, folder: Path) -> list[Path]:
    """Return copies of a vessel's file, and of the mesh and table that it names."""
    source, found = vessel_path(vessel), read_vessel(vessel)
    copy = folder / VESSEL_FILE
    copy.write_bytes(source.read_bytes())
    files = [copy]
    table = read_toml(source, CosimulationError).get("vessel", {})
    for key in ("mesh", "hydro"):
        if key in table:
            if Path(table[key]).name != table[key]:
                raise CosimulationError(
                    f"{source}: {key} = {table[key]!r}: a unit holds files beside the vessel's "
                    "only; put it there"
                )
            files.append(Path(found[key]))
    return files
