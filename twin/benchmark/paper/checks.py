"""Validation of the twin: sigma points, Lyapunov exponents, and the models of the paper."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.integrate import solve_ivp

from twin.benchmark.paper.published import PAPER_TABLE_2, PAPER_TABLE_3, TABLE_4
from twin.channels import R, U, V
from twin.filters.ukf import scaled_weights
from twin.identification.lyapunov import rosenstein
from twin.model import dynamics
from twin.model.structure import N_TERMS, structure_of
from usv_gym.validation.study import DEGREE, SEPARATE, Array, Row, Section, Study, rows

__all__ = [
    "RATED",
    "paper_run",
    "twin_numbers",
]

RATED = 380.0 / 60.0

PAPER = structure_of("paper", 1.0, 1.0, 1.0)


def logistic(n: int, start: float = 0.4) -> Array:
    """Return n values of the logistic map with a gain of 4."""
    x = np.empty(n)
    x[0] = start
    for i in range(1, n):
        x[i] = 4.0 * x[i - 1] * (1.0 - x[i - 1])
    return x


def henon(n: int) -> Array:
    """Return n values of Henon's map after a transient of a hundred."""
    x = np.full(n + 100, 0.1)
    for i in range(2, n + 100):
        x[i] = 1.0 - 1.4 * x[i - 1] ** 2 + 0.3 * x[i - 2]
    return x[100:]


def paper_run(xi: Array, angle: float, seconds: float) -> tuple[float, Array]:
    """Simulate an identified model of the paper from 5 m/s at 380 rpm; return end time and state.

    ``xi`` (25,) is as in :data:`PAPER_TABLE_2`, the drive angle in rad. The run ends early at
    1000 m/s.
    """
    act, out, terms = np.array([RATED, RATED, angle, angle]), np.empty(6), np.empty(N_TERMS)
    model, calm = PAPER.terms, np.zeros(2)

    def move(_: float, s: Array) -> Array:
        dynamics.derivative(np.ascontiguousarray(s), xi, act, calm, model, terms, out)
        return out.copy()

    def fast(_: float, s: Array) -> float:
        return 1000.0 - float(np.hypot(s[U], s[V]))

    fast.terminal = True  # type: ignore[attr-defined]
    start = [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]
    run = solve_ivp(move, (0.0, seconds), start, events=fast, rtol=1e-8, atol=1e-8)
    return float(run.t[-1]), run.y[:, -1]


def twin_numbers(study: Study) -> Section:
    """Return sigma-point weights, Lyapunov exponents, and the identified models of the paper."""
    mean_0, cov_0, each = scaled_weights(6, 0.1, 2.0, -3.0)[1:]
    weights = [
        ("Merwe weights n = 6, alpha .1, beta 2, kappa -3: Wm0", float(mean_0), -199.0),
        ("Merwe weights: Wc0", float(cov_0), -196.01),
    ]
    exponents = [
        ("Rosenstein: logistic map, N = 500", rosenstein(logistic(500)), 0.69),
        ("Rosenstein: Henon map, N = 1000", rosenstein(henon(1000)), 0.418),
    ]
    merwe = "filterpy, MerweScaledSigmaPoints"
    found = [
        *rows(weights, merwe, 1e-9),
        *rows([("Merwe weights: Wi", float(each), 50.0 / 3.0)], merwe, 1e-9, digits=6),
        *rows(exponents, "Rosenstein 1993", 0.03, "absolute"),
        _nolds_row(),
    ]
    for table, name, speed in ((PAPER_TABLE_2, "2", 5.58), (PAPER_TABLE_3, "3", 7.76)):
        ahead = np.where(np.arange(len(table)) < PAPER.blocks["surge"][1], table, 0.0)
        state = paper_run(ahead, 0.0, 200.0)[1]
        found += rows(
            [(f"Table {name} model: straight speed, m/s", state[U], speed)], SEPARATE, 1e-3
        )
    end = paper_run(PAPER_TABLE_2, 20.0 * DEGREE, 30.0)[0]
    escape = [("Table 2 model, 20 deg: escapes at, s", end, 7.3)]
    found += rows(escape, SEPARATE, 0.2, "absolute", 3)
    for angle, u, r in ((20.0, 10.35, 4.26), (-20.0, 11.51, -2.23)):
        state = paper_run(PAPER_TABLE_3, angle * DEGREE, 300.0)[1]
        steady = [
            (f"Table 3 model, {angle:+g} deg: u, m/s", state[U], u),
            (f"Table 3 model, {angle:+g} deg: r, deg/s", state[R] / DEGREE, r),
        ]
        found += rows(steady, SEPARATE, 0.01)
    reported = [
        (f"paper's Table 4, {scenario}: {metric} of {method}", None, want)
        for scenario, triples in TABLE_4.items()
        for method, pair in triples.items()
        for metric, want in zip(("MAE", "MSE"), pair, strict=True)
    ]
    found += rows(reported, "Qu et al. 2025")
    return Section(
        "The twin",
        "Weights of the sigma points, Lyapunov exponents of maps with known exponents, and the two "
        "identified models of Qu et al. 2025. The model of their Table 2 diverges in the turn that "
        "it was identified from, so it cannot have made their predictions alone. The errors of "
        "Table 4 mix units and belong to runs that are not public; they are listed for reference "
        "and not computed. The benchmark reports the errors of this twin.",
        tuple(found),
    )


def _nolds_row() -> Row:
    """Return the largest difference from nolds; skipped without it."""
    item = "Rosenstein against nolds (emb 2, lag 1, tsep 1, K 5, fit poly)"
    source, skipped, worst = "nolds 0.6.1", "", None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of its own imports
            import nolds
    except Exception:  # some releases fail on import
        skipped = "nolds cannot be imported"
    else:
        rng, worst = np.random.default_rng(5), 0.0
        for n in (15, 30, 200):
            series = rng.normal(size=n)
            want = nolds.lyap_r(series, emb_dim=2, lag=1, min_tsep=1, trajectory_len=5, fit="poly")
            worst = max(worst, abs(rosenstein(series) - float(want)))
    return Row(item, worst, 0.0, 1e-12, source, "below", skipped=skipped)
