"""Tables for papers: what is bold, what is written out, and columns that fit."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess

import pytest

from twin.benchmark.export import CSV_COLUMNS, csv_text, latex_text

CELL = {"scenario": "turn", "case": "gps10", "fault": "gps10", "sea": "2", "grade": "typical"}

MAE = {"persistence": 1.5, "ukf": 0.1404, "my_own:Mine": 0.1396, "oracle": 0.05}


def results():
    """Return what a benchmark of four predictors collects."""
    rows = []
    for name, mae in MAE.items():
        cell = {**CELL, "predictor": name, "plan": "known"}
        known = {"low": 0.9 * mae, "high": 1.1 * mae, "median": mae}
        rows.append({**cell, "metric": "mae", "value": mae, **known})
        rows.append({**cell, "metric": "psi_10s", "value": math.radians(10.0 * mae), **known})
        none = {"low": None, "high": None, "median": 0.9}
        rows.append({**cell, "metric": "coverage90", "value": 1.0 - 0.5 * mae, **none})
    recorded = {"folder": "lake", "fault": "none", "plan": "known", "channel": "psi", "runs": 2}
    return {
        "version": "1.2",
        "command": "usv-twin benchmark\n--seeds 0-2",
        "program": {"sources": "abc"},
        "summary": rows,
        "recorded": [
            {**recorded, "predictor": name, "ratio": mae, "low": None, "high": None}
            for name, mae in MAE.items()
        ],
        "runs": [{**CELL, "plan": "known", "predictor": n, "seed": k} for n in MAE for k in (0, 1)],
    }


def rolling():
    """Return the same with roll at 1 s and a quiet deck."""
    here = {**CELL, "plan": "known"}
    scores = {"sd": 0.08, "held": 1.5, "crps": 0.02, "coverage90": 0.8}
    motion = [
        {**here, "predictor": name, "seed": k, "channel": "roll", "horizon_s": 1.0}
        | {**scores, "rmse": mae + 0.01 * k, "skill": mae}
        for name, mae in MAE.items()
        for k in range(2)
    ]
    quiet = [
        {**here, "predictor": name, "span_s": 2.0, "base_rate": 0.4, "brier": mae}
        | {"brier_skill": -mae, "auc": None, "auc_now": 0.7}
        for name, mae in MAE.items()
    ]
    return results() | {"motion": motion, "quiet": quiet}


def test_csv_has_roll_pitch_heave_and_the_quiet_deck():
    table = list(csv.DictReader(io.StringIO(csv_text(rolling()))))
    found = {(row["metric"], row["predictor"]): row for row in table}
    rmse = found["roll_1s_rmse", "ukf"]
    assert float(rmse["value"]) == pytest.approx(0.1404 + 0.005)
    assert float(rmse["median"]) == pytest.approx(0.1404 + 0.005)
    assert (rmse["unit"], rmse["runs"], rmse["scenario"]) == ("rad", "2", "turn")
    assert float(found["roll_1s_sd", "ukf"]["value"]) == pytest.approx(0.08)
    assert found["roll_1s_skill", "ukf"]["best"] == "true"
    assert found["roll_1s_skill", "persistence"]["best"] == "false"
    # a larger skill is better, and the sea is nobody's
    assert found["quiet_2s_brier_skill", "ukf"]["best"] == "true"
    assert found["quiet_2s_brier_skill", "persistence"]["best"] == "false"
    assert found["roll_1s_sd", "ukf"]["best"] == "false"
    assert ("quiet_2s_auc", "ukf") not in found


def test_latex_has_intervals_and_the_best_in_bold():
    text = latex_text(results())
    table, recorded = text.split(r"\begin{table}")[1:]
    lines = table.splitlines()
    head = next(line for line in lines if line.startswith("predictor"))
    assert head == r"predictor & heading ($^\circ$) & MAE & coverage (\%) \\"
    row = {line.split(" & ")[0]: line for line in lines if line.endswith(r"\\")}
    # equal to three digits: both are best; the oracle is not in the contest
    assert r"& \textbf{0.140} &" in row["ukf"]
    assert r"& \textbf{0.140} &" in row[r"my\_own:Mine"]
    assert "textbf" not in row["oracle"] and "& 1.40 &" not in row["oracle"]
    assert r"{\scriptsize [0.126, 0.154]}" in table
    assert "mean over 2 seeds" in table and "oracle knows the true boat" in table
    assert r"\textbf" in recorded and "over that of persistence" in recorded
    assert r"Best in bold, of coverage what is nearest to 90\,\%. In brackets: 95\,\%" in table
    assert "Best in bold.}" in recorded  # two runs have no interval, and no coverage
    assert text.startswith("% usv-twin 1.2, sources abc\n% usv-twin benchmark --seeds 0-2\n")


def test_latex_is_balanced_and_each_line_has_all_columns():
    text = latex_text(results())
    assert text.count("{") == text.count("}")
    assert text.count(r"\begin{") == text.count(r"\end{") == 4
    for table in text.split(r"\begin{table}")[1:]:
        columns = table.split(r"\begin{tabular}{")[1].split("}")[0]
        body = table.split(r"\toprule")[1].split(r"\bottomrule")[0]
        for line in body.splitlines():
            if line.endswith(r"\\"):
                assert line.count(" & ") == len(columns) - 1


def test_latex_says_held_and_compiles_without_overfull_boxes(tmp_path):
    given = results()
    given["summary"] += [{**row, "plan": "hold"} for row in given["summary"]]
    given["summary"] += [
        {**row, "metric": metric}
        for metric in ("displacement_10s", "mse", "J")
        for row in given["summary"]
        if row["metric"] == "mae"
    ]
    text = latex_text(given)
    assert "commands held:" in text and "commands known:" in text and "commands hold" not in text
    if shutil.which("pdflatex") is None:
        pytest.skip("needs pdflatex")
    (tmp_path / "page.tex").write_text(
        "\\documentclass{article}\n\\usepackage{booktabs,graphicx}\n"
        f"\\begin{{document}}\n{text}\\end{{document}}\n"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert "Overfull" not in (tmp_path / "page.log").read_text(errors="replace")


def test_csv_has_every_value_with_its_interval():
    given = results()
    rows = list(csv.DictReader(io.StringIO(csv_text(given))))
    assert tuple(rows[0]) == CSV_COLUMNS
    assert len(rows) == len(given["summary"]) + len(given["recorded"])
    found = {(row["predictor"], row["metric"]): row for row in rows}
    mae = found["ukf", "mae"]
    assert float(mae["value"]) == 0.1404 and float(mae["low"]) == pytest.approx(0.9 * 0.1404)
    assert (mae["runs"], mae["best"]) == ("2", "true")
    assert found["oracle", "mae"]["best"] == "false"
    # the nearest to 0.9, not the largest
    assert found["my_own:Mine", "coverage90"]["best"] == "true"
    assert found["persistence", "coverage90"]["best"] == "false"
    assert found["ukf", "psi_10s"]["unit"] == "rad"
    assert found["ukf", "rmse_psi_10s_over_persistence"]["scenario"] == "lake"


def test_folders_without_persistence_have_their_errors_themselves():
    given = results()
    for row in given["recorded"]:
        row["rmse"] = row.pop("ratio")
    table = latex_text(given).split(r"\begin{table}")[-1]
    assert r"RMSE after 10\,s, mean over 2 runs" in table
    assert r"predictor & heading ($^\circ$) \\" in table
    assert rf"ukf & {math.degrees(0.1404):.2f} \\" in table
    found = {row["predictor"]: row for row in csv.DictReader(io.StringIO(csv_text(given)))}
    assert (found["ukf"]["metric"], found["ukf"]["unit"]) == ("rmse_psi_10s", "rad")
    assert float(found["ukf"]["value"]) == 0.1404


def test_one_predictor_is_never_the_best():
    given = results()
    given["summary"] = [row for row in given["summary"] if row["predictor"] in ("ukf", "oracle")]
    given["recorded"] = []
    assert "bold" not in latex_text(given)
    assert "true" not in csv_text(given)


def judged():
    """Return the results with a verdict, and with comparisons of simulated and recorded runs."""
    given = results()
    given["verdict"] = [
        {"predictor": name, "loss": loss, "runs": 6, "ratio": None if loss == "any" else mae}
        | {"position_m": 2.0 * mae, "position_m_low": mae, "position_m_high": 3.0 * mae}
        | {"heading_deg": mae, "heading_deg_low": None, "heading_deg_high": None}
        | {"mae": mae, "mse": mae, "plan": "hold", "scenarios": ["turn", "zigzag"]}
        | {"cases": {"none": ["none"], "any": ["gps10"], "all": ["none", "gps10"]}[loss]}
        for name, mae in MAE.items()
        for loss in ("none", "any", "all")
    ]
    pair = {**CELL, "plan": "known", "predictor": "my_own:Mine", "against": "ukf", "seeds": 6}
    pair |= {"change_percent": -12.5, "low": -20.0, "high": -3.0, "median_percent": -9.0, "wins": 5}
    given["paired"] = [pair]
    change = {"against": "ukf", "change_percent": 7.5, "change_low": 1.0, "change_high": 9.0}
    given["recorded"][2] |= {**change, "wins": 1}
    return given


def test_verdict_and_paired_tests_are_in_both_tables():
    found = {
        (row["scenario"], row["case"], row["metric"], row["predictor"]): row
        for row in csv.DictReader(io.StringIO(csv_text(judged())))
    }
    best = found["turn|zigzag", "none", "displacement_10s", "my_own:Mine"]
    assert (float(best["value"]), best["unit"], best["runs"]) == (0.2792, "m", "6")
    assert best["plan"] == "hold"
    heading = found["turn|zigzag", "none|gps10", "psi_10s", "my_own:Mine"]  # in rad, as others are
    assert math.degrees(float(heading["value"])) == pytest.approx(0.1396)
    change = found["turn", "gps10", "mae_change_against_ukf", "my_own:Mine"]
    assert [float(change[key]) for key in ("value", "low", "high", "median")] == [
        -12.5,
        -20,
        -3,
        -9,
    ]
    won = found["turn", "gps10", "mae_won_against_ukf", "my_own:Mine"]
    assert float(won["value"]) == pytest.approx(100.0 * 5 / 6) and won["unit"] == "%"
    recorded = found["lake", "none", "rmse_psi_10s_change_against_ukf", "my_own:Mine"]
    assert (float(recorded["value"]), float(recorded["high"])) == (7.5, 9.0)
    text = latex_text(judged())
    tables = text.split(r"\begin{table}")[1:]
    assert r"predictor & position (m) & position (m), loss & heading" in tables[0]
    assert r"\textbf{0.279}" in tables[0]
    assert "All scenarios (turn and zigzag, no loss and gps10, future commands held)" in tables[0]
    assert any(r"my\_own:Mine & -12.5 & 83.3 \\" in table for table in tables)
    assert any("lake" in table and r"my\_own:Mine & 7.50 & 50.0 \\" in table for table in tables)
    for name in ("MAE", "heading"):  # as the other tables have it, not as the results
        assert rf"predictor & {name}, change (\%) & {name}, won (\%) \\" in text
    assert text.count("{") == text.count("}")


@pytest.mark.parametrize(("changes", "best"), [((-12.5, 3.0), "-12.5"), ((8.0, 3.0), None)])
def test_what_loses_to_the_reference_is_not_the_best(changes, best):
    """The reference takes part in paired tests: it changes by 0 %, and wins half of the runs."""
    given = judged()
    (pair,) = given["paired"]
    given["recorded"] = []
    given["paired"] = [
        pair | {"predictor": name, "change_percent": change, "wins": 6 if change < 0.0 else 0}
        for name, change in zip(("var", "persistence"), changes, strict=True)
    ]
    table = latex_text(given).split(r"\begin{table}")[-1]
    bold = re.findall(r"textbf{([^}]*)}", table)
    assert bold == ([best, "100"] if best else [])
    marked = [row for row in csv.DictReader(io.StringIO(csv_text(given))) if "ukf" in row["metric"]]
    assert {row["best"] for row in marked} == ({"true", "false"} if best else {"false"})
