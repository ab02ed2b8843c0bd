"""The installed package works: environment, twin on the recorded run, command line.

Run it outside the checkout, with the interpreter of a fresh environment:
``python -I smoke.py [folder of the checkout]``; packages found there are an error.
"""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from pathlib import Path

import gymnasium as gym
import numpy as np

import twin
import usv_gym
import usv_kernel
from twin import Log, Particulars, Twin, recorded_runs


def main() -> None:
    """Import, run 50 steps, run a twin over the recorded run, and start the command line."""
    home = Path(usv_kernel.__file__).parent.parent
    if "site-packages" not in home.parts:
        raise SystemExit(f"usv_kernel comes from {home}, not from an installed package")
    for package in (twin, usv_gym, usv_kernel):
        if not (Path(package.__file__).parent / "py.typed").is_file():
            raise SystemExit(f"{package.__name__} has no py.typed")
    for name in usv_gym.vessel_names():
        usv_gym.Vessel.load(name)

    env = gym.make("USVTwin-v0", twin="ukf")
    obs, _ = env.reset(seed=0)
    for _ in range(50):
        obs, _, _, _, info = env.step(np.array([0.7, 0.1], np.float32))
    env.close()
    print(f"50 steps, {len(obs)} entries, twin {info['twin_position_error_m']:.2f} m off")

    path = recorded_runs()["boat1_usv_circle"]
    boat = Twin(Particulars.load(path.with_suffix("").with_suffix(".toml")))
    boat.run(Log.read(path).slice(0.0, 60.0))
    print("in 10 s at", boat.predict("hold", horizon=10.0).mean[-1, :2].round(2))

    # Windows has it as Scripts/usv-twin.exe
    command = shutil.which("usv-twin", path=sysconfig.get_path("scripts"))
    if command is None:
        raise SystemExit(f"no usv-twin in {sysconfig.get_path('scripts')}")
    text = subprocess.run([command, "--help"], capture_output=True, text=True, check=True).stdout
    print(next(line.strip() for line in text.splitlines() if "benchmark" in line))


if __name__ == "__main__":
    main()
