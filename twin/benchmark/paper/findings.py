"""What of the paper reproduces and what does not, in three sentences from what was measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.benchmark.metrics import compare
from twin.benchmark.paper.experiment import WITHOUT_WINDOW
from twin.benchmark.paper.rows import PaperRow
from twin.benchmark.verdict.tables import number
from twin.identification.dynamic_window import GAMMA_NONLINEARITY

__all__ = [
    "Contest",
    "contests",
    "findings",
]

INERT_ROWS, INERT_SHARE = 1.0, 0.05
"""The index V is inert if it adds fewer rows than this, and changes W in less of the time."""

CAP_INDEX = 1.0 / GAMMA_NONLINEARITY
"""Index S from which Eq 40 asks for w_r = w, the cap."""

MOSTLY = 0.5
"""The window sits at its cap if it is there for more of the time."""

FORMS = {"dsw-ukf:printed": "as printed", "dsw-ukf": "as mended"}


class Contest(NamedTuple):
    """The paper's method against the same filter without its window, on the same runs."""

    scenario: str
    fault: str
    predictor: str
    change: float  # of the MAE by the window, %
    low: float | None  # its 95 % interval
    high: float | None
    wins: int
    seeds: int


def contests(runs: Sequence[dict[str, Any]]) -> list[Contest]:
    """Return what the window alone changes, for each scenario and fault.

    Parameters
    ----------
    runs : sequence of dict
        From :func:`twin.benchmark.metrics.run_rows`.
    """
    found = []
    for name, without in WITHOUT_WINDOW.items():
        both = [row for row in runs if row["predictor"] in (name, without)]
        found += [
            Contest(
                row["scenario"],
                row["fault"],
                name,
                row["change_percent"],
                row["low"],
                row["high"],
                row["wins"],
                row["seeds"],
            )
            for row in compare(both, without)
            if row["predictor"] == name
        ]
    return found


def findings(rows: Sequence[PaperRow], found: Sequence[Contest]) -> list[str]:
    """Return the three sentences: the order of Table 4, the index V, the window at its cap.

    Parameters
    ----------
    rows : sequence of PaperRow
        From :func:`twin.benchmark.paper.rows.paper_rows`; a sentence without its rows is left out.
    found : sequence of Contest
        From :func:`contests`.
    """
    sentences = (_order(rows, found), _environment(rows), _cap(rows))
    return [sentence for sentence in sentences if sentence]


def _order(rows: Sequence[PaperRow], found: Sequence[Contest]) -> str:
    """Return the sentence on the order of Table 4."""
    mae = {
        (row.scenario, row.fault, row.predictor): row.ours
        for row in rows
        if (row.table, row.metric) == ("Table 4", "MAE")
    }
    with_lstm = any(key[2] == "lstm" for key in mae)
    counts: list[str] = []
    pairs: list[tuple[bool, bool]] = []  # DSW-UKF before UKF, and UKF before LSTM
    for name, without in WITHOUT_WINDOW.items():
        own = [
            (
                mae[key] < mae[(*key[:2], without)],
                mae[(*key[:2], without)] < mae.get((*key[:2], "lstm"), math.inf),
            )
            for key in mae
            if key[2] == name and (*key[:2], without) in mae
        ]
        if own:
            counts.append(f"{sum(map(all, own))} of {len(own)} cases {FORMS[name]}")
            pairs += own
    if not pairs:
        return ""
    first, second = (sum(one) for one in zip(*pairs, strict=True))
    lstm = f", UKF before LSTM in {second}" if with_lstm else ""
    changes = [contest.change for contest in found]
    sure = sum(
        contest.low is not None
        and contest.high is not None
        and (contest.high < 0.0 or contest.low > 0.0)
        for contest in found
    )
    with_intervals = any(contest.low is not None for contest in found)
    among = f", in {sure} of {len(found)} cases with a 95 % interval without zero"
    order = f"DSW-UKF before UKF{' before LSTM' if with_lstm else ''}"
    verdict = _verdict(sum(map(all, pairs)) / len(pairs))
    return (
        f"The order of Table 4 ({order}) {verdict}: it holds in {' and '.join(counts)}. Of all "
        f"{len(pairs)}, DSW-UKF is before UKF in {first}{lstm}; the window alone, all else equal, "
        f"changes the MAE by {min(changes):+.0f} to {max(changes):+.0f} %"
        f"{among if with_intervals else ''}."
    )


def _verdict(share: float) -> str:
    """Return what a share of cases means."""
    if share == 1.0:
        return "reproduces"
    return "does not reproduce" if share < MOSTLY else "reproduces in part"


def _values(rows: Sequence[PaperRow], metric: str) -> dict[str, list[float]]:
    """Return the means of one metric of Algorithm 1, by predictor."""
    values: dict[str, list[float]] = {}
    for row in rows:
        if (row.table, row.metric) == ("Algorithm 1", metric) and math.isfinite(row.ours):
            values.setdefault(row.predictor, []).append(row.ours)
    return values


def _environment(rows: Sequence[PaperRow]) -> str:
    """Return the sentence on the index of the environment."""
    means = [v for part in _values(rows, "rows that V adds, mean").values() for v in part]
    largest = [v for part in _values(rows, "rows that V adds, largest").values() for v in part]
    changed = [v for part in _values(rows, "V changes W, share of time").values() for v in part]
    if not means:
        return ""
    inert = np.mean(means) < INERT_ROWS and max(changed) < INERT_SHARE
    return (
        f"The environment index of Eq 37 {'is inert' if inert else 'acts'} in this steady sea: it "
        f"adds {np.mean(means):.1f} rows to the window on average, {max(largest):.1f} at the peak "
        f"of a run, and without it the window would have another length in "
        f"{f'up to {100.0 * max(changed):.1f} %' if max(changed) > 0.0 else '0 %'} of the time."
    )


def _cap(rows: Sequence[PaperRow]) -> str:
    """Return the sentence on the window at its cap."""
    shares = _values(rows, "W at its cap, share of time")
    if not shares:
        return ""
    parts = [
        f"{100.0 * np.mean(values):.0f} % of the time {FORMS[name]}"
        for name, values in shares.items()
        if name in FORMS
    ]
    every = [v for values in shares.values() for v in values]
    verdict = "sits at its cap" if np.mean(every) > MOSTLY else "moves between base and cap"
    caps = [v for values in _values(rows, "cap of W, rows").values() for v in values]
    medians = [v for values in _values(rows, "S, median").values() for v in values]
    return (
        f"The dynamic window {verdict} of {max(caps):.0f} rows: it is there {' and '.join(parts)}, "
        f"as the median of its index S is {_range(medians)}, where {CAP_INDEX:g} is enough."
    )


def _range(values: Sequence[float]) -> str:
    """Return the smallest and the largest of values, as the page's tables print them."""
    low, high = number(min(values)), number(max(values))
    if low == high:
        return low
    return f"{low} to {high}, by manoeuvre and form of the method"
