"""Run a twin over the log of a real boat, and forecast the next 10 s with standard deviations."""

import numpy as np

from twin import Log, Particulars, Twin, recorded_runs

path = recorded_runs()["boat1_usv_circle"]
log = Log.read(path)
print(*log.notes, sep="\n")
twin = Twin(Particulars.load(path.with_name("boat1_usv_circle.toml")))
twin.run(log.slice(0.0, 120.0))
prediction = twin.predict("hold", horizon=10.0)
mean, cov = prediction.at(np.array([1.0, 2.0, 5.0, 10.0]))
for after, state, sd in zip((1, 2, 5, 10), mean, np.sqrt(cov[:, [0, 1], [0, 1]]), strict=True):
    print(
        f"after {after:2d} s: north {state[0]:7.2f} +- {sd[0]:.2f} m, "
        f"east {state[1]:7.2f} +- {sd[1]:.2f} m, heading {np.degrees(state[2]) % 360:.0f} deg"
    )
