"""Markdown tables of the study of agents, from its results."""

import numpy as np


def markdown(results):
    """Return all tables of a study; docs/explanation/agents.md has a part of them."""
    lines = [f"# {results['task']}: {results['title']}", "", "## Over all losses", ""]
    lines += [*over_all_losses(results), "", "## Differences over all losses", ""]
    lines += [*differences(results, results["conditions"], faults="all"), ""]
    for condition, text in results["conditions"].items():
        lines += [f"## {condition}: {text}", "", *by_loss(results, condition), ""]
        lines += ["Agent less other, on the same episodes:", ""]
        losses = [*results["losses"], "all"]
        lines += [*differences(results, losses, condition=condition), ""]
    return "\n".join([*lines, "## Trainings", "", *trainings(results)]) + "\n"


def table(heads, rows):
    """Return the lines of a table."""
    cells = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(items)} |" for items in cells]


def grouped(rows, names, column, **where):
    """Return rows that are so, by the values of ``names`` and then by that of ``column``."""
    found = {}
    for row in rows:
        if all(row[key] == value for key, value in where.items()):
            found.setdefault(tuple(row[name] for name in names), {})[row[column]] = row
    return found


def with_ends(value, ends, sign=""):
    return f"{value:{sign}.2f} [{ends[0]:{sign}.2f}, {ends[1]:{sign}.2f}]"


def over_all_losses(results):
    """Return what agents are compared by over all losses, a column for each condition."""
    of, metric = grouped(results["cells"], ("agent",), "condition", faults="all"), results["metric"]
    rows = (
        [agent, *(f"{cell[metric]:.2f}" for cell in one.values())] for (agent,), one in of.items()
    )
    return table(["agent", *results["conditions"]], rows)


def by_loss(results, condition):
    """Return what agents are compared by in a condition, with 95 % intervals."""
    of = grouped(results["cells"], ("agent",), "faults", condition=condition)
    metric = results["metric"]
    rows = (
        [agent, *(with_ends(cell[metric], cell["ends"]) for cell in one.values())]
        for (agent,), one in of.items()
    )
    return table(["agent", *results["losses"], "all"], rows)


def differences(results, columns, **where):
    """Return differences of pairs on the same episodes, a column for each condition or loss."""
    column = "condition" if "faults" in where else "faults"
    of = grouped(results["paired"], ("agent", "against"), column, **where)
    rows = ([*pair, *(difference(one[name], results["better"]) for name in columns)]
            for pair, one in of.items())  # fmt: skip
    return table(["agent", "other", *columns], rows)


def difference(row, better):
    """Return a difference with its interval; it is called better or worse where clear of 0."""
    text = with_ends(row["difference"], (row["low"], row["high"]), "+")
    if row["low"] <= 0.0 <= row["high"]:
        return text
    return f"{text} {'better' if better * row['low'] > 0.0 else 'worse'}"


def trainings(results):
    """Return how long trainings took, and when they were at the level of a controller."""
    heads = ("agent", "decisions", "CPU, s", "end of the curve")
    heads += (f"runs at the level of {results['level_of']} ({results['level']:.2f})",)
    heads += ("after decisions", "after CPU, s")
    rows = []
    for agent in dict.fromkeys(row["agent"] for row in results["trainings"]):
        own = [row for row in results["trainings"] if row["agent"] == agent]
        there = [row for row in own if row["level_decisions"] is not None]
        row = [agent, str(own[0]["decisions"])]
        row += [spread([one["cpu_s"] for one in own]), spread([one["end"] for one in own], 2)]
        row += [f"{len(there)} of {len(own)}", spread([one["level_decisions"] for one in there])]
        rows.append([*row, spread([one["level_cpu_s"] for one in there])])
    return table(list(heads), rows)


def spread(values, digits=0):
    """Return median and range."""
    if not values:
        return "-"
    middle = f"{float(np.median(values)):.{digits}f}"
    return f"{middle} ({min(values):.{digits}f} to {max(values):.{digits}f})"
