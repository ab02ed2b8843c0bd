"""The page on the paper names every equation, table and figure, and places that exist."""

from __future__ import annotations

import json
import re
from importlib import import_module
from pathlib import Path

import pytest

from twin.benchmark.paper.findings import findings
from twin.benchmark.paper.rows import PaperRow
from twin.benchmark.verdict.tables import number
from twin.predictors.registry import predictor_class

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/explanation/paper.md").read_text(encoding="utf-8")
ROWS = [
    PaperRow(**row)
    for row in json.loads((ROOT / "examples/paper/rows.json").read_text(encoding="utf-8"))
]
PLACE = re.compile(r"`((?:usv_gym|twin|usv_kernel)(?:\.\w+)+)`")
LINES = [
    [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
    for line in PAGE[PAGE.index("## Equation by equation") :].splitlines()
    if line.startswith("| ") and line.count("|") >= 6
]
"""Cells of the tables with five columns: in the paper, where, state, why, cost or gain."""


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


def test_table_4_is_that_of_the_results():
    rows = {row[1:5]: row for row in ROWS if row.table == "Table 4"}
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


def test_sentences_are_those_of_the_results():
    """The first, on the order of Table 4, needs the runs, too."""
    sentences = findings([row for row in ROWS if row.table == "Algorithm 1"], [])
    assert len(sentences) == 2
    for sentence in sentences:
        assert f"- {sentence}\n" in PAGE
