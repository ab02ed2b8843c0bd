"""Put scores of forecasts into the study's results and tables, without training again.

They come from the shipped policies and the controllers, each a run of the study:

    P=examples/gps_loss_study/policies
    usv-twin evaluate los los-twin mpc-twin $P/ppo-twin.npz $P/ppo-raw.npz --sea 2
        --faults none,gps30 --seeds 900000-900011 --json episodes.json
    python examples/gps_loss_study/forecasts.py episodes.json
"""

import json
import sys
from pathlib import Path

from twin.agents.forecast_table import mean_scores
from twin.agents.study_report import markdown
from twin.files import results_text

HERE = Path(__file__).parent


def main(path: str) -> None:
    """Read the episodes, and write results.json and tables.md."""
    rows = json.loads(Path(path).read_text(encoding="utf-8"))
    results = json.loads((HERE / "results.json").read_text(encoding="utf-8"))
    seas, losses, seeds = (
        list(dict.fromkeys(row[key] for row in rows)) for key in ("sea", "faults", "seed")
    )
    results["forecasts"] = []
    for model in dict.fromkeys(row["model"] for row in rows):
        for faults in losses:
            own = [
                row["twin_forecast"]
                for row in rows
                if (row["model"], row["faults"]) == (model, faults)
            ]
            scores = {name: float(f"{value:.5g}") for name, value in mean_scores(own).items()}
            results["forecasts"].append(
                {"agent": Path(model).stem, "faults": faults, "episodes": len(own), **scores}
            )
    results["forecasts_of"] = (
        f"{len(seas) * len(losses) * len(seeds)} episodes of each of some controllers and shipped "
        f"policies, one training of an arm (sea states: {', '.join(seas)}; losses: "
        f"{', '.join(losses)}; {len(seeds)} seeds), evaluated later than the tables above"
    )
    (HERE / "results.json").write_text(results_text(results), encoding="utf-8")
    (HERE / "tables.md").write_text(markdown(results), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
