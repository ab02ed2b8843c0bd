"""Print the tables of docs/explanation/agents.md from the results beside this file.

Run ``python examples/agent_study/tables.py``. ``usv-twin study --task path --out
examples/agent_study/path`` computes them, and the same with ``docking``.
"""

import json
from pathlib import Path

from twin.agents.study.report import digest


def main() -> None:
    for task in ("path", "docking"):
        path = Path(__file__).parent / task / "results.json"
        print(f"## {task}\n\n{digest(json.loads(path.read_text(encoding='utf-8')))}")


if __name__ == "__main__":
    main()
