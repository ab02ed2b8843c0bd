"""The verdict: what it averages, its order, and its sentence."""

from __future__ import annotations

import math

import pytest

from twin.benchmark.protocol import Settings
from twin.benchmark.verdict.summary import best_first, recorded_blocks, sentence_of, verdict_rows

SETTINGS = Settings(plans=("known", "hold"), predictors=("persistence", "ukf", "oracle"))

ERRORS = {"persistence": 8.0, "ukf": 2.0, "var": 1.0, "oracle": 0.5}


def runs(predictors=tuple(ERRORS), seeds=4):
    rows = []
    for predictor in predictors:
        for fault in ("none", "gps10"):
            for seed in range(seeds):
                size = ERRORS[predictor] * (1.5 if fault == "gps10" else 1.0) * (1 + seed)
                row = {"scenario": "turn", "case": fault, "fault": fault, "sea": "2"}
                row |= {"grade": "typical", "seed": seed, "predictor": predictor, "plan": "known"}
                row |= {"displacement_10s": size, "psi_10s": math.radians(size)}
                rows.append(row | {"mae": 0.1 * size, "mse": 0.01 * size})
    return rows


def test_verdict_is_the_mean_over_boats_best_first():
    rows = verdict_rows([*runs(), {**runs()[0], "plan": "hold", "mae": 1e9}], SETTINGS)
    assert list(dict.fromkeys(row["predictor"] for row in rows)) == [
        *("var", "ukf", "persistence"),
        "oracle",  # knows the true boat, and takes no part
    ]
    of = {row["loss"]: row for row in rows if row["predictor"] == "ukf"}
    assert of["none"]["position_m"] == pytest.approx(5.0)
    assert of["any"]["heading_deg"] == pytest.approx(7.5)
    assert of["all"]["mae"] == pytest.approx(0.625) and of["all"]["mse"] == pytest.approx(0.0625)
    assert of["none"]["ratio"] == pytest.approx(0.25)
    assert of["none"]["position_m_low"] < 5.0 < of["none"]["position_m_high"]
    assert of["none"]["cases"] == ["none"] and of["any"]["cases"] == ["gps10"]
    assert (of["all"]["runs"], of["all"]["next"], of["all"]["wins"]) == (8, "persistence", 8)


def test_other_seas_are_left_out_of_the_verdict():
    rough = [{**row, "sea": "4", "displacement_10s": 1e3} for row in runs()]
    assert verdict_rows([*runs(), *rough], SETTINGS) == verdict_rows(runs(), SETTINGS)
    assert verdict_rows(rough, SETTINGS)[0]["position_m"] == 1e3


def test_sentence_names_metres_degrees_ratio_and_the_next():
    text = sentence_of(verdict_rows(runs(), SETTINGS))
    for part in ("var", "2.50 m", "2.5 deg", "3.75 m", "0.12 [0.12, 0.12]", "ukf", "8 of 8"):
        assert part in text
    assert "(turn, no loss and gps10, future commands known)" in text
    held = Settings(plans=("hold",), predictors=("persistence", "ukf"))
    rows = [{**row, "plan": "hold"} for row in runs()]
    assert "(turn, no loss and gps10, future commands held)" in sentence_of(
        verdict_rows(rows, held)
    )
    alone = sentence_of(verdict_rows(runs(("ukf",), seeds=1), SETTINGS))
    assert "ukf" in alone and "persistence" not in alone and "next" not in alone
    assert sentence_of([]) == ""


def test_verdict_without_persistence_has_no_ratio():
    rows = verdict_rows(runs(("var", "ukf")), SETTINGS)
    assert {row["ratio"] for row in rows} == {None}
    assert [row["predictor"] for row in rows][::3] == ["var", "ukf"]


def test_recorded_blocks_hold_the_first_plan_and_the_ends_of_losses():
    rows = [
        {"folder": "pond", "fault": "gps10", "plan": plan, "predictor": name, "channel": channel}
        | {"runs": 3, "error": error, "ratio": error / 4.0}
        for plan in ("known", "hold")
        for name, error in (("persistence", 4.0), ("ukf", 1.0))
        for channel in ("displacement", "psi")
    ]
    end = {"folder": "pond", "fault": "gps10", "predictor": "ukf", "error_m": 2.0}
    blocks = recorded_blocks({"recorded": rows, "losses": [end]})
    assert list(blocks) == ["folder pond: 3 runs, loss gps10, plan known"]
    (block,) = blocks.values()
    assert best_first(block) == ["ukf", "persistence"]
    assert block["ukf"]["loss"]["error_m"] == 2.0 and not block["persistence"]["loss"]
    lake = [row | {"folder": "lake", "runs": 1} for row in rows]
    titles = list(recorded_blocks({"recorded": rows + lake, "losses": []}))
    assert [title.split(",")[0] for title in titles] == [
        "folder pond: 3 of 4 runs",
        "folder lake: 1 of 4 runs",
    ]
