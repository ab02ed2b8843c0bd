"""The kernels of ship and twin compile for a GPU from the same source, to PTX; none is needed."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from twin.channels import MEASUREMENTS
from twin.filters.ukf import measurement_update
from twin.identification.filter_settings import plain_settings
from twin.identification.joint_ukf import JointUKF
from twin.model.augmented import joint_predict
from twin.model.dynamics import N_ACT
from twin.model.rollout import LOOK_AHEAD, ROOM, look_ahead
from twin.model.structure import N_STATES, N_TERMS
from twin.predictors.ukf import UKFPredictor, tight_step
from twin.sim.bridge import particulars_of
from usv_gym import Vessel
from usv_gym.world.simulation import Simulation, advance
from usv_gym.world.state import SIMULATION
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


def simulate(rows, shared, factors):
    i = cuda.grid(1)
    if i < rows.shape[0]:
        advance(rows[i], as_record(shared, SIMULATION), factors[i])


def correct(x, P, act, wind, kit, h, Q, q_xi, weights, terms, z, mask, R, work):
    i = cuda.grid(1)
    if i < x.shape[0]:
        joint_predict(
            *(x[i], P[i], act[i], wind[i], kit, h, Q, q_xi, weights, terms[i], work[i]),
        )
        measurement_update(x[i], P[i], z[i], mask[i], R, 2, math.inf, work[i])


def identify(dt, z, cmd, nav, nav_settings, nav_work, memory, constants, scratch, work, kit):
    i = cuda.grid(1)
    if i < z.shape[0]:
        tight_step(
            *(dt, z[i], cmd[i], nav[i], nav_settings, nav_work[i]),
            *(memory[i], constants, scratch[i], work[i], kit),
        )


def foretell(
    s, xi, act, command, lags, envelope, wind, kit, time_scale, ripple, out, out_act, room
):
    i = cuda.grid(1)
    if i < s.shape[0]:
        look_ahead(
            *(s[i], xi[i], act[i], command[i], lags, envelope, wind[i], kit, time_scale),
            *(ripple[i], 0.0, out[i], out_act[i], room[i]),
        )


def each(*arrays):
    """Return the arrays of N boats."""
    return [np.repeat(array[None], N, axis=0) for array in arrays]


def of_simulation():
    simulation = Simulation(N, "usv75", "2", dof=6)
    (factors,) = each(simulation.factors)
    return simulation.rows, simulation.shared, factors


def of_ukf():
    ukf = JointUKF(BOAT, plain_settings(BOAT))
    x, P, act, wind, terms, work = each(
        ukf.x, ukf.P, ukf.act, ukf.wind, np.empty(N_TERMS), ukf.work
    )
    z, mask, Q = x[:, :N_STATES].copy(), np.ones((N, N_STATES), dtype=bool), np.eye(N_STATES)
    shared = (ukf.kit, 0.05, Q, ukf.settings.q_xi, ukf.weights)
    return x, P, act, wind, *shared, terms, z, mask, Q, work


def of_twin():
    predictor = UKFPredictor(BOAT)
    settings, nav_work, constants, scratch, work, kit = predictor.shared
    nav, memory, *rooms = each(*predictor.remembered, nav_work, scratch, work)
    z, cmd = each(np.zeros(len(MEASUREMENTS)), np.zeros(N_ACT))
    return 0.05, z, cmd, nav, settings, rooms[0], memory, constants, *rooms[1:], kit


def of_look_ahead():
    ukf = JointUKF(BOAT, plain_settings(BOAT))
    s, xi, act, wind, room = each(ukf.x[:N_STATES], ukf.params, ukf.act, ukf.wind, np.empty(ROOM))
    out, out_act = each(np.empty((len(LOOK_AHEAD), N_STATES)), np.empty((len(LOOK_AHEAD), N_ACT)))
    (ripple,) = each(np.zeros((len(LOOK_AHEAD), 3)))
    shared = (ukf.lags, ukf.envelope)
    return s, xi, act, act.copy(), *shared, wind, ukf.kit, 1.0, ripple, out, out_act, room


KERNELS = {
    "simulation.advance": (simulate, of_simulation),
    "joint_predict, measurement_update": (correct, of_ukf),
    "identifier.tight_step": (identify, of_twin),
    "model.look_ahead": (foretell, of_look_ahead),
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
