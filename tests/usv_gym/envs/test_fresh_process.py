"""What a fresh process imports."""

import os
import subprocess
import sys
from pathlib import Path

import usv_gym
from twin.sim.twin_observation import TWIN_OBSERVATION
from usv_gym.envs.episodes import OBSERVATION

ROOT = Path(usv_gym.__file__).resolve().parent.parent


def fresh(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_simulator_imports_the_twin_when_an_environment_has_one() -> None:
    out = fresh(
        "import sys, gymnasium as gym\n"
        "import usv_gym.envs.env\n"
        "known = 'USVTwin-v0' in gym.registry\n"
        "print(known, any(m.split('.')[0] == 'twin' for m in sys.modules))\n"
        "env = gym.make('usv_gym:USVTwin-v0', twin='persistence')\n"
        "assert not {'pygame', 'matplotlib'} & set(sys.modules)\n"
        "print(*env.reset(seed=0)[0].shape)"
    )
    assert out.split() == ["True", "False", str(len(OBSERVATION) + len(TWIN_OBSERVATION))]


def test_the_simulator_and_optional_packages_are_imported_late() -> None:
    """The twin on board needs no simulator, and the optional packages where they are used."""
    out = fresh(
        "import sys, twin, twin.predictors.ukf, twin.predictors.learned.lstm\n"
        "print(sorted({'usv_gym', 'gymnasium'} & set(sys.modules)))\n"
        "import usv_gym\n"
        "late = {'torch', 'matplotlib', 'filterpy', 'stable_baselines3'}\n"
        "print(sorted(late & set(sys.modules)))"
    )
    assert out.split() == ["[]", "[]"]
