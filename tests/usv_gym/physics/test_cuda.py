"""The kernels of ship and twin compile for a GPU from the same source, to PTX; none is needed.

Where there is one, they run on it.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from twin.channels import MEASUREMENTS
from twin.filters.ukf import UKFWorkspace, measurement_update, workspace
from twin.identification.filter_settings import plain_settings
from twin.identification.joint_ukf import JointUKF
from twin.model.augmented import JointConfig, JointState, JointWorkspace, joint_predict
from twin.model.dynamics import N_ACT
from twin.model.rollout import (
    HORIZONS,
    Paths,
    RolloutConfig,
    RolloutStart,
    Waves,
    rollout,
    rollout_size,
)
from twin.model.structure import N_STATES, N_TERMS
from twin.predictors.ukf import UKFMemory, UKFPredictor, UKFWork, tight_step
from twin.sim.bridge import particulars_of
from usv_gym import Vessel
from usv_gym.world.simulation import Simulation, advance
from usv_gym.world.state import SIMULATION
from usv_kernel import jit
from usv_kernel.records import as_record

pytest.importorskip("numba_cuda", reason="needs numba-cuda: pip install 'usv-twin[cuda]'")
from numba import cuda
from numba.cuda import dispatcher

N = 2
CAPABILITY = (8, 0)
LINKED = {"numba_attempt_nocopy_reshape"}
"""What numba-cuda links to kernels by itself."""
BOAT = particulars_of(Vessel.load("usv75"))


# each a kernel of a thread per boat: what all boats share comes whole, and of the rest a row


@jit.kernel
def advance_flat(row, shared, factors):
    advance(row, as_record(shared, SIMULATION), factors)


def simulate(rows, shared, factors):
    i = cuda.grid(1)
    if i < rows.shape[0]:
        advance_flat(rows[i], shared, factors[i])


def correct(state, h, config, work, z, mask, R):
    i = cuda.grid(1)
    if i < state.x.shape[0]:
        own = JointState(state.x[i], state.P[i], state.act[i], state.wind[i])
        block = work.sigma[i]
        sigma = UKFWorkspace(block[0], block[1], block[2], block[3])
        joint_predict(own, h, config, JointWorkspace(work.Q, work.q_xi, work.terms[i], sigma))
        measurement_update(own.x, own.P, z[i], mask[i], R, 2, math.inf, sigma)


def identify(dt, z, cmd, memory, config, work):
    i = cuda.grid(1)
    if i < z.shape[0]:
        own = UKFMemory(memory.nav[i], memory.filter[i])
        tight_step(dt, z[i], cmd[i], own, config, UKFWork(work.nav[i], work.filter[i]))


def predict(start, plan, config, velocity, out, work):
    i = cuda.grid(1)
    if i < start.states.shape[0]:
        own = RolloutStart(start.states[i], start.params[i], start.act[i], start.wind[i])
        paths = Paths(out.states[i], out.act[i])
        rollout(own, plan[i], 0.25, config, Waves(velocity[i], 0.0), paths, work[i])


def each(*arrays):
    """Return the arrays of N boats."""
    return [np.repeat(array[None], N, axis=0) for array in arrays]


def of_simulation():
    simulation = Simulation(N, "usv75", "2", dof=6)
    simulation.reset(range(N), [np.random.default_rng(k) for k in range(N)])
    simulation.cmd[:] = 15.0, 15.0, 0.1, 0.1
    (factors,) = each(simulation.factors)
    return simulation.rows, simulation.shared, factors


def of_ukf():
    ukf = JointUKF(BOAT, plain_settings(BOAT))
    x, P, act, wind, terms = each(ukf.x, ukf.P, ukf.act, ukf.wind, np.empty(N_TERMS))
    (sigma,) = each(np.array(workspace(N_STATES, len(ukf.xi))))
    z, mask, Q = x[:, :N_STATES].copy(), np.ones((N, N_STATES), dtype=bool), np.eye(N_STATES)
    work = JointWorkspace(Q, ukf.settings.q_xi, terms, sigma)
    config = JointConfig(ukf.terms, ukf.weights)
    return JointState(x, P, act, wind), 0.05, config, work, z, mask, Q


def of_twin():
    predictor = UKFPredictor(BOAT)
    z, cmd = each(np.zeros(len(MEASUREMENTS)), np.zeros(N_ACT))
    memory, work = UKFMemory(*each(*predictor.memory)), UKFWork(*each(*predictor.work))
    return 0.05, z, cmd, memory, predictor.config, work


def of_rollout():
    ukf, K = JointUKF(BOAT, plain_settings(BOAT)), len(HORIZONS)
    start = RolloutStart(*each(ukf.x[None, :N_STATES], ukf.xi[None], ukf.act, ukf.wind))
    paths = Paths(*each(np.empty((1, K, N_STATES)), np.empty((K, N_ACT))))
    plan, velocity, work = each(np.zeros((K, N_ACT)), np.zeros((1, K, 3)), np.empty(rollout_size()))
    return start, plan, RolloutConfig(ukf.lags, ukf.envelope, ukf.terms), velocity, paths, work


KERNELS = {
    "simulation.advance": (simulate, of_simulation),
    "joint_predict, measurement_update": (correct, of_ukf),
    "tight_step": (identify, of_twin),
    "rollout": (predict, of_rollout),
}


@pytest.mark.parametrize("name", KERNELS)
def test_kernel_compiles_to_ptx(name, monkeypatch):
    kernel, arguments = KERNELS[name]
    # numba-cuda asks the driver for the device whose functions it compiles; here is none
    device = SimpleNamespace(compute_capability=CAPABILITY)
    monkeypatch.setattr(dispatcher, "get_current_device", lambda: device)
    signature = numba.void(*map(numba.typeof, arguments()))
    options = {"device": False, "cc": CAPABILITY, "output": "ptx", "abi": "numba"}
    ptx, _ = cuda.compile(kernel, signature, **options)
    assert ptx.count(".visible .entry") == 1
    assert "fma.rn.f64" in ptx
    called = {line.split(")")[1].strip(" (") for line in ptx.splitlines() if ".extern" in line}
    assert called <= LINKED, "calls what no GPU has: an allocation, or a library"


@pytest.mark.parametrize("name", KERNELS)
def test_what_is_compiled_runs(name, monkeypatch):
    """The arguments are those that the kernels take: on the CPU, thread after thread."""
    kernel, arguments = KERNELS[name]
    values = arguments()
    for i in range(N):
        monkeypatch.setattr(cuda, "grid", lambda _, i=i: i)
        kernel(*values)


def arrays_of(value):
    if isinstance(value, np.ndarray):
        return [value] if value.dtype.kind == "f" else []
    return [one for part in value for one in arrays_of(part)] if isinstance(value, tuple) else []


@pytest.mark.skipif(not cuda.is_available(), reason="needs a GPU")
@pytest.mark.filterwarnings("ignore:.*low occupancy")
@pytest.mark.parametrize("name", KERNELS)
def test_a_gpu_computes_what_the_cpu_does(name, monkeypatch):
    kernel, arguments = KERNELS[name]
    on_gpu, on_cpu = arguments(), arguments()
    cuda.jit(kernel)[1, 32](*on_gpu)
    cuda.synchronize()
    for i in range(N):
        monkeypatch.setattr(cuda, "grid", lambda _, i=i: i)
        kernel(*on_cpu)
    for ours, theirs in zip(arrays_of(on_gpu), arrays_of(on_cpu), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12)
