"""The checks of sensors and commands for one boat, as users see them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.channels import MEASUREMENTS
from twin.checkpoint import State, check_fields, fill
from twin.integrity.checks import check_sensors
from twin.integrity.state import (
    INTEGRITY,
    INTEGRITY_SETTINGS,
    OK,
    REASONS,
    SENSORS,
    STATUSES,
    WIND_CHECK,
    initial_integrity,
    integrity_settings,
)
from twin.particulars import Particulars
from usv_kernel.jit import kernel
from usv_kernel.records import as_record, field_at

__all__ = ["SensorMonitor", "SensorStatus", "run_over", "statuses_of"]

Array = NDArray[Any]

_STATUSES = field_at(INTEGRITY, "statuses")

_WIND_STATUS, _WIND_REASON, _WIND_KNOWN = (
    field_at(INTEGRITY, "wind") + field_at(WIND_CHECK, name)
    for name in ("status", "reason", "known")
)


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


def statuses_of(record: Any, begin: float = 0.0) -> dict[str, SensorStatus]:
    """Return the status of each sensor by its name.

    Parameters
    ----------
    record : record
        ``INTEGRITY``.
    begin : float
        Time of its first row, s.

    Returns
    -------
    dict of str to SensorStatus
        In the order of ``twin.integrity.state.SENSORS``.
    """
    found = {}
    for name, check in zip(SENSORS, record["sensors"], strict=True):
        reason = REASONS[int(check["reason"])]
        since = begin + float(check["since"])
        found[name] = SensorStatus(
            STATUSES[int(check["status"])], since, f"{name} {reason}" if reason else ""
        )
    return found


class SensorMonitor:
    """What the sensor checks of a boat say, read from what they remember.

    Parameters
    ----------
    memory : ndarray
        That, in the layout of ``twin.integrity.state.INTEGRITY``.
    """

    def __init__(self, memory: Array) -> None:
        self.memory = memory

    @property
    def record(self) -> Any:
        """The memory by name: a view."""
        return self.memory.view(INTEGRITY)[0]

    @property
    def all_statuses(self) -> float:
        """All statuses in one number: it differs where one of them does."""
        return self.memory.item(_STATUSES)

    @property
    def commands_doubted(self) -> bool:
        """True while the commands do not explain how the boat moves."""
        return bool(self.record["commands_doubted"] > 0.0)

    @property
    def motion_doubted(self) -> bool:
        """True while GPS or compass are left out, or sensors contradict each other."""
        return bool(self.record["motion_doubted"] > 0.0)

    @property
    def doubts_wind(self) -> bool:
        """True while an anemometer is at fault, or silent after it was used."""
        return bool(self.memory[_WIND_REASON] > 0.0 or self.memory[_WIND_KNOWN] > 0.0) and (
            self.memory[_WIND_STATUS] != OK
        )

    def trusted(self, cmd: Array) -> Array:
        """Return the command (4,), or the last one that was trusted while it is in doubt."""
        return self.record["drives"]["trusted"].copy() if self.commands_doubted else cmd

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

    def state_dict(self) -> State:
        """Return all that is remembered, as one array, in the layout of ``INTEGRITY``."""
        return {"memory": self.memory.copy()}

    def load_state_dict(self, state: State) -> None:
        """Take over what :meth:`state_dict` returned.

        Raises
        ------
        StateError
            Names what is missing or damaged.
        """
        check_fields(state, {"memory": self.memory})
        fill({"memory": self.memory}, state)


def run_over(particulars: Particulars, t: Array, z: Array, cmd: Array) -> tuple[Array, Array]:
    """Run the checks over the rows of a log.

    Parameters
    ----------
    particulars : Particulars
        Of the boat.
    t, z, cmd : ndarray, shapes (N,), (N, 19), (N, 4)
        Times, s, measurements and commands.

    Returns
    -------
    statuses, reasons : ndarray, shape (N, 5)
        Of each sensor of ``twin.integrity.state.SENSORS`` after each row.
    """
    statuses, reasons = np.zeros((2, len(t), len(SENSORS)))
    memory, settings = initial_integrity(particulars), integrity_settings(particulars)
    held = np.nan_to_num(cmd)
    out, state = np.zeros(len(MEASUREMENTS)), np.zeros(6)
    t, z = np.ascontiguousarray(t), np.ascontiguousarray(z)
    _run_over(t, z, held, state, memory, settings, out, statuses, reasons)
    return statuses, reasons


@kernel
def _run_over(t, z, cmd, state, memory, settings, out, statuses, reasons):
    """Do :func:`run_over` on flat memory."""
    record, given = as_record(memory, INTEGRITY), as_record(settings, INTEGRITY_SETTINGS)
    for k in range(len(t)):
        check_sensors(t[k] - t[k - 1] if k else 0.0, z[k], cmd[k], state, False, record, given, out)
        for j in range(statuses.shape[1]):
            statuses[k, j], reasons[k, j] = record.sensors[j].status, record.sensors[j].reason
