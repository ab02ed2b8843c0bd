"""The tables of the reference are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import gymnasium as gym

import usv_gym  # noqa: F401 - registers the environment
from twin.channels import COMMANDS, MEASUREMENTS, TRUTH
from twin.integrity.state import SENSORS, STATUSES
from twin.logs.columns import UNITS
from twin.predictors.registry import PREDICTORS
from twin.sim.compact import COMPACT, COMPACT_ORACLE, COMPACT_PARAMS, COMPACT_RAW
from twin.sim.wrapper import make_env
from usv_gym.envs.tasks import TASKS

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "reference/environment.md").read_text(encoding="utf-8")
LOGS = (DOCS / "reference/logs.md").read_text(encoding="utf-8")


def test_observation_table_names_every_entry_in_order():
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| ([^|]+) \| ([^|]+) \|$", PAGE, flags=re.MULTILINE)
    single = [name for _, name, _, _ in rows if "Hs" not in name]
    block = [name for _, name, _, _ in rows if "Hs" in name]
    ahead = [name.replace("Hs", f"{h}s") for h in (1, 2, 5, 10) for name in block]
    env = gym.make("USVTwin-v0", twin="ukf")
    assert (*single, *ahead) == env.unwrapped.observation_names
    assert [int(row[0]) for row in rows] == [*range(len(single)), *range(len(block))]
    assert not [row for row in rows if "above" in row[3] or not row[3].strip()]
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


def test_compact_table_states_what_sensors_and_truth_have():
    raw, true = r"(?:`(compact_raw_\w+)`|-)", r"(?:`(compact_true_\w+)`|-)"
    pattern = rf"^\| `(\w+)` \| {raw} \| (.+) \| {true} \| (.+) \|$"
    rows = re.findall(pattern, PAGE, flags=re.MULTILINE)
    for place, entries in ((1, COMPACT_RAW), (3, COMPACT_ORACLE)):
        stated = [(row[place], row[place + 1]) for row in rows if row[place]]
        assert [name for name, _ in stated] == [one.name for one in entries]
        for one, (_, source) in zip(entries, stated, strict=True):
            assert source.startswith(f"`{one.source}`")
            assert one.of_pair is None or f"`{one.of_pair.source}`" in source
            assert one.name.endswith(f"_{next(r[0] for r in rows if r[place] == one.name)}")


def test_health_table_names_every_entry_in_order():
    env = make_env(twin="ukf", observation="twin_health")
    added = env.observation_names[len(make_env(twin="ukf").observation_names) :]
    assert tuple(re.findall(r"^\| `(health_\w+)` \|", PAGE, flags=re.MULTILINE)) == added


def test_status_table_names_every_status():
    page = (DOCS / "reference/twin.md").read_text(encoding="utf-8")
    section = page[page.index("## Health") : page.index("## Predictors")]
    assert set(re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)) == set(STATUSES)
    assert all(f"`{name}`" in section for name in SENSORS)


def test_reward_table_names_every_task_and_term():
    section = PAGE[PAGE.index("## Reward") : PAGE.index("## Info")]
    for name, task in TASKS.items():
        assert f"`{name}`" in section
        assert name == "free" or all(f"`{term}`" in section for term in task.terms)


def test_info_table_names_every_key():
    env = gym.make("USVTwin-v0", twin="ukf")
    _, info = env.reset(seed=0)
    env.close()
    section = PAGE[PAGE.index("## Info") : PAGE.index("### Scores of the twin's forecasts")]
    assert re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE) == list(info)


def test_log_tables_name_every_column_and_unit():
    assert not [name for name in (*COMMANDS, *MEASUREMENTS, *TRUTH) if f"`{name}`" not in LOGS]
    for ending, units in UNITS.items():
        (row,) = re.findall(rf"^\| `_{ending}` \| (.*) \|$", LOGS, flags=re.MULTILINE)
        assert not [unit for unit in units if f"`{unit}`" not in row]


def test_predictor_table_names_every_predictor():
    page = (DOCS / "reference/twin.md").read_text(encoding="utf-8")
    assert not [name for name in PREDICTORS if f"`{name}`" not in page]
