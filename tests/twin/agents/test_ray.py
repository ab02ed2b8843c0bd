"""Ray: RLlib trains on the environment, on one machine and on a cluster."""

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

if find_spec("ray") is None:
    pytest.skip("Ray is not installed: pip install 'usv-twin[rllib]'", allow_module_level=True)

needs_rllib = pytest.mark.skipif(
    find_spec("ray.rllib") is None or find_spec("torch") is None or find_spec("tree") is None,
    reason="RLlib is not installed: pip install 'usv-twin[rllib]'",
)
EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "05_rllib.py"


@pytest.fixture
def address():
    """The address of a cluster of two nodes with a CPU each, as on two machines."""
    from ray.cluster_utils import Cluster

    one = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=one)
    cluster.add_node(num_cpus=1)
    yield cluster.address
    cluster.shutdown()


def train(folder, *arguments):
    small = ("--iterations", "2", "--boats", "4", "--decisions", "512")
    command = [sys.executable, str(EXAMPLE), *small, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=600)
    assert result.returncode == 0, result.stderr
    lines = re.findall(r"iteration (\d): mean return (\S+), (\d+) decisions/s", result.stdout)
    assert [int(i) for i, _, _ in lines] == [1, 2]
    assert all(int(speed) > 0 for _, _, speed in lines)


@needs_rllib
def test_rllib_trains_with_two_env_runners(tmp_path):
    train(tmp_path)


@needs_rllib
def test_rllib_trains_on_a_cluster_that_is_there(tmp_path, address):
    train(tmp_path, "--address", address)
