"""The validation page: rows, comparison, missing data, and the command."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from twin.cli.main import app
from usv_gym.validation import sections
from usv_gym.validation.page import FOLDER, PAGE, compare, failures, render, to_json
from usv_gym.validation.study import BoatInSea, Row, Section, Study, shared_folder, under_way

DOCS = Path(__file__).resolve().parents[3] / "docs" / "explanation"
SIX = {"item", "value", "reference", "tolerance", "source", "ok"}


def a_row(**changes: object) -> Row:
    row = Row("speed, m/s", 9.6672991, 9.667, 1e-3, "Loe 2008")
    return dataclasses.replace(row, **changes)  # type: ignore[arg-type]


def a_section(*rows: Row) -> Section:
    return Section("Boats", "What they say.", rows, {"boats.png": "Boats."})


@pytest.mark.parametrize(
    ("kind", "value", "reference", "tolerance", "ok"),
    [
        ("relative", 1.009, 1.0, 0.01, True),
        ("relative", 1.011, 1.0, 0.01, False),
        ("relative", -2.03, -2.0, 0.01, False),
        ("absolute", 5.49, 5.2, 0.3, True),
        ("absolute", 5.51, 5.2, 0.3, False),
        ("factor", 0.41, 1.0, 2.5, True),
        ("factor", 0.39, 1.0, 2.5, False),
        ("factor", 2.51, 1.0, 2.5, False),
        ("below", -9e-11, 0.0, 1e-10, True),
        ("below", 1.1e-10, 0.0, 1e-10, False),
        ("relative", math.nan, 1.0, 0.01, False),
        ("relative", None, 1.0, 0.01, False),
        ("reported", 9.0, 1.0, None, None),
    ],
)
def test_result_follows_kind_and_tolerance(
    kind: str, value: float | None, reference: float, tolerance: float | None, ok: bool | None
) -> None:
    row = a_row(kind=kind, value=value, reference=reference, tolerance=tolerance)
    assert row.ok is ok
    assert dataclasses.replace(row, skipped="no data").ok is None


def test_a_new_page_has_no_differences() -> None:
    sections = [a_section(a_row(), a_row(item="a size", value=1e-12, kind="below", reference=0.0))]
    page = render(sections)
    assert "| speed, m/s | 9.667 | 9.667 | 0.1 % | ok | Loe 2008 |" in page
    assert f"![Boats.]({FOLDER}/boats.png)" in page
    assert compare(page, sections) == [] and failures(sections) == []
    page.encode("ascii")


@pytest.mark.parametrize("value", [9.66750, 9.66655])
def test_rounding_is_ignored(value: float) -> None:
    page = render([a_section(a_row(value=9.667))])
    assert compare(page, [a_section(a_row(value=value))]) == []


def test_sizes_below_their_bound_are_equal() -> None:
    pages = [a_section(a_row(kind="below", value=v, reference=0.0)) for v in (1e-7, 9e-5)]
    assert compare(render(pages[:1]), pages[1:]) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("| 9.667 | 9.667 |", "| 9.668 | 9.667 |", "value is 9.668 on the page"),
        ("| 9.667 | 9.667 |", "| 9.667 | 9.700 |", "reference is 9.700 on the page"),
        ("0.1 %", "5 %", "tolerance is 5 %"),
        ("| ok |", "| reported |", "result is reported"),
        ("speed, m/s", "speed", "the page has"),
        ("What they say.", "Something else.", "the page has"),
        ("\n*Boats.*\n", "", "the page has"),
    ],
)
def test_changes_of_a_page_are_reported(old: str, new: str, words: str) -> None:
    sections = [a_section(a_row())]
    page = render(sections)
    assert old in page
    found = compare(page.replace(old, new, 1), sections)
    assert found and words in found[0]


def test_more_or_fewer_rows_are_reported() -> None:
    one, two = [a_section(a_row())], [a_section(a_row(), a_row(item="other"))]
    assert compare(render(one), two) and compare(render(two), one)


def test_a_row_without_data_keeps_its_value_on_the_page() -> None:
    page = render([a_section(a_row(value=9.66, tolerance=0.01))])
    gone = [a_section(a_row(value=None, reference=None, tolerance=0.01, skipped="not here"))]
    assert render(gone, page) == page
    assert compare(page, gone) == [] and failures(gone) == []
    # without a page
    assert "| speed, m/s | - | - | 1 % | skipped | Loe 2008 |" in render(gone)


def test_rows_out_of_tolerance_are_reported() -> None:
    sections = [a_section(a_row(value=9.8))]
    (text,) = failures(sections)
    assert text == "Boats: speed, m/s: 9.800, but 9.667 (0.1 %) from Loe 2008"
    assert "**OUT**" in render(sections)


def test_json_has_the_six_keys_and_numbers() -> None:
    rows = to_json(
        [a_section(a_row(), a_row(value=None, skipped="not here"), a_row(value=math.nan))]
    )
    assert all(set(row) >= SIX for row in rows)
    assert [row["ok"] for row in rows] == [True, None, False]
    assert rows[0]["value"] == 9.6672991 and rows[2]["value"] is None
    json.loads(json.dumps(rows, allow_nan=False))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[Row]:
    """Replace all sections by a test section; return its rows, which may be changed."""
    rows = [a_row()]
    sections = {"boats": lambda study: a_section(*rows)}
    monkeypatch.setattr("usv_gym.validation.sections.SECTIONS", sections)
    monkeypatch.setattr("usv_gym.validation.figures.PICTURES", {"none.png": lambda study: None})
    return rows


def invoke(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["validate", *arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, " ".join((result.stdout + result.stderr).split())


def test_check_compares_with_the_written_page(quick: list[Row], tmp_path: Path) -> None:
    out = ("--out", str(tmp_path))
    code, text = invoke(*out, "--check")
    assert code == 2 and PAGE in text
    assert invoke(*out, "--json", str(tmp_path / "rows.json"))[0] == 0
    assert json.loads((tmp_path / "rows.json").read_text())[0]["item"] == "speed, m/s"
    assert invoke(*out, "--check")[0] == 0

    page = (tmp_path / PAGE).read_text()
    (tmp_path / PAGE).write_text(page.replace("| 9.667 | 9.667 |", "| 9.660 | 9.667 |"))
    code, text = invoke(*out, "--check")
    assert code == 1 and "speed, m/s: value is 9.660 on the page" in text
    assert "9.660" in (tmp_path / PAGE).read_text()  # nothing is written

    (tmp_path / PAGE).write_text(page)
    quick[0] = a_row(value=9.7)
    code, text = invoke(*out, "--check")
    assert code == 1 and "speed, m/s: 9.700, but 9.667 (0.1 %)" in text
    # the page is written with the failure
    assert invoke(*out)[0] == 1
    assert "**OUT**" in (tmp_path / PAGE).read_text()


def test_check_skips_rows_without_data(quick: list[Row], tmp_path: Path) -> None:
    assert invoke("--out", str(tmp_path))[0] == 0
    quick[0] = a_row(value=None, reference=None, skipped="the runs are not here")
    code, text = invoke("--out", str(tmp_path), "--check")
    assert code == 0 and "skipped: the runs are not here" in text


def test_ctrl_c_writes_nothing(
    quick: list[Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(study: Study) -> Section:
        raise KeyboardInterrupt

    monkeypatch.setitem(sections.SECTIONS, "wind", interrupted)
    code, text = invoke("--out", str(tmp_path), "--json", str(tmp_path / "rows.json"))
    assert code == 130 and "stopped: nothing is written" in text
    assert not list(tmp_path.iterdir())


# results on the page (ok, reported) by section
COUNTS = {
    "KVLCC2: trials against separate code": (61, 0),
    "KVLCC2: trials against towing tanks": (4, 18),
    "KVLCC2: replay of recorded runs": (0, 55),
    "Sea and gusts": (29, 0),
    "Wind and mean wave drift": (20, 0),
    "Loads and free motions in waves": (25, 3),
    "Motions in waves against a boundary-element code": (388, 0),
    "Motions under way beside Jensen's closed forms": (7, 22),
    "Small boats": (26, 8),
    "Numerics": (8, 0),
    "The twin": (13, 12),
}


@pytest.fixture(scope="module")
def page() -> str:
    """Return the page in the repository."""
    return (DOCS / PAGE).read_text(encoding="ascii")


def test_page_has_all_results(page: str) -> None:
    found = {}
    for part in page.split("\n## ")[1:]:
        rows = [line.split(" | ") for line in part.splitlines() if line.startswith("| ")][1:]
        results = [row[4] for row in rows]
        found[part.split("\n")[0]] = (results.count("ok"), results.count("reported"))
        assert len(rows) == sum(found[part.split("\n")[0]])
        for row in rows:
            # values of the paper, and headings that never reached the switch
            missing = row[0].startswith("| paper's Table 4") or "overshoot" in row[0]
            assert missing or row[1] != "-", row
    assert found == COUNTS
    for picture in re.findall(r"\]\((\S+\.png)\)", page):
        assert 1_000 < (DOCS / picture).stat().st_size < 150_000


@pytest.fixture(scope="module")
def study() -> Study:
    """Return a study without recorded data."""
    return Study(None)


@pytest.mark.parametrize("name", sections.SECTIONS)
def test_a_section_is_within_tolerance(name: str, study: Study) -> None:
    """The numbers of ship and sea that docs/explanation/ship_and_sea.md quotes."""
    assert failures([sections.SECTIONS[name](study)]) == []


@pytest.mark.slow
def test_sections_are_within_tolerance_and_equal_the_page(page: str) -> None:
    """Rows of recorded data are checked by ``usv-twin validate --check``, where the data are."""
    found = [section(Study(None)) for section in sections.SECTIONS.values()]
    assert failures(found) == []
    assert compare(page, found) == []
    assert {row.ok for section in found for row in section.rows if row.skipped} <= {None}


def test_shared_folder_is_next_to_the_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("USV_TWIN_SHARED", raising=False)
    root = tmp_path / "repository"
    assert shared_folder(root) is None
    (tmp_path / "shared" / "data").mkdir(parents=True)
    assert shared_folder(root) == tmp_path / "shared"
    monkeypatch.setenv("USV_TWIN_SHARED", str(tmp_path))
    assert shared_folder(root) is None
    study = Study(tmp_path / "shared")
    assert study.recordings == {} and study.hours == {}


def test_a_replay_of_a_simulated_run_equals_the_run(tmp_path: Path) -> None:
    study, dt = Study(None), 0.05
    t = dt * np.arange(801)
    helm = np.radians(10.0) * np.sign(np.sin(0.1 * t))
    start = under_way(1.18, n=10.3)
    states, boat = [start], BoatInSea(study.model)
    for k in range(len(t) - 1):
        cmd = np.array([10.3, 10.3, *2 * [0.5 * (helm[k] + helm[k + 1])]])
        state = states[-1].copy()
        state[12:] = cmd
        boat.step(state, cmd, dt)
        states.append(state)
    motion = np.array(states)
    columns = {"x_m": 0, "y_m": 1, "psi_rad": 5, "u_mps": 6, "v_mps": 7, "r_radps": 11}
    table = {"t_s": t, **{name: motion[:, i] for name, i in columns.items()}}
    table |= {"delta_rad": helm, "n_rps": np.full_like(t, 10.3)}
    path = tmp_path / "run.csv"
    rows = np.column_stack(list(table.values()))
    np.savetxt(path, rows, "%.17g", ",", header=",".join(table), comments="")
    got = study._replay(path)
    np.testing.assert_allclose(got.replayed.x, got.measured.x, atol=1e-9)
    np.testing.assert_allclose(got.replayed.psi, got.measured.psi, atol=1e-12)
    assert np.ptp(got.replayed.psi) > 0.1
