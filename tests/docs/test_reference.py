"""The tables of the reference are those of the code."""

import re
from pathlib import Path

import gymnasium as gym

import usv_gym  # noqa: F401 - registers the environment
from twin.channels import COMMANDS, MEASUREMENTS, TRUTH
from twin.integrity.state import SENSORS, STATUSES
from twin.logs.columns import UNITS
from twin.predictors.registry import PREDICTORS
from twin.sim.compact import COMPACT, COMPACT_PARAMS
from twin.sim.wrapper import make_env

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "reference/environment.md").read_text(encoding="utf-8")
LOGS = (DOCS / "reference/logs.md").read_text(encoding="utf-8")


def test_observation_table_names_every_entry_in_order():
    rows = re.findall(
        r"^\| (\d+)[\d, to]* \| (`\w+`.*?) \| .+ \| (.+) \|$", PAGE, flags=re.MULTILINE
    )
    single, block = [], []
    for first, cell, unit in rows:
        assert unit.strip()
        names = re.findall(r"`(\w+)`", cell)
        some = block if "Hs" in cell else single
        assert int(first) == len(some)
        some += names
    ahead = [name.replace("Hs", f"{h}s") for h in (1, 2, 5, 10) for name in block]
    env = gym.make("USVTwin-v0", twin="ukf")
    assert (*single, *ahead) == env.unwrapped.observation_names
    env.close()


def test_compact_table_states_every_entry_and_scale():
    rows = re.findall(
        r"^\| `(compact_\w+)` \| ([^|]*) \| ([^|]*) \| ([^|]*) \|", PAGE, flags=re.MULTILINE
    )
    assert [row[0] for row in rows] == [one.name for one in COMPACT]
    for one, (_, source, offset, scale) in zip(COMPACT, rows, strict=True):
        if not one.near:
            assert f"`{one.source}`" in source
            assert offset.split(";")[0].strip() == f"{one.offset:g}"
            assert scale.split(";")[0].strip().split(" ")[0] == f"{one.scale:g}"
    for one in COMPACT_PARAMS[len(COMPACT) :]:
        role = one.name.removeprefix("compact_xi_").removeprefix("compact_sd_")
        assert role in PAGE, role


def test_names_of_health_and_truth_are_stated_in_order():
    for observation, fewer in (("twin_health", "twin"), ("oracle", "raw")):
        env, less = (make_env(twin="ukf", observation=name) for name in (observation, fewer))
        added = env.observation_names[len(less.observation_names) :]
        (line,) = (one for one in PAGE.splitlines() if one.startswith(f"`{observation}` appends"))
        assert tuple(re.findall(r"`([a-z]+_\w+)`", line.split("appends")[1])) == added


def test_status_table_names_every_status():
    page = (DOCS / "reference/twin.md").read_text(encoding="utf-8")
    section = page[page.index("## Health") : page.index("## Predictors")]
    assert set(re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)) == set(STATUSES)
    assert all(f"`{name}`" in section for name in SENSORS)


def test_info_table_names_every_key():
    env = gym.make("USVTwin-v0", twin="ukf")
    _, info = env.reset(seed=0)
    env.close()
    section = PAGE[PAGE.index("## Info") : PAGE.index("### Scores of the twin's forecasts")]
    cells = re.findall(r"^\| (`.*?`) \|", section, flags=re.MULTILINE)
    assert [name for cell in cells for name in re.findall(r"`(\w+)`", cell)] == list(info)


def test_log_tables_name_every_column_and_unit():
    assert not [name for name in (*COMMANDS, *MEASUREMENTS, *TRUTH) if f"`{name}`" not in LOGS]
    for ending, units in UNITS.items():
        (row,) = re.findall(rf"^\| `_{ending}` \| (.*) \|$", LOGS, flags=re.MULTILINE)
        assert not [unit for unit in units if f"`{unit}`" not in row]


def test_predictor_table_names_every_predictor():
    page = (DOCS / "reference/twin.md").read_text(encoding="utf-8")
    assert not [name for name in PREDICTORS if f"`{name}`" not in page]
