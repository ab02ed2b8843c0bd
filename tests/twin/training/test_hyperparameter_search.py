"""The search for the nets' settings: halved as it should be, stopped and gone on."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin.predictors.learned.pretrained import Weights
from twin.training import fleet
from twin.training import hyperparameter_search as fleet_search
from twin.training.fleet import FleetSettings, Run

pytest.importorskip("torch")

FIRST = 32
TRIED = [
    FleetSettings(boats=2, runs=1, width=8, batch=16, rate=rate, dropout=dropout, gate=0.5)
    for rate, dropout in ((1e-2, 0.0), (1e-3, 0.0), (3e-2, 0.1), (1e-4, 0.0))
]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Run], list[Any], Path]:
    """Return the runs of a fleet of two, the windows for scoring, and the folder."""
    folder = tmp_path_factory.mktemp("fleet")
    runs = fleet.sail_fleet(TRIED[0], folder)
    others = fleet.sail_fleet(dataclasses.replace(TRIED[0], seed=fleet_search.OTHERS), folder)
    assert not {run.particulars for run in runs} & {run.particulars for run in others}
    return runs, fleet_search.windows(others, 128, 0), folder


def found(folder: Path, name: str = "search.jsonl") -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / name).read_text().splitlines()]


@pytest.mark.parametrize("kind", ["lstm", "transformer"])
def test_configurations_are_drawn_from_the_seed(kind: str) -> None:
    """The first is where it begins; the others hang on seed and number alone."""
    drawn = [fleet_search.draw(kind, i, 0) for i in range(40)]
    assert drawn[0] == fleet_search.BEGIN[kind]
    assert drawn == [fleet_search.draw(kind, i, 0) for i in range(40)]
    assert len(set(drawn)) == 40
    assert not set(drawn[1:]) & {fleet_search.draw(kind, i, 1) for i in range(40)}
    # the boats for scoring are others
    assert {settings.seed for settings in drawn} == {0} != {fleet_search.OTHERS}
    assert all(settings.width % fleet.HEADS == 0 for settings in drawn)


def test_shipped_settings_won_the_recorded_search() -> None:
    """Every configuration of the search is there, and the best of the last rung is what ships."""
    lines = found(Path(__file__).parents[3] / "examples" / "confirmation", "fleet_search.jsonl")
    for kind, rungs in (("lstm", 5), ("transformer", 3)):
        ours = [line for line in lines if line["settings"]["kind"] == kind]
        counts = [sum(line["windows"] == 8192 * 2**k for line in ours) for k in range(rungs)]
        assert counts == [40, 20, 10, 5, 2][:rungs] and sum(counts) == len(ours)
        first = {FleetSettings(**{**line["settings"], "steps": 1}) for line in ours[:40]}
        drawn = {fleet_search.draw(kind, i, 0) for i in range(40)}
        assert first == {dataclasses.replace(settings, steps=1) for settings in drawn}
        last = [line for line in ours if line["windows"] == 8192 * 2 ** (rungs - 1)]
        best = FleetSettings(**min(last, key=lambda line: line["loss"])["settings"])
        assert dataclasses.replace(best, steps=fleet.SHIPPED[kind].steps) == fleet.SHIPPED[kind]
        shipped = Weights.read(fleet.NETS[kind].file, kind).settings
        shipped.pop("sailed")
        assert FleetSettings(**shipped) == fleet.SHIPPED[kind]


def test_the_better_half_is_trained_longer(
    simulated: tuple[list[Run], list[Any], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """4, 2, 1 trainings, twice as long each time; Ctrl-C and going on change nothing."""
    runs, validation, _ = simulated
    best = fleet_search.search(TRIED, runs, validation, tmp_path / "a", first=FIRST, rungs=3)
    lines = found(tmp_path / "a")
    assert [line["settings"]["steps"] for line in lines] == [2] * 4 + [4] * 2 + [8]
    assert [line["windows"] for line in lines] == [32] * 4 + [64] * 2 + [128]
    better = sorted(lines[:4], key=lambda line: line["loss"])[:2]
    assert [line["settings"]["rate"] for line in lines[4:6]] == [
        line["settings"]["rate"] for line in better
    ]
    assert best == lines[6:]
    true, trained = fleet_search.train, []

    def stops(settings: FleetSettings, *rest: Any, **options: Any) -> Weights:
        trained.append(settings)
        if len(trained) == 4:
            raise KeyboardInterrupt
        return true(settings, *rest, **options)

    monkeypatch.setattr(fleet_search, "train", stops)
    with pytest.raises(KeyboardInterrupt):
        fleet_search.search(TRIED, runs, validation, tmp_path / "b", first=FIRST, rungs=3)
    assert found(tmp_path / "b") == lines[:3]
    again = fleet_search.search(TRIED, runs, validation, tmp_path / "b", first=FIRST, rungs=3)
    assert again == best and found(tmp_path / "b") == lines
    assert len(trained) == 4 + 4


def test_untrained_net_holds_velocities(
    simulated: tuple[list[Run], list[Any], Path], tmp_path: Path
) -> None:
    """Its answer is to hold the velocities, and it is scored for that."""
    runs, validation, _ = simulated
    weights = fleet.train(dataclasses.replace(TRIED[0], steps=1), runs, tmp_path)
    weights.arrays["read.weight"][:] = 0.0
    weights.arrays["read.bias"][:] = 0.0
    errors = fleet_search.losses(weights, validation)
    _, start, _, truth = validation[0]
    held = np.abs(truth[..., 3:] - start[:, None]).mean(axis=1) / fleet.TYPICAL[3:]
    assert errors.shape == (len(start), 6)
    np.testing.assert_allclose(errors[:, 3:], held, rtol=1e-4)
    assert (errors[:, :3] > 0.0).all()


def test_command_trains_or_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """It searches and prints the best; stopped, it says how to go on."""
    run = ["lstm", "--work", str(tmp_path), "--boats", "1", "--others", "1"]
    run += ["--trials", "1", "--rungs", "1", "--first", "128"]

    def stops(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(fleet_search, "sail_fleet", stops)
        with pytest.raises(SystemExit, match=f"stopped; .* goes on from {tmp_path}"):
            fleet_search.app(run, standalone_mode=False)
    fleet_search.app(run, standalone_mode=False)
    assert f"{found(tmp_path)[0]['loss']:.4f}  {{'kind': 'lstm'" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="no net is called 'gru'; known: lstm, transformer"):
        fleet_search.app(["gru"], standalone_mode=False)
