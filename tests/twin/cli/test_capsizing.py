"""Every command that sails a vessel says before that it will capsize, in the same words."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from twin.benchmark.protocol import Case, Settings, left_out
from twin.cli import sitl, view
from twin.cli.main import app
from twin.live.sessions.simulated import SimulatedSession, SimulationSetup
from usv_gym.design.seaway import warning_of
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.errors import UsvTwinError

TENDER = Vessel.load("kvlcc2_l7")
SAID = warning_of(TENDER, SeaState.named("4"), 6)
COMMANDS = {
    "simulate": ["simulate", "straight", "--duration", "1"],
    "view": ["view", "-p", "persistence"],
    "sitl": ["sitl", "kvlcc2_l7"],
}


def said(name: str, dof: int, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what a command says before it sails."""

    def stop(*_: object, **__: object) -> None:
        raise UsvTwinError("enough")

    monkeypatch.setattr(view, "show_session", stop)
    monkeypatch.setattr(sitl, "Simulation", stop)
    asked = [*COMMANDS[name], "--sea", "4"]
    asked += ["--vessel", "kvlcc2_l7"] if name in ("simulate", "view") else []
    asked += [] if name == "sitl" else ["--dof", str(dof)]
    return " ".join(CliRunner().invoke(app, asked).output.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_that_a_vessel_will_capsize(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "view":
        pytest.importorskip("viser", reason="needs viser: pip install 'usv-twin[view]'")
    if name == "sitl":
        pytest.importorskip("pymavlink", reason="needs pymavlink: pip install 'usv-twin[view]'")
    assert SAID is not None
    assert f"note: {SAID}" in said(name, 6, monkeypatch)
    if name != "sitl":  # it always has six degrees of freedom
        assert "capsizes" not in said(name, 3, monkeypatch)


def test_a_benchmark_says_once_for_each_sea_that_its_vessel_will_capsize() -> None:
    cases = (Case("calmer", sea="1"), Case("rough", sea="4"), Case("gps", "gps10", sea="4"))
    settings = {"predictors": ("persistence",), "vessel": "kvlcc2_l7", "cases": cases}
    found = left_out(Settings(**settings, dof=6))  # type: ignore[arg-type]
    assert [line for line in found if "capsizes" in line] == [SAID]
    assert not any("capsizes" in line for line in left_out(Settings(**settings)))  # type: ignore[arg-type]
    recorded = Settings(**settings, dof=6, scenarios=())  # type: ignore[arg-type]
    assert not any("capsizes" in line for line in left_out(recorded))


def test_a_view_says_it_of_the_vessel_and_sea_that_are_chosen(tmp_path: Path) -> None:
    calm = SimulationSetup(vessel=TENDER, sea=SeaState.named("0"), predictor="persistence")
    session = SimulatedSession(calm, tmp_path)
    assert session._look().notes == ()
    session.change_sea(SeaState.named("4"))
    assert session._look().notes == (SAID,)
    session.change_sea(SeaState.named("0"))
    assert session._look().notes == ()
