"""The page on the paper names every equation, table and figure, and places that exist."""

import json
import math
import re
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin.benchmark.protocol import Settings
from twin.benchmark.verdict.tables import number
from twin.predictors.registry import options_of, predictor_class

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/explanation/paper.md").read_text(encoding="utf-8")
FOLDER = ROOT / "examples/paper"
PLACE = re.compile(r"`((?:usv_gym|twin|usv_kernel)(?:\.\w+)+|examples/paper/\w+\.py)`")
LINES = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in PAGE[PAGE.index("## Equation by equation") :].splitlines()
    if line.startswith("| ") and line.count("|") >= 6
]
"""Cells of the tables with five columns: in the paper, where, state, why, cost or gain."""


@pytest.fixture(scope="module")
def study():
    """The module run.py of examples/paper, with the modules that it imports."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        yield SimpleNamespace(run=import_module("run"), findings=import_module("findings"))
    for name in ("run", "findings", "page", "published"):
        del sys.modules[name]


@pytest.fixture(scope="module")
def rows(study):
    """The checked-in rows."""
    kind = study.findings.PaperRow
    return [kind(**one) for one in json.loads((FOLDER / "rows.json").read_text(encoding="utf-8"))]


def numbers(word: str) -> set[int]:
    """Return what is named as ``Eq 1-3, 7``, or with Figures or Tables in the place of Eq."""
    found = set()
    for line in LINES:
        for text in re.findall(rf"{word} ([\d\u2013, and]+)", line[0]):
            for first, last in re.findall(r"(\d+)(?:\u2013(\d+))?", text):
                found |= set(range(int(first), int(last or first) + 1))
    return found


def test_every_equation_table_and_figure_is_named():
    assert numbers("Eq") == set(range(1, 55))
    assert numbers("Tables?") == {1, 2, 3, 4}
    assert numbers("Figures?") == set(range(1, 17))
    assert any(line[0] == "Algorithm 1" for line in LINES)


@pytest.mark.parametrize("place", sorted(set(PLACE.findall(PAGE))))
def test_each_place_named_exists(place):
    if place.startswith("examples/"):
        assert (ROOT / place).is_file()
        return
    parts = place.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not place.startswith(str(error.name)):
                raise  # of another library
            continue
        for name in parts[count:]:
            found = getattr(found, name)
        return
    raise AssertionError(place)


def test_each_line_says_where_and_in_which_state():
    rows = [line for line in LINES if line[0] != "in the paper" and not line[0].startswith("---")]
    assert len(rows) > 50
    assert not [
        line for line in rows if not line[2] or not (PLACE.search(line[1]) or line[1] == "none")
    ]
    changed = [line for line in rows if line[2] in ("mended", "added", "replaced")]
    assert not [line for line in changed if not line[3]]


def test_predictors_named_in_the_table_can_be_made():
    names = re.findall(r"^\| `(dsw-ukf[^`]*)` \|", PAGE, flags=re.MULTILINE)
    assert len(set(names)) == 5
    for name in names:
        predictor_class(name)


def test_table_4_is_that_of_the_results(rows):
    rows = {row[1:5]: row for row in rows if row.table == "Table 4"}
    heads = ["turn", "turn, gps10", "zigzag", "zigzag, gps10"]
    section = PAGE[PAGE.index("## What reproduces") : PAGE.index("## What the text leaves open")]
    lines = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in section.splitlines()
        if line.startswith("| `")
    ]
    assert [line[0].strip("`") for line in lines] == list(dict.fromkeys(key[2] for key in rows))
    for line in lines:
        for head, cell in zip(heads, line[1:], strict=True):
            scenario, _, fault = head.partition(", ")
            row = rows[scenario, fault or "none", line[0].strip("`"), "MAE"]
            text = f"{number(row.ours)} [{number(row.low)}, {number(row.high)}]"
            assert cell == (text if row.paper is None else f"{text} / {number(row.paper)}")


def test_sentences_are_those_of_the_results(study, rows):
    """The first, on the order of Table 4, needs the runs, too."""
    sentences = study.findings.findings(rows, [])
    assert len(sentences) == 2
    for sentence in sentences:
        assert f"- {sentence}\n" in PAGE


def test_variants_differ_in_the_window_alone(study):
    for name, without in study.findings.WITHOUT_WINDOW.items():
        assert options_of(without) == {**options_of(name), "window": "off"}


def test_window_shares_count_what_the_index_adds(study):
    V, S = [math.nan, 0.0, 0.2, 1.0], [math.nan, 1.0, 5.0, 1.0]
    four = np.arange(4.0), np.ones((4, 25)), np.array([15, 15, 30, 20]), np.array(V), np.array(S)
    part = study.findings.Trace(*four, np.ones(4), np.zeros(4), 15, 15)
    shares = study.findings.window_shares(part)
    assert shares["W, mean, rows"] == 20.0 and shares["cap of W, rows"] == 30.0
    assert shares["W at its cap, share of time"] == 0.25
    assert shares["W at its base, share of time"] == 0.5
    assert shares["rows that V adds, mean"] == pytest.approx(15 * 0.6 * 0.4)
    assert shares["rows that V adds, largest"] == pytest.approx(9.0)
    # at S = 5 the window is at its cap either way
    assert shares["V changes W, share of time"] == pytest.approx(1 / 3)


def test_a_short_study_writes_page_and_rows(study, tmp_path):
    names = ("dsw-ukf:printed", "dsw-ukf", "dsw-ukf:window=off", "dsw-ukf:printed,window=off")
    settings = Settings(
        seeds=(0, 1, 2),
        faults=("none",),
        plans=("known",),
        predictors=names,
        identify_s=8.0,
        duration_s=20.0,
    )
    study.run.redo(settings, tmp_path, 1)
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))
    named = {row["table"] for row in rows}
    figures = {f"Figure {k}" for k in range(9, 17)}
    assert figures | {"Algorithm 1", "Table 2", "Table 3", "Table 4"} == named
    mae = [row for row in rows if (row["table"], row["metric"]) == ("Table 4", "MAE")]
    for row in mae:
        paper = "DSW-UKF" if "window=off" not in row["predictor"] else "UKF"
        assert row["paper"] == study.findings.published.TABLE_4[row["scenario"]][paper][0]
        assert row["low"] <= row["ours"] <= row["high"]
    assert len(mae) == 2 * len(names)
    assert "## Table 4" in (tmp_path / "paper.md").read_text(encoding="utf-8")
    assert len(list(tmp_path.glob("*.png"))) == 2 * (1 + 1 + 3)
