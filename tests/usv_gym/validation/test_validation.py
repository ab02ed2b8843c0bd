"""The validation page: its rows, when it fails, what it says of data that are not here."""

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
from usv_gym.validation.study import Row, Section, Study, shared_folder

ROOT = Path(__file__).resolve().parents[3]
SIX = {"item", "value", "reference", "tolerance", "source", "ok"}


def a_row(**changes: object) -> Row:
    row = Row("speed, m/s", 9.6672991, 9.667, 1e-3, "Loe 2008")
    return dataclasses.replace(row, **changes)  # type: ignore[arg-type]


def a_section(*rows: Row) -> Section:
    return Section("Boats", "What they say.", rows, {"boats.png": "Boats."})


# ------------------------------------------------- a row


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
def test_verdicts(
    kind: str, value: float | None, reference: float, tolerance: float | None, ok: bool | None
) -> None:
    row = a_row(kind=kind, value=value, reference=reference, tolerance=tolerance)
    assert row.ok is ok
    assert dataclasses.replace(row, skipped="no data").ok is None


# ------------------------------------------------- the page


def test_a_page_of_today_has_no_differences() -> None:
    sections = [a_section(a_row(), a_row(item="a size", value=1e-12, kind="below", reference=0.0))]
    page = render(sections)
    assert "| speed, m/s | 9.667 | 9.667 | 0.1 % | ok | Loe 2008 |" in page
    assert f"![Boats.]({FOLDER}/boats.png)" in page
    assert compare(page, sections) == [] and failures(sections) == []
    page.encode("ascii")


@pytest.mark.parametrize("value", [9.66750, 9.66655])
def test_rounding_is_no_difference(value: float) -> None:
    page = render([a_section(a_row(value=9.667))])
    assert compare(page, [a_section(a_row(value=value))]) == []


def test_small_sizes_may_be_any_below_their_bound() -> None:
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
def test_a_changed_page_is_noticed(old: str, new: str, words: str) -> None:
    sections = [a_section(a_row())]
    page = render(sections)
    assert old in page
    found = compare(page.replace(old, new, 1), sections)
    assert found and words in found[0]


def test_more_or_fewer_rows_are_noticed() -> None:
    one, two = [a_section(a_row())], [a_section(a_row(), a_row(item="other"))]
    assert compare(render(one), two) and compare(render(two), one)


def test_a_row_without_its_data_keeps_what_the_page_says() -> None:
    page = render([a_section(a_row(value=9.66, tolerance=0.01))])
    gone = [a_section(a_row(value=None, reference=None, tolerance=0.01, skipped="not here"))]
    assert render(gone, page) == page
    assert compare(page, gone) == [] and failures(gone) == []
    # and says so where there is no page to keep
    assert "| speed, m/s | - | - | 1 % | skipped | Loe 2008 |" in render(gone)


def test_rows_out_of_tolerance_are_named() -> None:
    sections = [a_section(a_row(value=9.8))]
    (text,) = failures(sections)
    assert text == "Boats: speed, m/s: 9.800, but 9.667 (0.1 %) after Loe 2008"
    assert "**OUT**" in render(sections)


def test_json_has_the_six_keys_and_numbers() -> None:
    rows = to_json(
        [a_section(a_row(), a_row(value=None, skipped="not here"), a_row(value=math.nan))]
    )
    assert all(set(row) >= SIX for row in rows)
    assert [row["ok"] for row in rows] == [True, None, False]
    assert rows[0]["value"] == 9.6672991 and rows[2]["value"] is None
    json.loads(json.dumps(rows, allow_nan=False))


# ------------------------------------------------- the command


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[Row]:
    """Put one section of our own in the place of all; return its rows, which may be changed."""
    rows = [a_row()]
    sections = {"boats": lambda study: a_section(*rows)}
    monkeypatch.setattr("usv_gym.validation.sections.SECTIONS", sections)
    monkeypatch.setattr("usv_gym.validation.figures.PICTURES", {"none.png": lambda study: None})
    return rows


def invoke(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["validate", *arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, " ".join((result.stdout + result.stderr).split())


def test_write_then_check(quick: list[Row], tmp_path: Path) -> None:
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
    assert "9.660" in (tmp_path / PAGE).read_text()  # a check writes nothing

    (tmp_path / PAGE).write_text(page)
    quick[0] = a_row(value=9.7)
    code, text = invoke(*out, "--check")
    assert code == 1 and "speed, m/s: 9.700, but 9.667 (0.1 %)" in text
    # written all the same, with the failure on it
    assert invoke(*out)[0] == 1
    assert "**OUT**" in (tmp_path / PAGE).read_text()


def test_check_skips_what_needs_data(quick: list[Row], tmp_path: Path) -> None:
    assert invoke("--out", str(tmp_path))[0] == 0
    quick[0] = a_row(value=None, reference=None, skipped="the runs are not here")
    code, text = invoke("--out", str(tmp_path), "--check")
    assert code == 0 and "skipped: the runs are not here" in text


def test_ctrl_c_is_clean(quick: list[Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(study: Study) -> Section:
        raise KeyboardInterrupt

    monkeypatch.setitem(sections.SECTIONS, "wind", interrupted)  # after the first is done
    code, text = invoke("--out", str(tmp_path), "--json", str(tmp_path / "rows.json"))
    assert code == 130 and "stopped: nothing is written" in text
    assert not list(tmp_path.iterdir())


# ------------------------------------------------- what is on the page

# physics.md section 11, row by row: what the items on the page begin with
CHECKLIST = {
    "KVLCC2 35 deg, experiment": [
        f"35 deg turn to {side}, {index}"
        for side in ("starboard", "port")
        for index in ("AD/L", "DT/L")
    ],
    "KVLCC2 steady, model": [
        "L7, n = 10.4 rps: 35 deg turn to starboard, V/U0",
        "L7, n = 10.4 rps: 35 deg turn to starboard, r'",
    ],
    "KVLCC2 zigzags, model": [
        f"L7, n = 10.4 rps: {name} to {side}, {which} overshoot"
        for name in ("10/10", "20/20")
        for side in ("starboard", "port")
        for which in ("first", "second")
    ],
    "KVLCC2 self-propulsion": ["L7: self-propulsion"],
    "PM": ["PM: m0 g^2/U^4", "PM: Hs g/U^2", "PM: w_p sqrt(Hs/g)"],
    "PM Hs=.5": [f"PM, Hs = .5 m: {name}" for name in ("w_p", "T_p", "lambda_p")],
    "equal energy": [
        *("equal energy, N = 50", "equal energy: lowest", "equal energy: highest"),
    ],
    "Blendermann": [
        "wind, speed boat, 0 deg: X",
        *(f"wind, speed boat, 30 deg: {name}" for name in ("C_X", "C_Y", "C_N", "X", "Y", "N")),
        *(f"wind, speed boat, 90 deg: {name}" for name in ("C_Y", "C_N", "Y", "N")),
        *(f"wind, speed boat, 135 deg: {name}" for name in ("X", "Y", "N")),
    ],
    "drift": [
        f"drift, lambda/L = {x}: {name}" for x in ("0.5", "1") for name in ("C_X", "C_Y", "C_N")
    ],
    "Jensen": [
        f"Jensen, head sea, w = {w}, U = {u} m/s: {name}"
        for w, u in (("1", "0"), ("1.777", "0"), ("1.777", "5.58"), ("2.5", "0"), ("2.5", "5.58"))
        for name in ("heave", "pitch")
    ],
    "FK box": ["Froude-Krylov loads against quadrature"],
    "NPD sigma": ["NPD gusts"],
    "Telemetron": ["Telemetron: u at 13.1 kN"],
    "Merwe": ["Merwe weights n = 6", "Merwe weights: Wc0", "Merwe weights: Wi"],
    "Rosenstein": [
        *("Rosenstein: logistic", "Rosenstein: Henon", "Rosenstein against nolds"),
    ],
    "Table 2 and 3": [
        *("Table 2 model, 20 deg: escapes", "Table 2 model: straight", "Table 3 model: straight"),
        *(f"Table 3 model, {angle} deg: {name}" for angle in ("+20", "-20") for name in "ur"),
    ],
}
REFERENCES = [
    f"paper's Table 4, {scenario}: {metric} of {method}"
    for scenario in ("turn", "zigzag")
    for metric in ("MAE", "MSE")
    for method in ("DSW-UKF", "UKF", "LSTM")
]


@pytest.fixture(scope="module")
def page() -> dict[str, list[str]]:
    """Return the cells of the rows of the page in the repository, which the CI checks."""
    lines = (ROOT / PAGE).read_text(encoding="ascii").splitlines()
    rows = [re.split(r" \| ", line[2:-2]) for line in lines if line.startswith("| ")]
    return {row[0]: row for row in rows}


@pytest.mark.parametrize("item", [item for items in CHECKLIST.values() for item in items])
def test_every_golden_number_is_there_and_met(item: str, page: dict[str, list[str]]) -> None:
    found = [row for name, row in page.items() if re.match(re.escape(item) + r"(\W|$)", name)]
    assert found
    assert all(row[4] == "ok" for row in found)


@pytest.mark.parametrize("item", REFERENCES)
def test_the_papers_errors_are_there_for_reference_only(
    item: str, page: dict[str, list[str]]
) -> None:
    assert page[item][1] == "-" and page[item][4] == "reported"


def test_nothing_on_the_page_is_out_or_missing(page: dict[str, list[str]]) -> None:
    assert len(page) > 250
    results = {row[4] for row in page.values()} - {"result"}
    assert results == {"ok", "reported"}
    for picture in re.findall(r"\]\((\S+\.png)\)", (ROOT / PAGE).read_text()):
        assert 1_000 < (ROOT / picture).stat().st_size < 150_000


def test_every_recorded_run_is_replayed(page: dict[str, list[str]]) -> None:
    for run in sections.RUNS.values():
        for index in ("position RMS, m", "position RMS, L", "heading RMS, deg"):
            assert float(page[f"{run.title}: {index}"][1]) > 0.0
        if run.switch:
            assert f"{run.title}: first overshoot, deg" in page


def test_quick_sections_are_those_of_the_page() -> None:
    """The rest is checked by ``usv-twin validate --check`` in the CI."""
    text, study = (ROOT / PAGE).read_text(), Study(None)
    sections = [sea.wind_and_drift(study), manoeuvring.tanker_replay(study)]
    assert not failures(sections)
    assert all(row.skipped and row.ok is None for row in sections[1].rows)
    whole = render(sections, text)
    for section in sections:
        part = whole[whole.index(f"## {section.title}") :].split("\n## ")[0].strip()
        assert part in text


def test_recorded_data_are_looked_for_beside_the_repository(
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


def test_a_replay_of_the_models_own_run_is_the_run(tmp_path: Path) -> None:
    """A run of the model itself, written as if recorded, is sailed again."""
    study, dt = Study(None), 0.05
    t = dt * np.arange(801)
    helm = np.radians(10.0) * np.sign(np.sin(0.1 * t))
    start = sections.under_way(1.18, n=10.3)
    states, sailor = [start], sections.Sailor(study.model)
    for k in range(len(t) - 1):
        cmd = np.array([10.3, 10.3, *2 * [0.5 * (helm[k] + helm[k + 1])]])
        state = states[-1].copy()
        state[12:] = cmd
        sailor.step(state, cmd, dt)
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
