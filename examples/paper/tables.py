"""Print the results of docs/explanation/paper.md from the rows of ``usv-twin paper``.

usv-twin paper --json examples/paper/rows.json
python examples/paper/tables.py examples/paper/rows.json
"""

import json
import sys
from pathlib import Path

from twin.benchmark.paper.experiment import WITHOUT_WINDOW
from twin.benchmark.paper.rows import PaperRow
from twin.benchmark.report import number

CASES = (("turn", "none"), ("turn", "gps10"), ("zigzag", "none"), ("zigzag", "gps10"))


def table_4(rows: list[PaperRow]) -> list[str]:
    """Return the MAE of each predictor, its interval, and the paper's number."""
    found = {row[1:5]: row for row in rows if row.table == "Table 4"}
    lines = [
        "| predictor | turn | turn, gps10 | zigzag | zigzag, gps10 |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(key[2] for key in found):
        cells = []
        for case in CASES:
            row = found[(*case, name, "MAE")]
            text = f"{number(row.ours)} [{number(row.low)}, {number(row.high)}]"
            cells.append(text if row.paper is None else f"{text} / {number(row.paper)}")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return lines


def window_alone(rows: list[PaperRow]) -> list[str]:
    """Return by how much the window changes the mean MAE, %."""
    mae = {row[1:4]: row.ours for row in rows if (row.table, row.metric) == ("Table 4", "MAE")}
    return [
        f"{name}: "
        + ", ".join(
            f"{' '.join(case)} {100.0 * (mae[(*case, name)] / mae[(*case, without)] - 1.0):+.0f} %"
            for case in CASES
        )
        for name, without in WITHOUT_WINDOW.items()
    ]


if __name__ == "__main__":
    rows = [PaperRow(**row) for row in json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))]
    print(*table_4(rows), "", *window_alone(rows), sep="\n")
