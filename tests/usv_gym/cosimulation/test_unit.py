"""Co-simulation units: the same run as ours, through a host."""

from __future__ import annotations

import json
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from usv_gym.cosimulation.unit import (
    INPUTS,
    OUTPUTS,
    CosimulationError,
    ShipAndSea,
    write_unit,
)
from usv_gym.physics import frames as fr
from usv_gym.vessel.vessel import Vessel
from usv_gym.vessel.vessel_file import vessel_path
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation

SEA = SeaState.named("2")
DT = 0.05


def commands(vessel: str, rows: int) -> np.ndarray:
    """Return commands (rows, 4) that change all the time."""
    boat = Vessel.load(vessel)
    n = boat.values["shaft_speed_manoeuvring"]
    t = DT * np.arange(rows)
    left, right = n * (0.8 + 0.3 * np.sin(0.2 * t)), n * (0.8 + 0.3 * np.cos(0.3 * t))
    delta = 0.0 * t if boat.kind == "thruster_pair" else 0.3 * np.sin(0.1 * t)
    return np.column_stack([left, right, delta, delta])


def own(vessel: str, given: np.ndarray, seed: int, dof: int = 3, sea: SeaState = SEA) -> np.ndarray:
    """Return the states (rows, 16) of our own simulation behind each command."""
    simulation = Simulation(1, vessel, sea, dof=dof, dt=DT)
    simulation.reset([0], [np.random.default_rng(seed).spawn(2)[0]])
    states = np.empty((len(given), fr.STATE_SIZE))
    for k, command in enumerate(given):
        simulation.step(command[None])
        states[k] = simulation.state[0]
    return states


def resources(folder: Path) -> Path:
    """Return a folder as a unit unpacks it."""
    fields = {"dof": 3, "dt": DT, "seed": 4, "sea": {"hs": 0.3, "wind": 4.0}}
    (folder / "settings.json").write_text(json.dumps(fields))
    (folder / "vessel.toml").write_bytes(vessel_path("otter").read_bytes())
    return folder


def test_steps_of_the_host_are_those_of_our_simulation(tmp_path):
    ship = ShipAndSea(resources(tmp_path))
    ship.start()
    given = commands("otter", 60)
    expected = own("otter", np.repeat(given[::3], 3, axis=0), 4, sea=SeaState(hs=0.3, wind=4.0))
    for k in range(0, 60, 3):  # the host's step is three of ours
        ship.values.update(zip(INPUTS, given[k].tolist(), strict=True))
        ship.advance(k * DT, 3 * DT)
        found = [ship.values[name] for name in OUTPUTS]
        assert found == expected[k + 2].tolist()


def test_a_step_that_is_no_multiple_is_refused(tmp_path):
    ship = ShipAndSea(resources(tmp_path))
    with pytest.raises(CosimulationError, match="before initialisation"):
        ship.advance(0.0, DT)
    ship.start()
    for step in (0.07, 0.0, -0.05):
        with pytest.raises(CosimulationError, match=r"whole multiple of 0\.05 s"):
            ship.advance(0.0, step)


def test_seed_and_sea_are_parameters(tmp_path):
    ship = ShipAndSea(resources(tmp_path))
    ship.values.update(seed=9, hs_m=0.6)
    ship.start()
    ship.advance(0.0, 5.0)
    given = np.tile([ship.values[name] for name in INPUTS], (100, 1))
    expected = own("otter", given, 9, sea=SeaState(hs=0.6, wind=4.0))
    assert [ship.values[name] for name in OUTPUTS] == expected[-1].tolist()


def test_without_pythonfmu_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(CosimulationError, match=r"pip install 'usv-twin\[fmu\]'"):
        write_unit("otter", tmp_path / "a.fmu", SEA)
    with pytest.raises(CosimulationError, match=r"ends in \.fmu"):
        write_unit("otter", tmp_path / "a.zip", SEA)


def test_command_writes_a_unit_with_its_files(tmp_path):
    pytest.importorskip("pythonfmu", reason="needs the extra fmu")
    path = tmp_path / "a.fmu"
    asked = ["fmu", "usv75", "--out", str(path), "--dof", "6", "--hs", "0.4", "--seed", "3"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    with zipfile.ZipFile(path) as unit:
        names = set(unit.namelist())
        settings = json.loads(unit.read("resources/settings.json"))
        description = unit.read("modelDescription.xml").decode()
    assert {"resources/vessel.toml", "resources/usv75.nc"} <= names
    assert settings["sea"]["hs"] == 0.4 and settings["seed"] == 3 and settings["dof"] == 6
    assert all(f'name="{name}"' in description for name in (*INPUTS, *OUTPUTS, "seed", "hs_m"))
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 2 and "--force" in again.output


@pytest.mark.slow
@pytest.mark.parametrize(("vessel", "dof"), [("otter", 3), ("usv75", 3), ("usv75", 6)])
def test_a_host_gets_the_run_of_our_simulation(vessel, dof, tmp_path):
    """100 s through FMPy, with commands that change at each step."""
    pytest.importorskip("pythonfmu", reason="needs the extra fmu")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the host's own dependencies
        fmpy = pytest.importorskip("fmpy", reason="needs the extra fmu")
        from fmpy.fmi2 import FMU2Slave

    path = tmp_path / "a.fmu"
    write_unit(vessel, path, SEA, seed=1, dof=dof)
    described = fmpy.read_model_description(path)
    numbers = {v.name: v.valueReference for v in described.modelVariables}
    unit = FMU2Slave(
        guid=described.guid,
        unzipDirectory=fmpy.extract(path, unzipdir=tmp_path / "unit"),
        modelIdentifier=described.coSimulation.modelIdentifier,
        instanceName="ship",
    )
    given = commands(vessel, 2000)
    states = np.empty((len(given), len(OUTPUTS)))
    unit.instantiate()
    try:
        unit.setupExperiment(startTime=0.0)
        unit.enterInitializationMode()
        unit.setInteger([numbers["seed"]], [5])
        unit.exitInitializationMode()
        inputs = [numbers[name] for name in INPUTS]
        outputs = [numbers[name] for name in OUTPUTS]
        for k, command in enumerate(given):
            unit.setReal(inputs, command.tolist())
            unit.doStep(currentCommunicationPoint=k * DT, communicationStepSize=DT)
            states[k] = unit.getReal(outputs)
        unit.terminate()
    finally:
        unit.freeInstance()
    expected = own(vessel, given, 5, dof)
    assert np.ptp(expected[:, :2], axis=0).min() > 5.0
    assert np.abs(states - expected).max() < 1e-9
