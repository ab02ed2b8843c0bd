"""The rows of the paper redone, and what follows from them in three sentences.

A row is a number measured here beside the one that the paper prints.
"""

import math
from typing import NamedTuple

import numpy as np
import published

from twin.benchmark.metrics import compare, interval_of, resampled, run_rows
from twin.benchmark.protocol import HORIZONS
from twin.benchmark.verdict.tables import number
from twin.identification.dynamic_window import GAMMA_ENVIRONMENT, GAMMA_NONLINEARITY, variable_part
from twin.model.structure import structure_of

METHODS = {
    "dsw-ukf:printed": "DSW-UKF",
    "dsw-ukf:printed,window=off": "UKF",
    "dsw-ukf": "DSW-UKF",
    "dsw-ukf:window=off": "UKF",
    "lstm": "LSTM",
}
"""The paper's name of each predictor that stands for a row of its Table 4."""

WITHOUT_WINDOW = {"dsw-ukf:printed": "dsw-ukf:printed,window=off", "dsw-ukf": "dsw-ukf:window=off"}
"""The paper's method as printed and as mended, and each without its window, all else equal."""

FORMS = {"dsw-ukf:printed": "as printed", "dsw-ukf": "as mended"}

CAP_INDEX = 1.0 / GAMMA_NONLINEARITY
"""Index S from which Eq 40 asks for w_r = w, the cap."""

SETTLED_SHARE = 0.1
"""A parameter has settled once it stays this share of its largest excursion from its end value."""

INERT_ROWS = 1.0
INERT_SHARE = 0.05
"""The index V is inert if it adds fewer rows, and changes W in less than this share of the time."""

STRUCTURE = structure_of("paper", 1.0, 1.0, 1.0)
"""The paper's model, for the names and equations of its parameters."""


class Trace(NamedTuple):
    """A filter of the paper along a run, once a second."""

    t: np.ndarray  # s
    params: np.ndarray  # (n, 25) parameters
    window: np.ndarray  # length of the window, rows
    V: np.ndarray  # index of the environment; NaN before the first adjustment
    S: np.ndarray  # index of the nonlinearity
    short_period: np.ndarray  # whether the period was T0 / 2
    lateral: np.ndarray  # whether the lateral acceleration was above its limit since the row before
    base: int  # fixed part of the window, rows
    cap: int  # largest variable part, rows

    def at(self, seconds):
        """Return the parameters (25,) at a time."""
        return self.params[np.abs(self.t - seconds).argmin()]


class PaperRow(NamedTuple):
    """One number of the paper's, or beside it: mean over seeds, with a 95 % interval."""

    table: str  # table, figure or algorithm of the paper
    scenario: str
    fault: str
    predictor: str
    metric: str
    ours: float
    low: float
    high: float
    paper: float | None  # None where the paper prints none


def _row(where, metric, values, paper=None):
    """Return the row of the values of all seeds; ``where`` are the first four fields."""
    values = np.asarray(values, dtype=np.float64)
    interval = interval_of(resampled(values), len(values))
    return PaperRow(*where, metric, float(values.mean()), *interval, paper)


def paper_rows(settings, results, traces):
    """Return all rows, in the paper's order.

    ``results`` are those of the benchmark's runner, ``traces`` map (scenario, predictor) to
    :class:`Trace` tuples; both are ordered by seed.
    """
    rows, identify_s = [], settings.identify_s
    for (scenario, name), parts in traces.items():
        rows += _parameters(scenario, name, parts, identify_s)
    rows += _table_4(results)
    for scenario in settings.scenarios:
        for (sailed, name), parts in traces.items():
            if sailed == scenario:
                rows += _figures(scenario, name, parts, identify_s)
        rows += _predictions(scenario, results)
    for (scenario, name), parts in traces.items():
        if parts[0].window.any():
            rows += _algorithm(scenario, name, parts)
    return rows


def _parameters(scenario, name, parts, identify_s):
    """Yield Table 2 or 3: the parameters at the end of the identification."""
    table, numbers = published.TABLES[scenario]
    where = table, scenario, "none", name
    found = np.array([part.at(identify_s) for part in parts])
    for parameter, values, paper in zip(STRUCTURE.parameters, found.T, numbers, strict=True):
        yield _row(where, parameter, values, float(paper))
    same = (np.sign(found) == np.sign(numbers)).mean(axis=1)
    yield _row(where, "share with the paper's sign", same)


def _table_4(results):
    """Yield Table 4: MAE and MSE, pooled over channels and horizons."""
    groups = {}
    for row in run_rows(results):
        groups.setdefault((row["scenario"], row["fault"], row["predictor"]), []).append(row)
    for (scenario, fault, name), members in groups.items():
        papers = published.TABLE_4[scenario].get(METHODS.get(name), (None, None))
        for metric, paper in zip(("mae", "mse"), papers, strict=True):
            where = "Table 4", scenario, fault, name
            yield _row(where, metric.upper(), [row[metric] for row in members], paper)


def _figures(scenario, name, parts, identify_s):
    """Yield what Figures 9 to 11 and 13 to 15 show: when the parameters settled, and whether."""
    for motion, figure in published.FIGURES[scenario].items():
        block = slice(*STRUCTURE.blocks[motion])
        where = figure, scenario, "none", name
        iterations = published.SETTLED_ITERATIONS.get(figure)
        paper = None if iterations is None else iterations / published.ITERATIONS * identify_s
        settled = [_settled(part, block, identify_s) for part in parts]
        yield _row(where, "settled at, s", settled, paper)
        later = [
            float(np.median(np.abs(part.params[-1] / part.at(identify_s) - 1.0)[block]))
            for part in parts
        ]
        yield _row(where, f"change after {identify_s:g} s, share", later)


def _settled(part, block, identify_s):
    """Return when the last parameter of an equation came to stay near its end value, s."""
    before = part.t <= identify_s + 1e-9
    history = part.params[before, block]
    away = np.abs(history - history[-1])
    outside = np.flatnonzero((away > SETTLED_SHARE * away.max(axis=0)).any(axis=1))
    return float(part.t[before][outside[-1] + 1 if len(outside) else 0])


def _predictions(scenario, results):
    """Yield what Figures 12 and 16 show: errors of each channel after 10 s."""
    groups = {}
    for result in results:
        unit = result["unit"]
        if unit["scenario"] == scenario:
            for channel, values in result["plans"]["known"]["channels"].items():
                key = unit["fault"], unit["predictor"], channel
                groups.setdefault(key, []).append(values["mae"][-1])
    for (fault, name, channel), values in groups.items():
        where = published.PREDICTION_FIGURES[scenario], scenario, fault, name
        yield _row(where, f"MAE of {channel} after {HORIZONS[-1]:g} s", values)


def window_shares(part):
    """Return what the window of Algorithm 1 did along a run, by metric.

    "V changes W": share of the time in which the window without the index of the environment
    would have another length.
    """
    known = ~np.isnan(part.V) & ~np.isnan(part.S)
    V, S = (part.V[known], part.S[known]) if known.any() else np.full((2, 1), math.nan)
    added = part.base * GAMMA_ENVIRONMENT * V
    changed = [
        variable_part(v, s, part.base, part.cap) != variable_part(0.0, s, part.base, part.cap)
        for v, s in zip(part.V[known], part.S[known], strict=True)
    ]
    return {
        "W, mean, rows": float(part.window.mean()),
        "cap of W, rows": float(part.base + part.cap),
        "W at its cap, share of time": float((part.window >= part.base + part.cap).mean()),
        "W at its base, share of time": float((part.window <= part.base).mean()),
        "V, mean": float(V.mean()),
        "rows that V adds, mean": float(added.mean()),
        "rows that V adds, largest": float(added.max()),
        "V changes W, share of time": float(np.mean(changed)) if changed else math.nan,
        "S, median": float(np.median(S)),
        "period T0/2, share of time": float(part.short_period.mean()),
        "lateral rule, share of time": float(part.lateral.mean()),
    }


def _algorithm(scenario, name, parts):
    """Yield what Algorithm 1 did over time."""
    shares = [window_shares(part) for part in parts]
    for metric in shares[0]:
        # a run too short for an adjustment has no index
        values = [share[metric] for share in shares if math.isfinite(share[metric])]
        if values:
            yield _row(("Algorithm 1", scenario, "none", name), metric, values)


def contests(results):
    """Return what the window alone changes: rows of the benchmark's paired comparison."""
    runs = run_rows(results)
    return [
        row
        for name, without in WITHOUT_WINDOW.items()
        for row in compare([run for run in runs if run["predictor"] in (name, without)], without)
        if row["predictor"] == name
    ]


def findings(rows, found):
    """Return the three sentences: the order of Table 4, the index V, the window at its cap.

    ``rows`` are from :func:`paper_rows`, ``found`` from :func:`contests`. A sentence without its
    rows is left out.
    """
    sentences = _order(rows, found), _environment(rows), _cap(rows)
    return [sentence for sentence in sentences if sentence]


def _order(rows, found):
    """Return the sentence on the order of Table 4."""
    mae = {row[1:4]: row.ours for row in rows if (row.table, row.metric) == ("Table 4", "MAE")}
    cases = [case for *case, name in mae if name == "lstm"]  # needs torch
    if not cases or not found:
        return ""
    counts, pairs = [], []  # pairs: DSW-UKF before UKF, and UKF before LSTM
    for name, without in WITHOUT_WINDOW.items():
        for case in cases:
            ukf = mae[(*case, without)]
            pairs.append((mae[(*case, name)] < ukf, ukf < mae[(*case, "lstm")]))
        held = sum(map(all, pairs[-len(cases) :]))
        counts.append(f"{held} of {len(cases)} cases {FORMS[name]}")
    share = np.mean([all(pair) for pair in pairs])
    verdict = "reproduces in part" if share >= 0.5 else "does not reproduce"
    first, second = np.sum(pairs, axis=0)
    changes = [row["change_percent"] for row in found]
    sure = sum(row["high"] < 0.0 or row["low"] > 0.0 for row in found)
    return (
        "The order of Table 4 (DSW-UKF before UKF before LSTM) "
        f"{'reproduces' if share == 1.0 else verdict}: it holds in {' and '.join(counts)}. Of all "
        f"{len(pairs)}, DSW-UKF is before UKF in {first}, UKF before LSTM in {second}; the window "
        f"alone, all else equal, changes the MAE by {min(changes):+.0f} to {max(changes):+.0f} %"
        f", in {sure} of {len(found)} cases with a 95 % interval without zero."
    )


def _values(rows, metric, predictors=tuple(FORMS)):
    """Return the means of one metric of Algorithm 1."""
    return [row.ours for row in rows if row.metric == metric and row.predictor in predictors]


def _environment(rows):
    """Return the sentence on the index of the environment."""
    means = _values(rows, "rows that V adds, mean")
    largest = _values(rows, "rows that V adds, largest")
    changed = _values(rows, "V changes W, share of time")
    if not means:
        return ""
    inert = np.mean(means) < INERT_ROWS and max(changed) < INERT_SHARE
    share = f"up to {100.0 * max(changed):.1f} %" if max(changed) > 0.0 else "0 %"
    return (
        f"The environment index of Eq 37 {'is inert' if inert else 'acts'} in this steady sea: it "
        f"adds {np.mean(means):.1f} rows to the window on average, {max(largest):.1f} at the peak "
        f"of a run, and without it the window would have another length in {share} of the time."
    )


def _cap(rows):
    """Return the sentence on the window at its cap."""
    metric = "W at its cap, share of time"
    shares = {form: _values(rows, metric, (name,)) for name, form in FORMS.items()}
    parts = [f"{100.0 * np.mean(v):.0f} % of the time {form}" for form, v in shares.items() if v]
    if not parts:
        return ""
    often = np.mean(_values(rows, metric)) > 0.5
    medians = _values(rows, "S, median")
    low, high = number(min(medians)), number(max(medians))
    between = f"{low} to {high}, by manoeuvre and form of the method"
    return (
        f"The dynamic window {'sits at its cap' if often else 'moves between base and cap'} of "
        f"{max(_values(rows, 'cap of W, rows')):.0f} rows: it is there {' and '.join(parts)}, as "
        f"the median of its index S is {low if low == high else between}, where {CAP_INDEX:g} is "
        "enough."
    )
