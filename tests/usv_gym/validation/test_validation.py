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
from usv_gym.validation import manoeuvring, sea, sections
from usv_gym.validation.page import FOLDER, PAGE, compare, failures, render, to_json
from usv_gym.validation.study import RUNS, BoatInSea, Row, Section, Study, shared_folder, under_way

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


# the required comparisons: how the items of their rows begin
REQUIRED = [
    *(f"35 deg turn to {side}, {i}/L" for side in ("starboard", "port") for i in ("AD", "DT")),
    *(f"L7, n = 10.4 rps: 35 deg turn to starboard, {index}" for index in ("V/U0", "r'")),
    *(
        f"L7, n = 10.4 rps: {name} to {side}, {which} overshoot"
        for name in ("10/10", "20/20")
        for side in ("starboard", "port")
        for which in ("first", "second")
    ),
    "L7: self-propulsion",
    *("PM: m0 g^2/U^4", "PM: Hs g/U^2", "PM: w_p sqrt(Hs/g)"),
    *(f"PM, Hs = .5 m: {name}" for name in ("w_p", "T_p", "lambda_p")),
    *("equal energy, N = 50", "equal energy: lowest", "equal energy: highest"),
    *(f"wind, speed boat, {name}" for name in ("0 deg: X", "90 deg: C_Y", "90 deg: C_N")),
    *(f"wind, speed boat, 30 deg: {name}" for name in ("C_X", "C_Y", "C_N", "X", "Y", "N")),
    *(f"wind, speed boat, {name}" for name in ("90 deg: Y", "90 deg: N")),
    *(f"wind, speed boat, 135 deg: {name}" for name in ("X", "Y", "N")),
    *(f"drift, lambda/L = {x}: {name}" for x in ("0.5", "1") for name in ("C_X", "C_Y", "C_N")),
    *(
        f"Jensen, head sea, w = {w}: {name}"
        for w in ("1, U = 0 m/s", "1.777, U = 0 m/s", "1.777, U = 5.58 m/s", "2.5, U = 0 m/s")
        for name in ("heave", "pitch")
    ),
    *("Froude-Krylov loads against quadrature", "NPD gusts", "Telemetron: u at 13.1 kN"),
    *("Merwe weights n = 6", "Merwe weights: Wc0", "Merwe weights: Wi"),
    *("Rosenstein: logistic", "Rosenstein: Henon", "Rosenstein against nolds"),
    *("Table 2 model, 20 deg: escapes", "Table 2 model: straight", "Table 3 model: straight"),
    *(f"Table 3 model, {angle} deg: {name}" for angle in ("+20", "-20") for name in "ur"),
]


@pytest.fixture(scope="module")
def page() -> dict[str, list[str]]:
    """Return the cells of the page in the repository by item."""
    lines = (DOCS / PAGE).read_text(encoding="ascii").splitlines()
    rows = [re.split(r" \| ", line[2:-2]) for line in lines if line.startswith("| ")]
    return {row[0]: row for row in rows}


def test_required_rows_are_on_the_page_and_ok(page: dict[str, list[str]]) -> None:
    for item in REQUIRED:
        pattern = re.compile(re.escape(item) + r"(\W|$)")
        results = [row[4] for name, row in page.items() if pattern.match(name)]
        assert results and set(results) == {"ok"}, item


def test_errors_of_the_paper_are_reported_without_values(page: dict[str, list[str]]) -> None:
    rows = [row for name, row in page.items() if name.startswith("paper's Table 4")]
    assert len(rows) == 12
    assert {(row[1], row[4]) for row in rows} == {("-", "reported")}


def test_all_rows_of_the_page_are_ok_or_reported(page: dict[str, list[str]]) -> None:
    assert len(page) > 250
    results = {row[4] for row in page.values()} - {"result"}
    assert results == {"ok", "reported"}
    for picture in re.findall(r"\]\((\S+\.png)\)", (DOCS / PAGE).read_text()):
        assert 1_000 < (DOCS / picture).stat().st_size < 150_000


def test_every_recorded_run_is_on_the_page(page: dict[str, list[str]]) -> None:
    for run in RUNS.values():
        for index in ("position RMS, m", "position RMS, L", "heading RMS, deg"):
            assert float(page[f"{run.title}: {index}"][1]) > 0.0
        if run.switch:
            assert f"{run.title}: first overshoot, deg" in page


def test_quick_sections_equal_those_of_the_page() -> None:
    # CI checks all sections with usv-twin validate --check
    text, study = (DOCS / PAGE).read_text(), Study(None)
    sections = [sea.wind_and_drift(study), manoeuvring.tanker_replay(study)]
    assert not failures(sections)
    assert all(row.skipped and row.ok is None for row in sections[1].rows)
    whole = render(sections, text)
    for section in sections:
        part = whole[whole.index(f"## {section.title}") :].split("\n## ")[0].strip()
        assert part in text


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
