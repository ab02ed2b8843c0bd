"""Three trained agents follow a path while the GPS is lost for 30 s.

One sees the sensors, one the twin, one the truth. They are policies that ship with the study in
``agent_study``; numpy alone reads them. Run ``python examples/06_gps_loss_agents.py
[picture.png]``.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from twin.agents.evaluation import make_envs
from twin.agents.policy import Policy

POLICIES = Path(__file__).parent / "agent_study" / "path" / "policies"
LOST, FOUND = 30.0, 60.0
COLOURS = {"compact_raw": "#c4342b", "compact": "#1f6fb5", "compact_oracle": "#2c8a57"}
SEEN = {
    "compact_raw": "sees the sensors",
    "compact": "sees its twin",
    "compact_oracle": "sees the truth",
}


def sail(policy: Policy, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return times (s), true positions (m), distances off the path (m), and the way points."""
    envs = make_envs(
        1, observation=policy.observation, sea="2", faults=f"gps{FOUND - LOST:g}@{LOST:g}"
    )
    obs, info = envs.reset(seed=[seed])
    policy.begin(envs)
    rows = []
    for _ in range(240):
        obs, _, terminated, truncated, info = envs.step(policy.act(obs))
        north, east = envs.simulation.state[0, :2]
        rows.append([info["t_s"][0], north, east, info["cross_track_m"][0]])
        if terminated[0] or truncated[0]:
            break
    points = envs.task.points[0].copy()
    envs.close()
    table = np.array(rows)
    return table[:, 0], table[:, 1:3], table[:, 3], points


def main() -> None:
    picture = Path(sys.argv[1] if len(sys.argv) > 1 else "gps_loss_agents.png")
    figure, (chart, below) = plt.subplots(
        2, 1, figsize=(8.0, 9.0), height_ratios=(2.4, 1.0), layout="constrained"
    )
    for name, colour in COLOURS.items():
        t, track, off, points = sail(Policy.load(POLICIES / f"ppo-{name}.npz"), seed=900_003)
        gone = (t >= LOST) & (t <= FOUND)
        chart.plot(track[:, 1], track[:, 0], color=colour, lw=1.2, label=SEEN[name])
        chart.plot(track[gone, 1], track[gone, 0], color=colour, lw=3.2)
        below.plot(t, off, color=colour, lw=1.5)
        worst = f"{np.abs(off[gone]).max():5.2f} m at most" if gone.any() else "not under way"
        print(
            f"{SEEN[name]:>18}: {np.abs(off).mean():5.2f} m off the path on average, "
            f"{worst} while the GPS is gone"
        )
    chart.plot(points[:, 1], points[:, 0], "--", color="0.35", lw=1.0, marker="o", ms=4, zorder=0)
    chart.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    chart.legend(title=f"thick: no GPS, {LOST:g} to {FOUND:g} s", frameon=False)
    below.axvspan(LOST, FOUND, color="0.9")
    below.axhline(0.0, color="0.35", lw=0.8, ls="--")
    below.set(xlabel="time, s", ylabel="to starboard of the path, m")
    for axes in (chart, below):
        axes.grid(color="0.92")
    figure.savefig(picture, dpi=110)
    print(picture)


if __name__ == "__main__":
    main()
