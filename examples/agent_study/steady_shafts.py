"""How far off the path does model-predictive control sail, by how steady it keeps its shafts?

With `effort`, a weight of model-predictive control, shaft speeds stay near the nominal one. A loss
of GPS of 60 s shows what that is worth: python examples/agent_study/steady_shafts.py [boats]
"""

import sys

import numpy as np

from twin.agents.controllers import make_controller
from twin.agents.evaluation import evaluate
from twin.agents.study.statistics import interval, iqm

EFFORTS = 0.3, 1.0, 3.0
WORLD = {"vessel_spread": 0.15, "wind_from_deg": "any", "current": "any", "sea": "0|2|4"}


def main(boats: int) -> None:
    """Sail as many boats with each weight, and print the table."""
    seeds = range(730_000, 730_000 + boats)
    chosen = np.random.default_rng(0).integers(boats, size=(2000, boats))
    print("| effort | loss | off the path, m | less that of 0.3, with its 95 % interval |")
    print("|---|---|---|---|")
    for faults in ("none", "gps60"):
        first = None
        for effort in EFFORTS:
            agent = make_controller("mpc-twin", effort=effort)
            rows = evaluate(
                agent, seeds=seeds, faults=faults, max_episode_steps=480, forecast_scores=False,
                **WORLD,
            )  # fmt: skip
            off = np.array([row["off_path_m"] for row in rows])
            first = off if first is None else first
            low, high = interval(iqm(off[chosen]) - iqm(first[chosen]))
            change = iqm(off) - iqm(first)
            cells = f"{iqm(off):.2f} | {change:+.2f} [{low:+.2f}, {high:+.2f}]"
            print(f"| {effort} | {faults} | {cells} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 160)
