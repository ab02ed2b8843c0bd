"""The navigation filter with its arrays, for predictors without a model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.checkpoint import State, check_fields, fill, record_views
from twin.filters.navigation_ekf import navigate
from twin.filters.navigation_state import (
    N_MODELLED,
    NAVIGATION,
    NAVIGATION_SETTINGS,
    NAVIGATION_WORK,
    initial_navigation,
    navigation_settings,
)
from twin.particulars import Particulars
from usv_kernel.jit import kernel
from usv_kernel.records import as_record

__all__ = ["Navigator"]

Array = NDArray[np.float64]


@kernel
def _navigate_flat(nav, dt, z, model, settings, work):
    """Do :func:`twin.filters.navigation_ekf.navigate` on flat memory."""
    navigate(
        as_record(nav, NAVIGATION),
        dt,
        z,
        model,
        as_record(settings, NAVIGATION_SETTINGS),
        as_record(work, NAVIGATION_WORK),
    )


class Navigator:
    """The filter with its arrays, for predictors without a model.

    Parameters
    ----------
    particulars : Particulars
        The boat and its instruments.

    Attributes
    ----------
    n, P : ndarray, shapes (12,), (12, 12)
        State and covariance; views of the memory.
    memory : ndarray
        All that the filter remembers, in the order of :data:`NAVIGATION`.
    """

    def __init__(self, particulars: Particulars) -> None:
        self._settings = navigation_settings(particulars)
        self._work = np.zeros(NAVIGATION_WORK.itemsize // 8)
        self._model = np.zeros(N_MODELLED)
        self.memory = initial_navigation(self._settings)
        self._open()

    def _open(self) -> None:
        record = self.memory.view(NAVIGATION)[0]
        self.n, self.P = record["n"], record["P"]

    def __getstate__(self) -> dict[str, Any]:
        """Leave the views out: those of a copy are of its own memory."""
        return {name: value for name, value in vars(self).items() if name not in ("n", "P")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open()

    def reset(self) -> None:
        """Forget everything."""
        self.memory[:] = initial_navigation(self._settings)

    def _views(self) -> dict[str, Array]:
        return record_views(self.memory, NAVIGATION)

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        return {name: view.copy() for name, view in self._views().items()}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned."""
        check_fields(state, self._views())
        fill(self._views(), state)

    def begin_again(self, restart: Any) -> None:
        """Begin again in the next row; see ``twin.predictors.base.Predictor``."""
        self.memory.view(NAVIGATION)[0]["restart"] = restart

    @property
    def ready(self) -> bool:
        """True once a fix and a heading have come."""
        nav = self.memory.view(NAVIGATION)[0]
        return bool(nav["has_fix"] and nav["has_heading"])

    @property
    def state(self) -> Array:
        """State (x, y, psi, u, v, r), a view."""
        return self.n[:6]

    def update(self, dt: float, z: ArrayLike) -> Array:
        """Take one row of measurements; see :func:`twin.filters.navigation_ekf.navigate`.

        Parameters
        ----------
        dt : float
            Time since the row before, s.
        z : array_like, shape (19,)
            Measurement row.

        Returns
        -------
        ndarray, shape (6,)
            State (x, y, psi, u, v, r), a view.
        """
        z = np.ascontiguousarray(z, dtype=np.float64)
        _navigate_flat(self.memory, dt, z, self._model, self._settings, self._work)
        return self.n[:6]
