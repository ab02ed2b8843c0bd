"""Rows of many boats, taken in one compiled call: sensor checks, motion of the deck, predictor."""

from __future__ import annotations

from twin.filters.navigation_state import NAVIGATION
from twin.integrity.sensing import ROW, Boats, sense
from twin.model.structure import N_STATES, ModelTerms
from twin.predictors.plus_update import PlusMemory, PlusWork, plus_config_of, plus_step
from twin.predictors.ukf import UKFConfig, UKFMemory, UKFWork, tight_step
from usv_kernel.jit import inlined, kernel
from usv_kernel.records import as_record

__all__ = ["STEPS", "plus_memory", "take_plus", "take_ukf", "ukf_config_of", "ukf_memory"]


@inlined
def ukf_memory(memories, i):
    """Return what boat i remembers."""
    return UKFMemory(memories[0][i], memories[1][i])


@inlined
def plus_memory(memories, i):
    """Return what boat i remembers."""
    nav, tight, rows, window, selector, segments, joint = memories
    return PlusMemory(nav[i], tight[i], rows[i], window[i], selector[i], segments[i], joint[i])


@inlined
def ukf_config_of(config):
    """Return a configuration by name from a plain tuple."""
    return UKFConfig(config[0], config[1], ModelTerms(*config[2]))


@inlined
def _sense(i, nav, boats):
    """Do :func:`sense` for a boat with a navigation filter, and tell it of what is in doubt."""
    health = as_record(boats.rows[i], ROW).health
    dt = sense(i, nav.n[:N_STATES], nav.begun > 0.0, boats, nav.restart)
    nav.commands_doubted, nav.motion_doubted = health.commands_doubted, health.motion_doubted
    return dt


@inlined
def take_ukf(i, boats, memory, config, work):
    """Let boat i take its row, if it is new; return the time since the row before, s, or -1."""
    row, nav = as_record(boats.rows[i], ROW), as_record(memory.nav, NAVIGATION)
    dt = _sense(i, nav, boats)
    if dt >= 0.0:
        tight_step(dt, row.used[:], row.trusted[:], memory, config, work)
        row.lost_at = row.t if nav.lost > 0.0 else row.lost_at
    return dt


@inlined
def take_plus(i, boats, memory, config, work):
    """Do for ``dsw-ukf-plus`` what :func:`take_ukf` does for ``ukf``."""
    row, nav = as_record(boats.rows[i], ROW), as_record(memory.nav, NAVIGATION)
    dt = _sense(i, nav, boats)
    if dt >= 0.0:
        plus_step(row.t, dt, row.used[:], row.trusted[:], memory, config, work)
        row.lost_at = row.t if nav.lost > 0.0 else row.lost_at
    return dt


@kernel
def _step_ukf(boats, memories, config, work):
    """Let all boats with a new row take it; plain tuples, which numba takes much faster."""
    boats, config, work = Boats(*boats), ukf_config_of(config), UKFWork(*work)
    for i in range(boats.rows.shape[0]):
        take_ukf(i, boats, ukf_memory(memories, i), config, work)


@kernel
def _step_plus(boats, memories, config, work):
    """Do for ``dsw-ukf-plus`` what :func:`_step_ukf` does for ``ukf``."""
    boats, config, work = Boats(*boats), plus_config_of(config), PlusWork(*work)
    for i in range(boats.rows.shape[0]):
        take_plus(i, boats, plus_memory(memories, i), config, work)


STEPS = {"UKFPredictor": _step_ukf, "PlusPredictor": _step_plus}
"""By the names of the classes of ``twin.predictors.ukf`` and ``twin.predictors.dsw_ukf_plus``."""
