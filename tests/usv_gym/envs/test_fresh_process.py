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


def test_make_by_module_and_id_in_a_fresh_process() -> None:
    out = fresh(
        "import gymnasium as gym\n"
        "env = gym.make('usv_gym:USVTwin-v0', twin='persistence')\n"
        "print(env.reset(seed=0)[0].shape)"
    )
    assert out.strip() == f"({len(OBSERVATION) + len(TWIN_OBSERVATION)},)"


def test_the_simulator_does_not_import_the_twin() -> None:
    out = fresh(
        "import sys, usv_gym, gymnasium as gym\n"
        "import usv_gym.envs.env\n"
        "known = 'USVTwin-v0' in gym.registry\n"
        "print(known, any(m.split('.')[0] == 'twin' for m in sys.modules))\n"
        "gym.make('USVTwin-v0', twin=None)\n"
        "print(any(m.split('.')[0] == 'twin' for m in sys.modules))"
    )
    assert out.split() == ["True", "False", "True"]


def test_the_twin_on_board_does_not_import_the_simulator() -> None:
    out = fresh(
        "import sys, twin, twin.predictors.ukf\n"
        "print(sorted({'usv_gym', 'gymnasium'} & set(sys.modules)))"
    )
    assert out.strip() == "[]"


def test_optional_packages_are_imported_late() -> None:
    out = fresh(
        "import sys, usv_gym, twin, twin.predictors.learned.lstm\n"
        "late = {'torch', 'matplotlib', 'filterpy', 'stable_baselines3'}\n"
        "print(sorted(late & set(sys.modules)))"
    )
    assert out.strip() == "[]"
