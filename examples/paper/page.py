"""``paper.md`` and its pictures: the paper's tables and figures beside those of this package."""

from findings import FORMS, STRUCTURE
from matplotlib.figure import Figure
from published import FIGURES, PREDICTION_FIGURES, TABLES

from twin.benchmark.verdict.tables import number
from twin.identification.dynamic_window import GAMMA_ENVIRONMENT

CASES = (("turn", "none"), ("turn", "gps10"), ("zigzag", "none"), ("zigzag", "gps10"))

NOTE = """Simulated boats of 7.5 m sail the manoeuvres of the paper in sea state 2, another boat and
sea for each seed: compare signs, sizes and the order, not digits. gps10 is a loss of GPS of 10 s;
the paper says that its runs had losses, not which. docs/explanation/paper.md says what each
predictor is. A cell has the mean over seeds, [its 95 % interval], and / the paper's number."""


def cell(row):
    """Return ours, its interval and the paper's number; a dash without a row."""
    if row is None:
        return "-"
    text = f"{number(row.ours)} [{number(row.low)}, {number(row.high)}]"
    return text if row.paper is None else f"{text} / {number(row.paper)}"


def table(heads, lines):
    """Return a Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (heads, ["---"] * len(heads), *lines))


def table_4(rows, metric):
    """Return Table 4 of one metric: a line for each predictor, a column for each run and fault."""
    found = {row[1:4]: row for row in rows if (row.table, row.metric) == ("Table 4", metric)}
    heads = [f"{a}{'' if b == 'none' else f', {b}'}" for a, b in CASES]
    return table(
        ["predictor", *heads],
        [
            [f"`{name}`", *(cell(found.get((*case, name))) for case in CASES)]
            for name in dict.fromkeys(key[2] for key in found)
        ],
    )


def window_alone(found):
    """Return what the window alone changes of the MAE, %; below 0 it helps."""
    lines = [
        [
            *(row["scenario"], row["fault"], FORMS[row["predictor"]]),
            f"{row['change_percent']:+.0f} [{row['low']:+.0f}, {row['high']:+.0f}]",
            f"{row['wins']} of {row['seeds']}",
        ]
        for row in found
    ]
    return table(["scenario", "fault", "method", "change of MAE, %", "better"], lines)


def by_predictor(rows, tables):
    """Return the rows of some tables: a line for each number, a column for each predictor."""
    found = {(*row[:2], row.metric, row.predictor): row for row in rows if row.table in tables}
    names = list(dict.fromkeys(key[3] for key in found))
    keys = dict.fromkeys(key[:3] for key in found)
    lines = [[*key, *(cell(found.get((*key, name))) for name in names)] for key in keys]
    return table(["in the paper", "scenario", "", *(f"`{name}`" for name in names)], lines)


def draw_window(scenario, parts, identify_s):
    """Return a picture of the window of Algorithm 1 over time, and of its two indices."""
    fig = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = fig.subplots(3, 1, sharex=True)
    for name, part in parts.items():
        axes[0].step(part.t, part.window, where="post", label=name)
        axes[1].step(part.t, part.base * GAMMA_ENVIRONMENT * part.V, where="post")
        axes[2].step(part.t, part.S, where="post")
    for ax, text in zip(axes, ("W, rows", "rows that V adds", "S"), strict=True):
        ax.set_ylabel(text)
        ax.axvline(identify_s, color="k", ls="--")
    axes[2].set(yscale="log", xlabel="time, s; dashed: the first forecast")
    axes[0].set_title(f"Algorithm 1 in the {scenario}")
    axes[0].legend()
    return fig


def draw_parameters(scenario, name, part, identify_s):
    """Return a picture of the parameters over time by equation (Figures 9 to 11, 13 to 15)."""
    fig = Figure(figsize=(9.0, 8.0), layout="constrained")
    axes = fig.subplots(3, 1, sharex=True)
    for ax, (motion, figure) in zip(axes, FIGURES[scenario].items(), strict=True):
        for k in range(*STRUCTURE.blocks[motion]):
            ax.plot(part.t, part.params[:, k], label=STRUCTURE.parameters[k])
        ax.axvline(identify_s, color="k", ls="--")
        ax.set_title(f"compare {figure}: {motion}, {name}")
        ax.legend(fontsize="x-small", ncols=2, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes[-1].set_xlabel("time, s; dashed: the first forecast")
    return fig


def draw_forecast(scenario, examples, truth):
    """Return a picture of the first forecasts by predictor, and the truth (Figures 12 and 16)."""
    fig = Figure(figsize=(9.0, 5.0), layout="constrained")
    fig.suptitle(f"compare {PREDICTION_FIGURES[scenario]}: {scenario}")
    t = next(iter(examples.values()))["t"]
    shown = (truth.t >= t[0]) & (truth.t <= t[-1])
    names = ("north, m", "east, m", "heading, rad", "u, m/s", "v, m/s", "r, rad/s")
    for k, (ax, channel) in enumerate(zip(fig.subplots(2, 3).flat, names, strict=True)):
        ax.plot(truth.t[shown], truth.truth[shown, k], "k", label="truth")
        for name, example in examples.items():
            ax.plot(example["t"], [state[k] for state in example["mean"]], label=name)
        ax.set(ylabel=channel, xlabel="time, s")
    fig.axes[0].legend(fontsize="x-small")
    return fig


def write_page(out, rows, sentences, found, pictures):
    """Write the page and its pictures, a figure by file name, to a folder; return its path."""
    shown = {}
    for name, fig in pictures.items():
        fig.savefig(out / f"{name}.png", dpi=120)
        shown[name] = f"![{name}]({name}.png)"
    figures = [figure for motions in FIGURES.values() for figure in motions.values()]
    settled = (
        "Settled: from when on every parameter of an equation stays within a tenth of its largest "
        "excursion from its value at the first forecast. Change: median over the parameters from "
        "there to the end of the run."
    )
    parts = [
        "# Qu et al. 2025, redone",
        *sentences,
        NOTE,
        *("## Table 4: MAE", table_4(rows, "MAE"), "## Table 4: MSE", table_4(rows, "MSE")),
        *("## The window alone", window_alone(found)),
        *("## Algorithm 1", by_predictor(rows, ["Algorithm 1"])),
        *("## Tables 2 and 3", by_predictor(rows, [name for name, _ in TABLES.values()])),
        *("## Figures 9 to 11 and 13 to 15", settled, by_predictor(rows, figures)),
        *("## Pictures", *shown.values()),
    ]
    path = out / "paper.md"
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path
