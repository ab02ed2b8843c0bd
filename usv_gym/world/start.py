"""What is drawn of sea and faults where an episode begins, in compiled code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usv_gym.physics import GRAVITY, waves
from usv_gym.physics.weather import WEATHER
from usv_gym.vessel.vessel import Vessel
from usv_gym.world import streams
from usv_gym.world.faults import (
    FAULT,
    KEY_SIZE,
    Disturbance,
    Fault,
    fault_keys,
    fault_records,
    fault_text,
    memory_rows,
    start_streams,
)
from usv_gym.world.realisation import (
    GUST_COMPONENTS,
    drift_scratch,
    fill_rows,
    gust_rows,
    interpolated,
    pm_components,
    sum_drift,
    sum_regression,
)
from usv_gym.world.sea import DRIFT_WAVES, GUSTS, SeaState
from usv_gym.world.state import BOAT, SIMULATION, WORLD
from usv_kernel.arrays import shaped
from usv_kernel.jit import inlined, kernel
from usv_kernel.random import STREAM, below, fill_uniform, start_stream
from usv_kernel.records import Record, as_record, as_records, field_at, record_size

__all__ = ["SEA", "DriftTable", "FaultSets", "Seas", "draw_sea", "draw_start"]

SEA = np.dtype(
    [
        ("hs", float),  # m
        ("wind", float),  # m/s
        ("wind_from", float),  # rad
        ("waves_to", float),  # rad
        ("waves_follow", float),  # 1 if they turn with the wind
        ("current_north", float),  # m/s
        ("current_east", float),
        ("keyframes", float),
        ("components", float),  # of the waves
        ("tabled", float),  # 1 if their frequencies come from a table, see SeaState.frequencies
        ("spread", float),  # 1 if they go various ways, see SeaState.directions
        ("gusts", float),  # place of their spectrum; -1: none
        ("weather", WEATHER),  # without current and mean drift
        # waves whose mean drift is summed: see SeaState.drift_waves
        ("drift_waves", float, (3, DRIFT_WAVES)),
        # mean drift that was summed last, and of which kind, length and direction it is
        ("drift", float, (waves.LOAD_HEADINGS, 3)),
        ("drift_of", float, 3),
    ]
)
"""A sea state as kernels draw one sea of it."""

_WEATHER_AT = field_at(BOAT, "weather")
_SEA_WEATHER_AT = field_at(SEA, "weather")
_WEATHER_SIZE = record_size(WEATHER)


class Seas(NamedTuple):
    """Sea states, of which kernels draw seas."""

    rows: NDArray[np.float64]
    """Flat records (S, ...) of :data:`SEA`."""
    frequencies: NDArray[np.float64]
    """:attr:`SeaState.frequencies` (S, 3, P), filled up with the last."""
    directions: NDArray[np.float64]
    """:attr:`SeaState.directions` (S, 2, P), filled up with the last."""

    @classmethod
    def of(cls, states: Sequence[SeaState]) -> Seas:
        """Return those of sea states."""
        return cls(
            np.array([_sea_record(one) for one in states], SEA)
            .view(float)
            .reshape(len(states), -1),
            _stacked([one.frequencies for one in states]),
            _stacked([one.directions for one in states]),
        )


def _sea_record(state: SeaState) -> Record:
    """Return a record of :data:`SEA`."""
    record = np.zeros(1, SEA)[0]
    for name in ("hs", "wind", "wind_from", "waves_to"):
        record[name] = getattr(state, name)
    record["waves_follow"] = state.wave_to is None
    record["current_north"] = state.current * math.cos(state.current_to)
    record["current_east"] = state.current * math.sin(state.current_to)
    record["keyframes"] = max(len(state.schedule), 1)
    record["weather"] = state.mean_weather
    record["gusts"] = GUSTS.index(state.gusts) if state.gust_components else -1.0
    record["drift_of"] = math.nan
    record["tabled"], record["spread"] = state.frequencies.size > 0, state.spreading is not None
    if state.hs > 0.0:
        record["components"] = state.components
        record["drift_waves"] = state.drift_waves
    return record


def _stacked(tables: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return tables (R, P) as one array, the shorter ones filled up with their last column."""
    most = max(table.shape[1] for table in tables)
    filled = np.zeros((len(tables), len(tables[0]), most))
    for into, table in zip(filled, tables, strict=True):
        if table.size:
            into[:, : table.shape[1]], into[:, table.shape[1] :] = table, table[:, -1:]
    return filled


class DriftTable(NamedTuple):
    """Mean drift of a kind of boat."""

    omega: NDArray[np.float64]
    """Frequencies (F,), rad/s; F = 0: there is no table, and drift comes from a regression."""
    values: NDArray[np.float64]
    """Drift (F, K, 3), see :attr:`usv_gym.hydro.table.HydroTable.drift_around`."""
    scratch: NDArray[np.float64]
    length: float
    """Of the boat of the table, m."""
    reflected: NDArray[np.float64]
    """Of the regression, see :func:`usv_gym.world.realisation.reflected_share`."""

    @classmethod
    def of(cls, vessel: Vessel) -> DriftTable:
        """Return the table of a vessel."""
        table, reflected = vessel.hydro, np.zeros((2, 0))
        if table is None or table.drift_around is None:
            if vessel.two_hulls:  # waves pass below shallow pontoons
                k_draft = np.geomspace(1e-4, 20.0, 2001)
                reflected = np.stack([k_draft, waves.reflected_by_draft(k_draft, 1.0)])
            return cls(np.zeros(0), np.zeros((0, 0, 3)), np.zeros(0), 1.0, reflected)
        values = table.drift_around
        scratch = np.zeros(drift_scratch(values.shape))
        return cls(table.omega.copy(), values.copy(), scratch, table.length, reflected)


class FaultSets:
    """Sets of faults, of which each episode has one.

    Parameters
    ----------
    sets : sequence of sequence of Disturbance
        The sets; one is drawn if there are several.
    moving : sequence of sequence of bool, optional
        Which of these faults begin at random, the same time for all of an episode.
    span : tuple of float
        Between which times these begin, s.
    """

    def __init__(
        self,
        sets: Sequence[Sequence[Disturbance]],
        moving: Sequence[Sequence[bool]] | None = None,
        span: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.sets = tuple(tuple(one) for one in sets)
        self.moving = moving or [[False] * len(one) for one in self.sets]
        self.span, self.most = span, max(map(len, self.sets), default=0)
        self._texts = [
            None if any(moves) else "+".join(map(fault_text, one)) or "none"
            for one, moves in zip(self.sets, self.moving, strict=True)
        ]

    def text(self, number: int, start: float) -> str:
        """Return a set as a text, those that begin at random at ``start``, s."""
        fixed = self._texts[number]
        if fixed is not None:
            return fixed
        pairs = zip(self.sets[number], self.moving[number], strict=True)
        return "+".join(fault_text(fault, start if moves else None) for fault, moves in pairs)

    def memory_rows(self, dt: float) -> int:
        """Return how many rows they must remember, with control steps of dt s."""
        return max((memory_rows(one, dt) for one in self.sets), default=0)

    def arrays(self, dt: float) -> tuple[NDArray[Any], ...]:
        """Return what :func:`draw_start` takes, with control steps of dt s.

        These are flat records (C, F of FAULT), starting with NaN where there is none; their keys
        (C, F, 4); durations (C, F) of those that begin at random, else 0; and the span (2,).
        """
        shape = len(self.sets), self.most
        records, durations = np.zeros(shape, FAULT), np.zeros(shape)
        keys = np.zeros((*shape, KEY_SIZE), np.uint64)
        records["start"] = math.nan
        for c, faults in enumerate(self.sets):
            records[c, : len(faults)] = fault_records(faults, dt)
            keys[c, : len(faults)] = fault_keys(faults)
            for k, (fault, moves) in enumerate(zip(faults, self.moving[c], strict=True)):
                if moves and isinstance(fault, Fault):
                    durations[c, k] = fault.duration
        flat = records.view(float).reshape(shape[0], -1)
        return flat, keys, durations, np.array(self.span)


@inlined
def _draw_faults(row, world, config, states, sets, scratch):
    """Draw one of the sets of faults of a boat, when it begins, and start their generators."""
    table, keys, durations, span = sets
    stream, count = scratch[2, STREAM : 2 * STREAM], table.shape[0]
    numbers = shaped(row, config.faults_at, (1,))
    start_stream(states[streams.FAULTS], stream)
    fill_uniform(stream, numbers)
    world.fault_start = span[0] + (span[1] - span[0]) * numbers[0]
    chosen = below(stream, count) if count > 1 else 0
    world.faults = chosen
    for k in range(table.shape[1]):
        row[config.faults_at + k] = table[chosen, k]
    faults = as_records(row, config.faults_at, config.fault_count, FAULT)
    used = 0
    while used < faults.shape[0] and not math.isnan(faults[used].start):
        if durations[chosen, used] > 0.0:
            faults[used].start = world.fault_start
            faults[used].end = world.fault_start + durations[chosen, used]
        used += 1
    start_streams(states[streams.FAULT_SEEDS], keys[chosen], scratch, faults[:used])


@inlined
def _draw_waves(row, config, sea, p, stream, to, frequencies, directions):
    """Draw the components of waves that go ``to``, on the whole."""
    width, count = int(config.wave_components), int(sea.components)
    rows = shaped(row, config.waves_at, (waves.WAVE_ROWS, width))
    rows[:] = 0.0
    if count == 0:
        return
    omega, phase = rows[waves.OMEGA, :count], rows[waves.PHASE, :count]
    amplitude, aside = rows[waves.AMPLITUDE, :count], rows[waves.K_NORTH, :count]
    fill_uniform(stream, omega)
    fill_uniform(stream, phase)
    amplitude[:] = sea.hs / math.sqrt(8.0 * count)
    if sea.tabled > 0.0:
        _draw_frequencies(sea.hs, frequencies, omega, amplitude)
    else:
        pm_components(sea.hs, omega)
    if sea.spread > 0.0:
        _draw_directions(stream, directions, aside, rows[waves.K_EAST, :count])
    for i in range(count):
        phase[i] *= 2.0 * math.pi
        direction = to + aside[i]
        rows[waves.K_NORTH, i], rows[waves.K_EAST, i] = math.cos(direction), math.sin(direction)
    fill_rows(rows, count, p.water_density * GRAVITY, p.draft)


@inlined
def _draw_frequencies(hs, table, omega, amplitude):
    """Replace uniform numbers (M,) by frequencies (rad/s), and write the amplitudes (m).

    One lies at random in each of M bins: the sea never repeats.
    """
    count, total = omega.shape[0], 0.0
    for i in range(count):
        number = (i + omega[i]) / count
        omega[i] = interpolated(number, table[0], table[1])
        amplitude[i] = interpolated(number, table[0], table[2])
        total += amplitude[i]
    for i in range(count):
        amplitude[i] = hs * math.sqrt(amplitude[i] / (8.0 * total))


@inlined
def _draw_directions(stream, table, aside, scratch):
    """Draw directions off the mean (M,), rad: one in each of M bins of equal energy, shuffled.

    Source of the shuffle: Durstenfeld 1964 (Algorithm 235).
    """
    count = aside.shape[0]
    fill_uniform(stream, aside)
    fill_uniform(stream, scratch)
    for i in range(count):
        aside[i] = interpolated((i + aside[i]) / count, table[0], table[1])
    for i in range(count - 1, 0, -1):
        k = int(scratch[i] * (i + 1))
        aside[i], aside[k] = aside[k], aside[i]


@inlined
def _draw_gusts(row, config, sea, stream):
    """Draw the components of the gusts."""
    rows = shaped(row, config.gusts_at, (3, config.gust_components))
    rows[:] = 0.0
    if sea.gusts >= 0.0:
        fill_uniform(stream, shaped(row, config.gusts_at, (2 * GUST_COMPONENTS,)))
        gust_rows(int(sea.gusts), sea.wind, rows)


@inlined
def _add_drift(weather, sea, p, kind, to, table):
    """Write the mean drift of waves that go ``to``; that of the last boat is kept."""
    omega, values, scratch, length, reflected = table
    if omega.shape[0] == 0:
        sum_regression(sea.drift_waves[:], to, p, reflected, weather.drift_sums[:])
        return
    same = sea.drift_of[0] == kind and sea.drift_of[1] == p.length_waterline
    if not (same and sea.drift_of[2] == to):
        scale = p.length_waterline / length
        sum_drift(sea.drift_waves, to, scale, (omega, values, scratch), sea.drift)
        sea.drift_of[0], sea.drift_of[1], sea.drift_of[2] = kind, p.length_waterline, to
    for h in range(waves.LOAD_HEADINGS):
        for j in range(3):
            weather.drift_table[h, j] = sea.drift[h, j]
    weather.drift_tabled = 1.0


@inlined
def _draw_sea(row, config, begin, number, seas, table, states, stream):
    """Draw waves and gusts of a sea state, and write them and the weather to a boat's row."""
    boat = as_record(row, BOAT)
    rows, frequencies, directions = seas
    sea, weather, p = as_record(rows[number], SEA), boat.weather, boat.vessel
    for k in range(_WEATHER_SIZE):
        row[_WEATHER_AT + k] = rows[number, _SEA_WEATHER_AT + k]
    turn = 0.0 if math.isnan(begin.wind_from) else begin.wind_from - sea.wind_from
    for k in range(int(sea.keyframes)):
        weather.wind_from[k] += turn
    weather.current_north, weather.current_east = begin.current_north, begin.current_east
    if math.isnan(begin.current_north):
        weather.current_north, weather.current_east = sea.current_north, sea.current_east
    to = sea.waves_to + (turn if sea.waves_follow > 0.0 else 0.0)
    start_stream(states[streams.WAVES], stream)
    _draw_waves(row, config, sea, p, stream, to, frequencies[number], directions[number])
    start_stream(states[streams.GUSTS], stream)
    _draw_gusts(row, config, sea, stream)
    if sea.components > 0.0:
        _add_drift(weather, sea, p, begin.kind, to, table)


@kernel
def draw_sea(
    row: np.ndarray,
    world: np.ndarray,
    shared: np.ndarray,
    states: np.ndarray,
    seas: tuple[np.ndarray, ...],
    table: tuple[Any, ...],
    scratch: np.ndarray,
) -> None:
    """Draw a sea of the first of ``seas``, and write it to a boat's row, see :func:`draw_start`."""
    begin, config = as_record(world, WORLD), as_record(shared, SIMULATION)
    _draw_sea(row, config, begin, 0, seas, table, states, scratch[2, STREAM : 2 * STREAM])


@kernel
def draw_start(
    row: np.ndarray,
    world: np.ndarray,
    shared: np.ndarray,
    states: np.ndarray,
    seas: tuple[np.ndarray, ...],
    table: tuple[Any, ...],
    sets: tuple[np.ndarray, ...],
    scratch: np.ndarray,
) -> None:
    """Draw sea and faults of one boat, and write them to its row.

    ``world`` is flat memory of WORLD, where is noted what was drawn. ``states`` (11 or more, 4)
    start generators in the order of ``streams.KEYS``. ``seas`` and ``table`` hold the fields of
    :class:`Seas` and :class:`DriftTable`, ``sets`` are :meth:`FaultSets.arrays`. ``scratch`` (4, 8)
    is uint64.
    """
    begin, config = as_record(world, WORLD), as_record(shared, SIMULATION)
    stream, number = scratch[2, STREAM : 2 * STREAM], 0
    if seas[0].shape[0] > 1:
        start_stream(states[streams.SEA], stream)
        number = below(stream, seas[0].shape[0])
    begin.sea = number
    _draw_sea(row, config, begin, number, seas, table, states, stream)
    if config.fault_count > 0:
        _draw_faults(row, begin, config, states, sets, scratch)
