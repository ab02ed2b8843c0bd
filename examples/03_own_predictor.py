"""Add a predictor of your own, and compare it with the others on one manoeuvre."""

import numpy as np

from twin import PREDICTORS, Twin
from twin.digital_twin import known_plan
from twin.predictors.baselines import GRID, HistoryPredictor, hold_velocity
from twin.sim.bridge import particulars_of, simulate
from usv_gym import SeaState, Vessel


class FadingTurn(HistoryPredictor):
    """Hold the speed, and let the mean yaw rate of the last two seconds fade within 5 s."""

    def forecast(self, rows, origins, plans):
        last = np.stack([rows[np.maximum(origins - k, 0), 3:6] for k in range(8)]).mean(axis=0)
        out = np.empty((len(origins), plans.shape[1], 6))
        state, velocity = rows[origins, :6], last.copy()
        for k in range(plans.shape[1]):
            velocity[:, 2] = last[:, 2] * np.exp(-k * GRID / 5.0)
            state = hold_velocity(state, velocity, np.array([GRID]))[:, 0]
            out[:, k] = state
        return out


PREDICTORS["fading-turn"] = FadingTurn

vessel = Vessel.load("usv75")
log = simulate("zigzag", vessel=vessel, sea=SeaState(hs=0.5, wind=4.5), duration=90.0, seed=0)
rows = [k for k, t in enumerate(log.t) if 60.0 <= t <= 80.0 and k % 20 == 0]
for name in ("persistence", "persistence-8s", "fading-turn", "ukf"):
    twin = Twin(particulars_of(vessel), name)
    errors = []
    for k, (t, z, cmd) in enumerate(log.without_truth()):
        twin.step(t, z, cmd)
        if k in rows:
            end = twin.predict(known_plan(log, k, 10.0, 0.1), dt=0.1).mean[-1]
            errors.append(np.hypot(*(end[:2] - log.truth[k + 200, :2])))
    print(f"{name:15s} position error after 10 s: {np.median(errors):5.1f} m (median)")
