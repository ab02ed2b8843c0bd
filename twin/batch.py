"""Twins of n like boats: one state by name, and one step for all that have a new row."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.filters.navigation_state import RESTART
from twin.integrity.sensing import ROW, Boats, sense_row
from twin.integrity.state import INTEGRITY, initial_integrity, integrity_settings
from twin.model.structure import N_STATES
from twin.motion.deck_motion import DeckMotion, initial_motion
from twin.particulars import Particulars
from twin.predictors.base import Predictor, plain
from usv_kernel.records import field_at, record_size, structured

__all__ = ["HEALTH", "Twins"]

Array = NDArray[np.float64]

_ALL = slice(None)


def _place(name: str) -> slice:
    """Return where a field stands in a row."""
    size = ROW[name].itemsize // 8
    return slice(field_at(ROW, name), field_at(ROW, name) + size)


HEALTH = _place("health")
"""Where a row has what the sensor checks remember."""

_T, _Z, _CMD, _USED, _TRUSTED = map(_place, ("t", "z", "cmd", "used", "trusted"))
_COMMANDS_DOUBTED, _MOTION_DOUBTED, _SWITCHED = (
    HEALTH.start + field_at(INTEGRITY, name)
    for name in ("commands_doubted", "motion_doubted", "switched")
)


class Twins:
    """Twins of n like boats.

    A predictor that keeps all in flat arrays, as ``ukf`` and ``dsw-ukf-plus`` do, takes the rows of
    all boats in one compiled call; of every other there is one for each boat.

    Parameters
    ----------
    particulars : Particulars
        Of the boats.
    predictor : Predictor
        Of one boat that takes its rows; of more they are like it.
    n : int
        Number of boats.
    beside : int
        Numbers that are kept behind each row for who observes the boats.
    blocks : sequence of slice
        Boats that different threads step.

    Attributes
    ----------
    rows : ndarray, shape (n, ...)
        :data:`twin.integrity.sensing.ROW` of each boat, and what is kept behind it.
    motions : ndarray, shape (n, size of MOTION), or None
        What is remembered of roll, pitch and heave; None where nothing measures them.
    memory : tuple of ndarray, shapes (n, ...)
        What compiled predictors remember, by name; empty for others.
    predictors : list of Predictor
        One for each boat, but none of several boats of a compiled one: ``model`` says what they
        have in common.
    """

    def __init__(
        self,
        particulars: Particulars,
        predictor: Predictor,
        n: int = 1,
        beside: int = 0,
        blocks: Any = (_ALL,),
    ) -> None:
        self.model: Any = predictor
        self.blocks = blocks
        self.settings = integrity_settings(particulars)
        self._first_row = np.zeros(record_size(ROW))
        for name in ("t", "last", "begun", "lost_at"):
            self._first_row[_place(name)] = np.nan
        self._first_row[HEALTH] = initial_integrity(particulars)
        self.rows = np.zeros((n, record_size(ROW) + beside))
        self.rows[:, : record_size(ROW)] = self._first_row
        self.motion = DeckMotion(particulars)
        self.motions: Array | None = None
        self.kernel: Any = None
        self.memory: Any = ()
        self.predictors = [predictor]
        self._restart = np.zeros(record_size(RESTART))
        if vars(type(predictor)).get("is_compiled"):  # a subclass may do anything
            from twin.row_steps import STEPS  # needs the modules of these predictors

            self.kernel = STEPS[type(predictor).__name__]
        if n > 1 and self.kernel:
            own = self._own()
            self.predictors = []
            self.memory = type(own)(*(np.repeat(array, n, axis=0) for array in own))
        elif n > 1:
            self.predictors = [copy.deepcopy(predictor) for _ in range(n)]
        self._bind()

    def _bind(self) -> None:
        """Lay out what shares memory: one boat's is that of its predictor."""
        self._parts: list[Any] | None = None
        if self.kernel and self.predictors:
            self.model = self.predictors[0]
            self.memory = self._own()
        if self.motions is not None:
            self.motion.remember(self.motions[0])

    def _own(self) -> Any:
        """Return the memory of the predictor as that of a batch of one."""
        own = self.model.memory
        return type(own)(*(array[None] for array in own))

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies are made of."""
        return {**vars(self), "_parts": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Become a copy."""
        vars(self).update(state)
        self._bind()

    @property
    def boats(self) -> NDArray[Any]:
        """The rows (n,) by name, see ``ROW``: views."""
        return structured(self.rows, ROW)

    def measure_motion(self) -> None:
        """Take roll, pitch and heave of all boats from now on."""
        if self.motions is None:
            self.motions = np.tile(initial_motion(), (len(self.rows), 1))
            self._bind()

    def reset(self, i: int) -> None:
        """Return boat i to the state before the first row."""
        self.rows[i, : len(self._first_row)] = self._first_row
        if self.motions is not None:
            self.motions[i] = initial_motion()
        if self.predictors:
            self.predictors[i].reset()
            return
        for memory, blank in zip(self.memory, self.model.memory, strict=True):
            memory[i] = blank

    def state(self, i: int) -> Array:
        """Return a copy of the state (6,) of boat i."""
        if self.kernel:
            return np.array(self.memory.filter[i, :N_STATES])
        return np.array(self.predictors[i].state, dtype=np.float64)

    def parameters(self, rows: slice = _ALL) -> tuple[Array, Array]:
        """Return parameters (k, p) of some boats' models, and their standard deviations."""
        if not self.kernel:
            found = [one.estimate() for one in self.predictors[rows]]
            return np.array([o.params for o in found]), np.array([o.params_sd for o in found])
        state = self.memory.filter[rows].view(self.model.dtypes["filter"])[:, 0]
        variances = np.diagonal(state["P"], axis1=1, axis2=2)
        return state["x"][:, N_STATES:], np.sqrt(variances[:, N_STATES:])

    @property
    def parts(self) -> list[Any]:
        """For each block of boats, what kernels take: see :meth:`part`."""
        if self._parts is None:
            self._parts = [self.part(rows, own=len(self.blocks) > 1) for rows in self.blocks]
        return self._parts

    def part(self, rows: slice, own: bool = False) -> tuple[Any, Any, Any, Any]:
        """Return ``Boats``, memory, configuration and scratch of some boats as plain tuples.

        Threads need scratch of their ``own``.
        """
        motion: tuple[Any, Any, Any] = None, None, None
        if self.motions is not None:
            motion = self.motions[rows], self.motion.settings, self.motion.scratch
        boats, given = Boats(self.rows[rows], self.settings, *motion), (None, None)
        if self.kernel:
            given = plain(self.model.config), plain(self.model.work)
        if own:
            work = None if motion[2] is None else motion[2].copy()
            boats, given = boats._replace(motion_work=work), (given[0], copy.deepcopy(given[1]))
        return tuple(boats), tuple(array[rows] for array in self.memory), *given

    def take(self, t: float, z: Array, cmd: Array) -> None:
        """Let the one boat take a row of time t (s): measurements (19,) and command (4,)."""
        row = self.rows[0]
        row[_T], row[_Z], row[_CMD] = t, z, cmd
        self.step()

    def step(self) -> None:
        """Let all boats whose ``t`` is not that of their last row take it."""
        if self.kernel:
            self.kernel(*self.parts[0])
            return
        for i in range(len(self.rows)):
            self.step_one(i)

    def step_one(self, i: int) -> float:
        """Let boat i take its row by its predictor; return the time since the last, s, or -1."""
        predictor, row, restart = self.predictors[i], self.rows[i], self._restart
        state = np.ascontiguousarray(predictor.navigation)
        dt: float = sense_row(i, state, predictor.ready, self.parts[0][0], restart)
        if dt < 0.0:
            return dt
        commands, motion = row.item(_COMMANDS_DOUBTED), row.item(_MOTION_DOUBTED)
        predictor.suspend_learning(commands > 0.0, motion > 0.0)
        if row.item(_SWITCHED) > 0.0:
            predictor.begin_again(restart.view(RESTART)[0].copy())
        # a predictor may keep the arrays
        predictor.update(row.item(0), dt, row[_USED].copy(), row[_TRUSTED].copy())
        if predictor.lost:
            self.boats["lost_at"][i] = row.item(0)
        return dt
