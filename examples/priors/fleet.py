"""A fleet of simulated boats, and the nets that learn from it: LSTM and transformer.

Each boat sails a few manoeuvres in seas of its own, with noisy sensors that fail at times. A net
sees the output of the navigation filter, and has to predict the truth. Boats, seas and sensors are
drawn apart from those of the benchmark. See docs/explanation/twin.md, Learned predictors.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
import torch
from joblib import Memory, Parallel, delayed
from population import random_boat
from torch import nn

from twin.model.priors import KINDS
from twin.particulars import Particulars
from twin.predictors.baselines import ACTUATORS, COMMANDED, GRID, VELOCITIES
from twin.predictors.learned.pretrained import (
    AHEAD,
    PAST,
    PATCH,
    ROW,
    STEP,
    TOKEN,
    FleetPredictor,
    Weights,
    tokens,
)
from twin.sim.bridge import CONTROL_STEP_S, particulars_of, simulate
from usv_gym.manoeuvring.manoeuvres import ANGLE, APPROACH, LEG, SWITCH
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Bursts, Fault, RandomFaults
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite

BOATS, RUNS, SPAN_S = 320, 3, 120.0  # boats of the fleet, runs of each, and their length
STREAM, SEED = 7051, 0  # of all random draws; the first is larger than any seed of the benchmark
SLOWEST_S = 15.0  # longest time in which a boat of the fleet sails its length
SEAS = ((0.0, 0.0), (0.05, 2.0), (0.3, 3.5), (0.88, 6.0), (1.88, 8.7))
"""Wave height (m) and wind (m/s) of sea states 0 to 4."""

BATCH, EACH = 32, 8  # windows of a batch, and of each run in it
WILD = 3.0  # velocities over their typical size above which a window is left out
DROPOUT, DECAY, LATE, HEADS = 0.1, 9.8e-4, 0.5, 4  # LATE: step k of a forecast weighs k**LATE
SETTINGS = {
    "lstm": {"width": 96, "layers": 2, "steps": 12288, "rate": 2.2e-3},
    "transformer": {"width": 96, "layers": 3, "steps": 8192, "rate": 9.5e-4},
}
"""Found by successive halving of 40 configurations each, on 60 other boats."""

TYPICAL = np.array([0.08, 0.08, 0.05, 0.03, 0.03, 0.04])
"""Errors of equal weight: of x and y (lengths), psi (rad), u and v (typical speeds), r."""

PAIRS = np.arange(COMMANDED.start, ACTUATORS.stop).reshape(-1, 2)
SWAPPED = np.r_[: COMMANDED.start, PAIRS[:, ::-1].ravel(), ACTUATORS.stop : ROW]
MIRROR = np.array([1, -1, -1, 1, -1, -1, *(1, 1, -1, -1) * 2, 1, 1, 1], dtype=np.float32)
"""A history seen in a mirror: left and right units change places, and sides their sign."""


class Run(NamedTuple):
    """A run as a net sees it, and as it was."""

    particulars: Particulars
    rows: np.ndarray  # (M, 17) history of the navigation filter
    truth: np.ndarray  # (M, 6) true states


def boat(rng):
    """Return a boat of the fleet: three in five vary around the usv75."""
    if rng.random() < 0.6:
        return Vessel.load("usv75").varied(rng, 0.2)
    while True:
        vessel, n = random_boat(str(rng.choice(KINDS)), rng)
        vessel = dataclasses.replace(vessel, values={**vessel.values, "shaft_speed_manoeuvring": n})
        if vessel.values["length_waterline"] < SLOWEST_S * vessel.straight_speed(n):
            return vessel


def commands(vessel, slow, rng):
    """Return the commands of a run: a manoeuvre of the benchmark, or throttle steps, at random."""
    t = CONTROL_STEP_S * np.arange(round(SPAN_S / CONTROL_STEP_S))
    kind = rng.choice(("turn", "zigzag", "turn-zigzag", "random", "throttle"))
    share, angle = np.full(len(t), rng.uniform(0.75, 1.05)), np.zeros(len(t))
    size = rng.uniform(0.4, 1.4) * ANGLE * rng.choice((-1.0, 1.0))
    begin, switch = rng.uniform(0.4, 2.0) * APPROACH, rng.uniform(0.3, 1.2) * SWITCH
    leg = rng.uniform(0.5, 1.6) * LEG * slow
    if kind == "throttle":
        angle[t >= begin] = rng.choice((0.0, size))
    elif kind != "zigzag":
        angle[t >= begin] = size
    if kind.endswith("zigzag"):
        first = begin if kind == "zigzag" else switch
        later = t >= first
        angle[later] = size * np.where((t[later] - first) // leg % 2 == 0, -1.0, 1.0)
    while kind in ("random", "throttle") and begin < SPAN_S:
        later = t >= begin
        share[later] = rng.uniform(0.3 if kind == "throttle" else 0.7, 1.05)
        if kind == "random":
            angle[later] = rng.uniform(-1.25, 1.25) * ANGLE
        begin += rng.uniform(3.0, 10.0) * slow
    angle = np.clip(angle, -vessel.helm_max, vessel.helm_max)
    return vessel.command(share * vessel.values["shaft_speed_manoeuvring"], angle)


def faults(rng):
    """Return losses of sensors: none in half of the runs."""
    draw, kind = rng.random(), str(rng.choice(("gps", "imu", "compass", "all")))
    if draw < 0.5:
        return ()
    if draw < 0.55:
        return (Fault(str(rng.choice(("imu", "compass"))), start=0.0, duration=2.0 * SPAN_S),)
    if draw < 0.65:
        return (Bursts(kind, loss=rng.uniform(0.05, 0.3), mean=rng.uniform(0.5, 5.0)),)
    return (RandomFaults(kind, gap=(10.0, 40.0), duration=(2.0, 25.0)),)


def sail_boat(i):
    """Return the runs of the i-th boat of the fleet."""
    rng = np.random.default_rng([STREAM, SEED, i])
    vessel, runs = boat(rng), []
    for _ in range(RUNS):
        suite = SensorSuite.grade(str(rng.choice(("typical", "typical", "best"))))
        particulars = particulars_of(vessel, suite)
        hs, wind = SEAS[rng.integers(len(SEAS))]
        # small boats get no gale
        calm = min(1.0, 0.15 * particulars.length / max(hs, 1e-9))
        sea = SeaState(hs=calm * hs, wind=math.sqrt(calm) * wind, wind_from=rng.uniform(0, 6.28))
        # the manoeuvres of the study boat are those of the benchmark
        slow = max(particulars.time_scale, 1.0)
        log = simulate(
            commands(vessel, math.sqrt(slow), rng), vessel=vessel, sea=sea, duration=SPAN_S,
            seed=int(rng.integers(2**62)), faults=faults(rng), suite=suite,
        )  # fmt: skip
        runs.append(seen(log, particulars))
    return [run for run in runs if len(run.rows) > 2 * AHEAD * PATCH]


class History(FleetPredictor):
    """Keeps the history that a net would see, and knows no net."""

    look_back = math.inf

    def __init__(self, particulars):
        super(FleetPredictor, self).__init__(particulars)


def seen(log, particulars):
    """Return a log with its truth as a net sees it."""
    history, before = History(particulars), math.nan
    for t, z, cmd in log:
        history.update(t, 0.0 if math.isnan(before) else t - before, z, cmd)
        before = t
    rows = history.rows.reshape(-1, ROW)
    # the grid begins with the first row that the navigation was ready for
    times = history._next - GRID * np.arange(len(rows), 0, -1)
    columns = [*log.truth.T]
    columns[2] = np.unwrap(columns[2])
    truth = np.stack([np.interp(times, log.t, column) for column in columns], axis=1)
    return Run(particulars, rows.astype(np.float32), truth.astype(np.float32))


class LSTM(nn.Module):
    """From tokens to increments of velocities (B, AHEAD, 3 PATCH)."""

    def __init__(self, width, layers):
        super().__init__()
        between = DROPOUT if layers > 1 else 0.0
        self.body = nn.LSTM(TOKEN, width, layers, batch_first=True, dropout=between)
        self.dropout = nn.Dropout(DROPOUT)
        self.read = nn.Linear(width + TOKEN, 3 * PATCH)

    def forward(self, x):
        h = self.dropout(self.body(x)[0][:, PAST:])
        return self.read(torch.cat([h, x[:, PAST:]], dim=2))


class Layer(nn.Module):
    """A layer of causal attention."""

    def __init__(self, width):
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.mix = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.up, self.down = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)
        self.dropout = nn.Dropout(DROPOUT)

    def forward(self, x):
        B, T, width = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(B, T, 3, HEADS, -1).permute(2, 0, 3, 1, 4)
        mixed = nn.functional.scaled_dot_product_attention(q, k, v, is_causal=True)
        x = x + self.dropout(self.mix(mixed.transpose(1, 2).reshape(B, T, width)))
        return x + self.dropout(self.down(nn.functional.relu(self.up(self.norm2(x)))))


class Transformer(nn.Module):
    """As :class:`LSTM`."""

    def __init__(self, width, layers):
        super().__init__()
        self.embed = nn.Linear(TOKEN, width)
        self.place = nn.Parameter(0.02 * torch.randn(PAST + AHEAD, width))
        self.register_buffer("heads", torch.zeros(HEADS))
        self.layers = nn.ModuleList(Layer(width) for _ in range(layers))
        self.norm, self.read = nn.LayerNorm(width), nn.Linear(width + TOKEN, 3 * PATCH)

    def forward(self, x):
        h = self.embed(x) + self.place
        for layer in self.layers:
            h = layer(h)
        return self.read(torch.cat([self.norm(h[:, PAST:]), x[:, PAST:]], dim=2))


def batch(fleet, rng):
    """Return windows of the fleet, some of them seen in a mirror.

    They are tokens (B, PAST + AHEAD, TOKEN), u, v, r at the start over their typical size (B, 3),
    lengths sailed in a grid step at the typical speed (B, 1), and the true ends of the steps in the
    boat's frame at the start (B, AHEAD * PATCH, 6): lengths, rad, typical sizes.
    """
    parts = []
    for i in rng.integers(len(fleet), size=BATCH // EACH):
        run, ahead = fleet[i], AHEAD * PATCH
        U, L = run.particulars.speed, run.particulars.length
        origins = rng.integers(PATCH, len(run.rows) - ahead, size=EACH)
        rows, true = run.rows, run.truth
        if rng.random() < 0.5:
            rows, true = rows[:, SWAPPED] * MIRROR, true * MIRROR[:6]
        window, known = FleetPredictor.windows(rows, origins)
        later = origins[:, None] + np.arange(1, ahead + 1)
        x = tokens(window, known, rows[later, ACTUATORS], run.particulars)
        moved, at = true[later], true[origins]
        moved[..., :3] -= at[:, None, :3]
        c, s = np.cos(at[:, 2:3]), np.sin(at[:, 2:3])
        east = moved[..., 1].copy()
        moved[..., 1] = c * east - s * moved[..., 0]
        moved[..., 0] = c * moved[..., 0] + s * east
        moved /= [L, L, 1.0, U, U, U / L]
        start = window[:, -1, VELOCITIES] / [U, U, U / L]
        wild = np.abs(np.concatenate([start, moved[..., 3:].reshape(EACH, -1)], axis=1)) > WILD
        tame = ~wild.any(axis=1)
        sailed = np.full((EACH, 1), GRID * U / L)
        parts.append([a[tame] for a in (x, start, sailed, moved)])
    return [
        torch.from_numpy(np.concatenate(p).astype(np.float32)) for p in zip(*parts, strict=True)
    ]


def roll(said, start, sailed):
    """Return the paths (B, steps, 6) that a net's answer means, as the truth of :func:`batch`."""
    said = said.reshape(len(said), -1, 3)
    nu = start[:, None] + STEP * sailed[:, None] * torch.cumsum(said, dim=1)
    before = torch.cat([start[:, None], nu[:, :-1]], dim=1)
    u, v, r = (0.5 * (nu + before)).unbind(dim=2)
    psi = torch.cumsum(sailed * r, dim=1)
    middle = psi - 0.5 * sailed * r
    c, s = torch.cos(middle), torch.sin(middle)
    x = torch.cumsum(sailed * (u * c - v * s), dim=1)
    y = torch.cumsum(sailed * (u * s + v * c), dim=1)
    return torch.cat([torch.stack([x, y, psi], dim=2), nu], dim=2)


def train(kind, fleet, state, steps):
    """Return the weights of a net that learned from a fleet; ``state`` keeps what is not done.

    AdamW; the rate is warmed up over 5 % of the steps, and a cosine ends at 0.
    """
    width, layers, rate = (SETTINGS[kind][name] for name in ("width", "layers", "rate"))
    torch.set_num_threads(1)  # sums of several threads round differently
    torch.manual_seed(SEED)
    net = {"lstm": LSTM, "transformer": Transformer}[kind](width, layers)
    nn.init.zeros_(net.read.weight)  # it starts from persistence
    nn.init.zeros_(net.read.bias)
    optimiser, done = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=DECAY), 0
    if state.exists():
        before = torch.load(state, weights_only=True)
        net.load_state_dict(before["net"])
        optimiser.load_state_dict(before["optimiser"])
        done = before["done"]
    late = np.arange(1, AHEAD * PATCH + 1) ** LATE
    weight = torch.from_numpy(((late / late.mean())[:, None] / TYPICAL).astype(np.float32))
    for step in range(done, steps):
        torch.manual_seed((SEED << 32) + step + 1)  # the same dropout masks where it goes on
        for group in optimiser.param_groups:
            warm = min(1.0, 20.0 * (step + 1) / steps)
            group["lr"] = rate * warm * (0.5 + 0.5 * math.cos(math.pi * step / steps))
        x, start, sailed, truth = batch(fleet, np.random.default_rng([STREAM, SEED, step, 1]))
        loss = torch.mean(torch.abs(roll(net(x), start, sailed) - truth) * weight)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        if (step + 1) % 200 == 0:
            print(f"{kind}: step {step + 1} of {steps}, loss {float(loss):.3f}", flush=True)
            kept = {"net": net.state_dict(), "optimiser": optimiser.state_dict(), "done": step + 1}
            torch.save(kept, state.with_suffix(".part"))
            state.with_suffix(".part").replace(state)
    arrays = {key: value.numpy().copy() for key, value in net.state_dict().items()}
    settings = {**SETTINGS[kind], "kind": kind, "seed": SEED, "boats": BOATS, "runs": RUNS,
                "batch": BATCH, "decay": DECAY, "dropout": DROPOUT, "late": LATE,
                "steps": steps, "sailed": len(fleet)}  # fmt: skip
    return Weights(kind, SEED, settings, arrays)


def make_weights(kind, work, jobs=1, boats=BOATS, steps=None):
    """Sail the fleet and train a net; ``work`` keeps what an earlier call has done."""
    sail = Memory(work, verbose=0).cache(sail_boat)
    fleet = Parallel(n_jobs=jobs)(delayed(sail)(i) for i in range(boats))
    runs = [run for own in fleet for run in own]
    return train(kind, runs, work / f"{kind}.pt", steps or SETTINGS[kind]["steps"])
