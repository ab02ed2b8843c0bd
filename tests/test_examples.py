"""Every example runs as it stands, and so do the README's blocks of Python."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def run(code: list[str], cwd: Path) -> str:
    result = subprocess.run(
        [sys.executable, *code], capture_output=True, text=True, cwd=cwd, timeout=300
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


OPTIONAL = {"05_rllib.py": "tests/agents/test_ray.py runs it, where Ray RLlib is installed"}


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_example(path, tmp_path):
    if path.name in OPTIONAL:
        pytest.skip(OPTIONAL[path.name])
    assert run([str(path)], tmp_path).strip()


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_readme_block(number, tmp_path):
    run(["-c", BLOCKS[number]], tmp_path)


def test_readme_has_its_blocks():
    assert len(BLOCKS) >= 2


def test_readme_files_exist():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target


def test_readme_results_are_those_of_the_checked_in_benchmark():
    import json

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
def test_study_tables_are_those_of_the_checked_in_results(script, function, rows):
    import runpy

    study = (ROOT / "STUDY.md").read_text(encoding="utf-8").splitlines()
    lines = runpy.run_path(str(ROOT / "examples" / script / "tables.py"))[function]()
    assert len(lines) >= rows
    missing = [line for line in lines if line not in study]
    assert not missing


def test_tables_of_the_speed_run_are_those_of_its_measurements():
    import runpy

    page = (ROOT / "examples/speed/README.md").read_text(encoding="utf-8").splitlines()
    tables = runpy.run_path(str(ROOT / "examples/speed/tables.py"))
    lines = [*tables["beside_peers"](), *tables["growing"]()]
    assert len(lines) > 50
    assert not [line for line in lines if line not in page]


def test_a_small_part_of_the_checked_in_benchmark_is_what_the_command_gives(tmp_path):
    import json

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


STUDY = ROOT / "examples/gps_loss_study"


def study():
    import json

    return json.loads((STUDY / "results.json").read_text(encoding="utf-8"))


def test_tables_of_the_gps_loss_study_are_those_of_its_results():
    from twin.agents.study import markdown

    results = study()
    text = markdown(results)
    assert (STUDY / "tables.md").read_text(encoding="utf-8") == text
    known = set(text.splitlines())
    section = README[README.index("### What the twin is worth") : README.index("## The ship and")]
    agents = {cell["agent"] for cell in results["cells"]}
    shown = [line for line in section.splitlines() if line.split(" | ")[0][2:] in agents]
    assert len(shown) >= 12
    assert not [line for line in shown if line not in known]


@pytest.mark.parametrize("agent", ["los-twin", "ppo-raw", "ppo-twin", "sac-oracle"])
def test_a_part_of_the_gps_loss_study_is_what_its_agents_do(agent):
    from twin.agents.controllers import CONTROLLERS, make_controller
    from twin.agents.evaluation import evaluate
    from twin.agents.policy import Policy

    results = study()
    if agent in CONTROLLERS:
        steers, seed = make_controller(agent), None
    else:
        steers = Policy.load(STUDY / "policies" / f"{agent}.npz")
        seed = steers.settings["seed"]
    (row,) = (
        row
        for row in results["episodes"]
        if (row["agent"], row["seed"], row["sea"], row["faults"]) == (agent, seed, "2", "gps30")
    )
    seeds = results["settings"]["evaluation_seeds"][:6]
    found = evaluate(steers, seeds=seeds, sea="2", faults="gps30", twin="ukf")
    for name in ("off_path_m", "return"):
        # wave sums are rounded otherwise on other processors, and an agent may answer to that
        np.testing.assert_allclose([one[name] for one in found], row[name][:6], rtol=1e-3)


def test_shipped_policies_are_small():
    sizes = [path.stat().st_size for path in (STUDY / "policies").glob("*.npz")]
    assert len(sizes) >= 9
    assert max(sizes) < 200_000


def test_the_agent_of_the_default_task_is_as_good_as_line_of_sight():
    """On a few episodes; the README's are 200."""
    from twin.agents.controllers import make_controller
    from twin.agents.evaluation import evaluate
    from twin.agents.policy import Policy

    trained = Policy.load(STUDY / "default_task" / "policy.npz")
    off = [
        np.mean([row["off_path_m"] for row in evaluate(agent, seeds=range(900_000, 900_020))])
        for agent in (trained, make_controller("los"))
    ]
    assert off[0] < 1.1 * off[1]
