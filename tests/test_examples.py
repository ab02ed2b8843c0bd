"""Examples and README run as they stand, and their tables are those of checked-in results."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twin import PREDICTORS

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
STUDY_PAGE = (ROOT / "docs/explanation/study.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
# run by test_ray.py and test_single_file_ppo.py in tests/twin/agents, and by
# tests/twin/live/external/test_mission_example.py, the last by tests/twin/live/protocols
OPTIONAL = {"05_rllib.py", "07_ardurover_mission.py", "08_single_file_ppo.py", "replay.py"}
OPTIONAL |= {"09_minari_dataset.py"}  # run below
EXAMPLES = [p for p in sorted((ROOT / "examples").glob("*.py")) if p.name not in OPTIONAL]


def run(code: list[str], cwd: Path) -> str:
    result = subprocess.run(
        [sys.executable, *code], capture_output=True, text=True, cwd=cwd, timeout=300
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_example_runs(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    monkeypatch.setitem(PREDICTORS, "fading-turn", None)  # which one of them adds
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out.strip()


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_readme_block_runs(number, tmp_path):
    run(["-c", BLOCKS[number]], tmp_path)


def test_readme_is_two_screens_of_existing_links():
    assert len(BLOCKS) >= 2
    assert len(README.splitlines()) <= 200
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert not [target for target in targets if not (ROOT / target).exists()]


def test_readme_results_equal_the_benchmark():
    results = json.loads((ROOT / "examples/benchmark/results.json").read_text())
    value = {
        (i["scenario"], i["fault"], i["predictor"]): i
        for i in results["summary"]
        if i["metric"] == "mae" and i["plan"] == "known"
    }
    rows = re.findall(r"^\| (\S+) \| (.+) \|$", README, flags=re.MULTILINE)
    table = {
        name: cells.split(" | ")
        for name, cells in rows
        if name in results["settings"]["predictors"]
    }
    assert set(table) == set(results["settings"]["predictors"])
    runs = [("turn", "none"), ("turn", "gps10"), ("zigzag", "none"), ("zigzag", "gps10")]
    for name, cells in table.items():
        for cell, (scenario, fault) in zip(cells, runs, strict=False):
            item = value[scenario, fault, name]
            assert cell == f"{item['value']:.2f} [{item['low']:.2f}, {item['high']:.2f}]"
        for cell, fault in zip(cells[4:6], ("none", "gps10"), strict=True):
            item = value.get(("boat1_usv_circle", fault, name))
            assert cell == (f"{item['value']:.3f}" if item else "-")


@pytest.mark.parametrize(
    ("script", "function", "rows"),
    [("confirmation", "lines", 25), ("benchmark", "full", 14), ("benchmark", "recorded", 6)],
)
def test_study_tables_equal_the_results(script, function, rows):
    lines = runpy.run_path(str(ROOT / "examples" / script / "tables.py"))[function]()
    assert len(lines) >= rows
    assert not set(lines) - set(STUDY_PAGE.splitlines())


def test_speed_is_measured():
    script = runpy.run_path(str(ROOT / "examples/speed/measure.py"))
    some = ("Pendulum", "env with ukf", "10 s forecast of ukf")
    seconds = script["measure"]({name: script["CASES"][name] for name in some}, rounds=1)
    assert all(times[0] > 0.0 for times in seconds.values())
    assert len(script["table"](seconds).splitlines()) == 2 + len(some)


def test_benchmark_reproduces_a_part_of_the_results(tmp_path):
    from typer.testing import CliRunner

    from twin.cli.main import app

    few = "persistence,ukf,dsw-ukf-plus"
    part = ["--seeds", "0", "--scenarios", "zigzag", "--faults", "gps10", "--predictors", few]
    arguments = ["benchmark", *part, "--plans", "known", "--jobs", "1", "--out", str(tmp_path)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    key = ("scenario", "fault", "seed", "predictor", "plan")
    recorded = json.loads((ROOT / "examples/benchmark/results.json").read_text())["runs"]
    expected = {tuple(run[name] for name in key): run for run in recorded}
    runs = [
        run
        for run in json.loads((tmp_path / "results.json").read_text())["runs"]
        if run["scenario"] == "zigzag"
    ]
    assert {run["predictor"] for run in runs} == set(few.split(","))
    for run in runs:
        known = expected[tuple(run[name] for name in key)]
        for name in ("mae", "crps", "coverage90", "start_error", "displacement_10s"):
            assert run[name] == pytest.approx(known[name], rel=2e-3), (run["predictor"], name)


AGENTS_PAGE = (ROOT / "docs/explanation/agents.md").read_text(encoding="utf-8")
STUDIES = {
    "path": ROOT / "examples/agent_study/path",
    "docking": ROOT / "examples/agent_study/docking",
}
TASK_HEADS = {"path": "## Following a path", "docking": "## Docking"}


def study(task):
    return json.loads((STUDIES[task] / "results.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("task", STUDIES)
def test_agent_tables_equal_the_results(task):
    results = study(task)
    tables = runpy.run_path(str(ROOT / "examples/agent_study/tables.py"))["markdown"](results)
    section = AGENTS_PAGE[AGENTS_PAGE.index(TASK_HEADS[task]) + 2 :]
    section = section[: section.index("\n## ")]
    agents = {cell["agent"] for cell in results["cells"]}
    shown = {line for line in section.splitlines() if line.split(" | ")[0][2:] in agents}
    assert len(shown) >= 2 * len(agents)
    assert not shown - set(tables.splitlines())


@pytest.mark.parametrize(
    ("task", "agent"),
    [
        *(("path", name) for name in ("los-twin", "ppo-compact_raw", "ppo-compact")),
        ("path", "ppo-mpc-compact"),
        *(("docking", name) for name in ("dock-twin", "ppo-compact", "ppo-residual-compact")),
    ],
)
def test_agents_reproduce_a_part_of_the_study(task, agent):
    from twin.agents.controllers import CONTROLLERS, DOCKING, make_controller
    from twin.agents.evaluation import evaluate
    from twin.agents.policy import Policy

    results = study(task)
    if agent in CONTROLLERS | DOCKING:
        steers, seed = make_controller(agent), None
    else:
        steers = Policy.load(STUDIES[task] / "policies" / f"{agent}.npz")
        seed = steers.settings["seed"]
    (row,) = (row for row in results["episodes"] if (row["agent"], row["seed"]) == (agent, seed))
    found = evaluate(
        steers, seeds=range(920_000, 920_004), sea=row["sea"], faults=row["faults"], task=task,
        forecast_scores=False, vessel_spread=0.15, wind_from_deg="any", current="any",
        max_episode_steps=480,
    )  # fmt: skip
    assert row["condition"] == "spread .15" and row["faults"] == "gps30"
    assert [one["success"] for one in found] == row["success"][:4]
    name = {"path": "off_path_m", "docking": "length_s"}[task]
    # wave sums round differently on other processors, and an agent may react to that
    np.testing.assert_allclose([one[name] for one in found], row[name][:4], rtol=2e-3)


@pytest.mark.slow
def test_the_study_of_agents_runs(tmp_path):
    pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    script = str(ROOT / "examples/agent_study/run.py")
    command = [script, "docking", "--quick", "--out", str(tmp_path)]
    said = run(command, tmp_path)
    again = run(command, tmp_path)
    tables = said[said.index("# docking") :]
    assert tables == again[again.index("# docking") :]
    assert "| ppo-compact | dock-twin |" in tables


@pytest.mark.slow
def test_episodes_become_a_minari_data_set(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari", reason="minari is not installed")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "shelf"))
    run([str(ROOT / "examples/09_minari_dataset.py"), "usv/los-v0", "los", "2"], tmp_path)
    data = minari.load_dataset("usv/los-v0")
    first = next(iter(data.iterate_episodes()))
    assert data.total_episodes == 2 and first.infos["twin_ahead"].shape[1:] == (4, 6)
    obs, _info = data.recover_environment().reset(seed=0)
    np.testing.assert_array_equal(obs, first.observations[0])


@pytest.mark.slow
def test_the_fault_matrix_goes_on_from_what_it_kept(tmp_path):
    script = str(ROOT / "examples/fault_matrix/run.py")
    boat = ["--seeds", "100", "--vessels", "usv75", "--grades", "typical", "--rates", "5"]
    command = [script, *boat, "--jobs", "1"]
    table = run(command, tmp_path)
    assert "| 5 Hz | " in table and "| 20 Hz | " not in table
    (kept,) = (tmp_path / "fault_matrix_runs").iterdir()
    content, written = kept.read_text(), kept.stat().st_mtime_ns
    assert run(command, tmp_path) == table and kept.stat().st_mtime_ns == written
    kept.write_text(content.replace('"key": [', '"key": ["another version", '))
    assert run(command, tmp_path) == table and kept.read_text() == content
