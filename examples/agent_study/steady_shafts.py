"""What a loss of GPS costs model-predictive control, by its use of the shafts and by its twin.

With a larger `effort` shaft speeds stay near the nominal one, where the twin knows the boat best.
The model `mmg` also knows how the resistance goes with speed, which `ukf` by itself does not.
"""

import argparse

import numpy as np
from bootstrap import interval, iqm

from twin.agents.controllers import make_controller
from twin.agents.evaluation import evaluate

CASES = (
    *(("ukf", effort, progress) for effort, progress in ((0.3, 1), (1, 1), (3, 1), (3, 0.5))),
    *(("ukf:model=mmg", effort, progress) for effort, progress in ((0.3, 1), (3, 0.5))),
)
"""Twin, and weights of model-predictive control; with the last ones it is ``mpc-steady``."""
WORLD = {"vessel_spread": 0.15, "wind_from_deg": "any", "current": "any", "sea": "0|2|4"}


def main(boats: int) -> None:
    """Sail as many boats in each case, and print the table."""
    seeds = range(730_000, 730_000 + boats)
    chosen = np.random.default_rng(0).integers(boats, size=(2000, boats))
    print("| twin | effort | progress | loss | off the path, m | less the first, 95 % |")
    print("|---|---|---|---|---|---|")
    for faults in ("none", "gps60"):
        first = None
        for twin, effort, progress in CASES:
            agent = make_controller("mpc-twin", effort=effort, progress=progress)
            rows = evaluate(
                agent, seeds=seeds, faults=faults, twin=twin, max_episode_steps=480,
                forecast_scores=False, **WORLD,
            )  # fmt: skip
            off = np.array([row["off_path_m"] for row in rows])
            first = off if first is None else first
            low, high = interval(iqm(off[chosen]) - iqm(first[chosen]))
            cells = f"{iqm(off):.2f} | {iqm(off) - iqm(first):+.2f} [{low:+.2f}, {high:+.2f}]"
            print(f"| `{twin}` | {effort} | {progress} | {faults} | {cells} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("boats", nargs="?", type=int, default=160)
    main(parser.parse_args().boats)
