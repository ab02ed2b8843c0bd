"""The sensor checks for one boat, as users see them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.checkpoint import State, check_fields, fill, record_views
from twin.health.checks import check_sensors
from twin.health.state import (
    HEALTH,
    HEALTH_SETTINGS,
    OK,
    REASONS,
    SENSORS,
    STATUSES,
    WIND_CHECK,
    health_settings,
    initial_health,
)
from twin.particulars import Particulars
from usv_kernel.jit import kernel
from usv_kernel.records import as_record, field_at

__all__ = ["SensorMonitor", "SensorStatus", "statuses_of"]

Array = NDArray[Any]


_CLOCK, _DUE, _RESTARTS, _ALL_STATUSES = (
    field_at(HEALTH, name) for name in ("clock", "current_due", "restarts", "statuses")
)

_WIND_STATUS, _WIND_REASON, _WIND_KNOWN = (
    field_at(HEALTH, "wind") + field_at(WIND_CHECK, name) for name in ("status", "reason", "known")
)

_CURRENT = slice(field_at(HEALTH, "current"), field_at(HEALTH, "current") + 3)


class SensorStatus(NamedTuple):
    """What is known of a sensor."""

    status: str
    """``ok``; ``doubtful``: at odds with others, but used; ``excluded``: not used; ``absent``."""
    since: float
    """Time since which it is so, s."""
    why: str
    """In words; empty where all is well."""

    def __str__(self) -> str:
        """Return it in words, such as ``excluded since 88.4 s: gps jumped``."""
        since = f" since {self.since:.1f} s" if math.isfinite(self.since) else ""
        return f"{self.status}{since}" + (f": {self.why}" if self.why else "")


@kernel
def _check(dt, z, cmd, s, ready, memory, settings, out):
    """Do :func:`check_sensors` on flat memory."""
    health, given = as_record(memory, HEALTH), as_record(settings, HEALTH_SETTINGS)
    check_sensors(dt, z, cmd, s, ready, health, given, out)


def statuses_of(health: Any, begin: float = 0.0) -> dict[str, SensorStatus]:
    """Return the status of each sensor by its name.

    Parameters
    ----------
    health : record
        ``HEALTH``.
    begin : float
        Time of its first row, s.

    Returns
    -------
    dict of str to SensorStatus
        In the order of ``twin.health.state.SENSORS``.
    """
    found = {}
    for name, check in zip(SENSORS, health["sensors"], strict=True):
        reason = REASONS[int(check["reason"])]
        since = begin + float(check["since"])
        found[name] = SensorStatus(
            STATUSES[int(check["status"])], since, f"{name} {reason}" if reason else ""
        )
    return found


class SensorMonitor:
    """Holds the sensors of a boat against each other, row by row.

    Parameters
    ----------
    particulars : Particulars
        The boat and its instruments.

    Attributes
    ----------
    memory : ndarray
        All that is remembered, in the layout of ``twin.health.state.HEALTH``.
    record : record
        The same by name: a view.
    """

    def __init__(self, particulars: Particulars) -> None:
        self._settings = health_settings(particulars)
        self._out = np.full(len(MEASUREMENTS), math.nan)
        self.remember(initial_health())

    def remember(self, memory: Array) -> None:
        """Remember in this memory from now on; see :attr:`memory`."""
        self.memory, self.record = memory, memory.view(HEALTH)[0]

    def __getstate__(self) -> dict[str, Array]:
        """Return what copies are made of: a copied record would be no view."""
        return {"settings": self._settings, "out": self._out, "memory": self.memory}

    def __setstate__(self, state: dict[str, Array]) -> None:
        """Become a copy."""
        self._settings, self._out = state["settings"], state["out"]
        self.remember(state["memory"])

    def reset(self) -> None:
        """Forget everything."""
        self.memory[:] = initial_health()

    @property
    def commands_doubted(self) -> bool:
        """True while the commands do not explain how the boat moves."""
        return bool(self.record["commands_doubted"] > 0.0)

    @property
    def motion_doubted(self) -> bool:
        """True while GPS or compass are left out, or the accelerometers while there is no GPS."""
        return bool(self.record["motion_doubted"] > 0.0)

    @property
    def restart(self) -> tuple[Array, Array] | None:
        """Which of surge and sway begin again after this row, and with what, m/s.

        See :meth:`twin.predictors.base.Predictor.restart_velocity`; None where none does.
        """
        if self.memory[_RESTARTS] == 0.0 and self.memory[_RESTARTS + 1] == 0.0:
            return None
        return self.record["restarts"], self.record["restarted"]

    @property
    def all_statuses(self) -> float:
        """One number for the statuses of all sensors: it differs where one of them does."""
        return self.memory.item(_ALL_STATUSES)

    def wants_current(self, dt: float) -> bool:
        """Return whether the next row, after dt s, looks at the current of the model."""
        return bool(self.memory[_CLOCK] + dt >= self.memory[_DUE])

    @property
    def doubts_wind(self) -> bool:
        """True while an anemometer is at fault, or silent after it was used."""
        return bool(self.memory[_WIND_REASON] > 0.0 or self.memory[_WIND_KNOWN] > 0.0) and (
            self.memory[_WIND_STATUS] != OK
        )

    def check(
        self,
        dt: float,
        z: Array,
        cmd: Array,
        state: Array,
        ready: bool,
        current: tuple[float, float, float] | None = None,
    ) -> tuple[Array, Array]:
        """Take a row, and return what of it can be trusted.

        Parameters
        ----------
        dt : float
            Time since the row before, s.
        z, cmd : ndarray, shapes (19,), (4,)
            Measurements and commands.
        state : ndarray, shape (6,)
            What the predictor said of the boat after the row before.
        ready : bool
            Whether that means anything.
        current : tuple of 3 floats, optional
            What its model says of the water; see :meth:`twin.predictors.base.Predictor.current`.

        Returns
        -------
        z, cmd : ndarray, shapes (19,), (4,)
            The row without impossible numbers and excluded sensors, which are NaN; and its
            command, or the last one that was trusted.
        """
        state = np.ascontiguousarray(state)
        if current is not None:
            self.memory[_CURRENT] = current
        _check(dt, z, cmd, state, ready, self.memory, self._settings, self._out)
        return self._out.copy(), self.trusted(cmd)

    def trusted(self, cmd: Array) -> Array:
        """Return the command (4,), or the last one that was trusted while it is in doubt."""
        return self.record["trusted"].copy() if self.commands_doubted else cmd

    def statuses(self, begin: float) -> dict[str, SensorStatus]:
        """Return the status of each sensor; ``begin`` is the time of the first row, s."""
        return statuses_of(self.record, begin)

    def wind_status(self, begin: float) -> SensorStatus:
        """Return the status of the anemometer; ``begin`` is the time of the first row, s."""
        wind = self.record["wind"]
        reason, since = REASONS[int(wind["reason"])], begin + float(wind["since"])
        status = STATUSES[int(wind["status"])]
        if status == "absent" and wind["known"] > 0.0:
            return SensorStatus(status, since, "wind is not measured any more; its mean is used")
        return SensorStatus(status, since, f"wind {reason}" if reason else "")

    def views(self) -> dict[str, Array]:
        """Return what is remembered, by field; parts of a record are ``field.part``."""
        found = {}
        for name, view in record_views(self.memory, HEALTH).items():
            if view.dtype.names is None:
                found[name] = view
            else:
                found |= {f"{name}.{part}": view[part] for part in view.dtype.names}
        return found

    def state_dict(self) -> State:
        """Return all that is remembered, as fields by name."""
        return {name: view.copy() for name, view in self.views().items()}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned.

        Raises
        ------
        StateError
            Names the field that is missing or damaged.
        """
        check_fields(state, self.views())
        fill(self.views(), state)
