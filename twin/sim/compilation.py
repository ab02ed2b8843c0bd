"""Compiling at once what many runs will need."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Sequence

import numpy as np

from twin.digital_twin import Twin
from twin.logs.log import Log, recorded_runs
from twin.parallel import results_of
from twin.predictors.registry import PREDICTORS, base_name, make_predictor
from twin.sim.bridge import particulars_of, simulate
from twin.sim.oracle import simulator_options
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.sea import SeaState
from usv_kernel.cache import cached
from usv_kernel.warmup import MESSAGE, QUIET

__all__ = [
    "compile_kernels",
]

SLOW = "dsw-ukf-plus"
"""Its kernels take as long to compile as all others."""


Boat = tuple[Vessel, SeaState, int]
"""A vessel, its sea and its degrees of freedom."""


def compile_kernels(
    boat: Boat, predictors: Sequence[str], *, jobs: int = 1, backend: str = "loky"
) -> None:
    """Compile the kernels of simulator, twin and predictors, and keep them on disk.

    With two or more ``jobs`` on this machine (``loky``) two processes share the work, and the
    message that kernels compile comes from here: workers are silent.
    """
    if backend != "loky" or jobs < 2 or SLOW not in predictors:
        _compile_for(boat, predictors)
        return
    if not cached() and not os.environ.get(QUIET):
        print(MESSAGE, file=sys.stderr, flush=True)
    others = [name for name in predictors if name != SLOW]
    calls = [
        functools.partial(_compile_for, boat, others),
        functools.partial(_compile_alone, boat[0], SLOW),
    ]
    for _ in results_of(calls, jobs=2):
        pass


def _compile_for(boat: Boat, predictors: Sequence[str]) -> None:
    """Compile simulator, twin and some predictors."""
    nominal, sea, dof = boat
    # a boat that varies compiles the ship's equations for the check of its course stability
    vessel = nominal.varied(np.random.default_rng(0), 0.1)
    log = simulate("turn", vessel=vessel, sea=sea, duration=1.0, seed=0)
    for name in predictors:
        if base_name(name) not in PREDICTORS:
            continue  # a user's own, whose errors belong to the runs
        twin = Twin(particulars_of(vessel), name, **simulator_options(name, vessel, sea, dof))
        twin.run(log)
        twin.predict("hold")


def _compile_alone(vessel: Vessel, name: str) -> None:
    """Compile one predictor without a simulator and a twin around it."""
    log = Log.read(next(iter(recorded_runs().values()))).slice(0.0, 3.0)
    predictor = make_predictor(name, particulars_of(vessel))
    for dt, (t, z, cmd) in zip(np.diff(log.t, prepend=log.t[0]).tolist(), log, strict=True):
        predictor.update(t, dt, z.copy(), cmd.copy())
        predictor.estimate()
    predictor.predict(np.tile(log.cmd[-1], (40, 1)), 0.25)
