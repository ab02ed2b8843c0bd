"""A fleet of simulated boats, and the nets that learn from it: ``python -m twin.training.fleet``.

Each boat sails a few manoeuvres in seas of its own, with noisy sensors that fail at times. A net
sees the output of the navigation filter, and has to predict the truth. Boats, seas and sensors are
drawn apart from those of the benchmark.

Training stops at Ctrl-C and goes on where it was, at the next call. The result depends on seed and
settings alone (and on the machine's arithmetic).

Source: docs/explanation/twin.md, Learned predictors; boats, nets and training are ours.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from joblib import Parallel, delayed
from numpy.typing import NDArray
from rich.progress import track

from twin.files import read_archive
from twin.model.priors import KINDS
from twin.particulars import Particulars
from twin.predictors.baselines import ACTUATORS, COMMANDED, GRID, VELOCITIES
from twin.predictors.learned.lstm import import_torch, undisturbed
from twin.predictors.learned.pretrained import (
    AHEAD,
    PAST,
    PATCH,
    ROW,
    STEP,
    TOKEN,
    FleetLSTM,
    FleetPredictor,
    FleetTransformer,
    Weights,
    gated,
    tokens,
)
from twin.sim.bridge import CONTROL_STEP, particulars_of, simulate
from twin.training.prior_population import random_boat
from usv_gym.manoeuvring.manoeuvres import ANGLE, APPROACH, LEG, SWITCH
from usv_gym.vessel.vessel import Vessel
from usv_gym.world.faults import Bursts, Disturbance, Fault, RandomFaults
from usv_gym.world.sea import SeaState
from usv_gym.world.sensors import SensorSuite
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import replacing

__all__ = [
    "FleetError",
    "FleetSettings",
    "Run",
    "make_net",
    "sail_boat",
    "sail_fleet",
    "train",
]

Array = NDArray[Any]

NETS: dict[str, type[FleetPredictor]] = {"lstm": FleetLSTM, "transformer": FleetTransformer}

_FLEET = 7051
"""First seed of all random draws, larger than any seed of the benchmark."""

SPAN = 120.0
"""Length of a run, s."""

SLOWEST = 15.0
"""Longest time, s, in which a boat of the fleet sails its length: slower ones hardly move."""

SEAS = ((0.0, 0.0), (0.05, 2.0), (0.3, 3.5), (0.88, 6.0), (1.88, 8.7))
"""Wave height (m, the middle of the WMO's range) and about the wind (m/s) of sea states 0 to 4."""

HEADS = 4
"""Heads of a transformer's attention."""

EACH = 8
"""Windows of a run in a batch."""

WILD = 3.0
"""Velocities over their typical size above which a window is left out."""

_PAIRS = np.arange(COMMANDED.start, ACTUATORS.stop).reshape(-1, 2)
SWAPPED = np.r_[: COMMANDED.start, _PAIRS[:, ::-1].ravel(), ACTUATORS.stop : ROW]
"""Columns of a history with left and right units exchanged."""

MIRROR = np.array([1, -1, -1, 1, -1, -1, *(1, 1, -1, -1) * 2, 1, 1, 1], dtype=np.float32)
"""A history seen in a mirror: left and right units change places, and sides their sign."""

TYPICAL = np.array([0.08, 0.08, 0.05, 0.03, 0.03, 0.04])
"""Errors of equal weight: of x and y (lengths), psi (rad), u and v (typical speeds), r."""


class FleetError(UsvTwinError):
    """A training that cannot start; the message says why."""


@dataclass(frozen=True, kw_only=True)
class FleetSettings:
    """How a net is trained.

    Parameters
    ----------
    kind : str
        ``lstm`` or ``transformer``.
    seed : int
        Of boats, initial weights and batches.
    boats, runs : int
        Boats of the fleet, and runs of each.
    width, layers : int
        Size of the net.
    steps, batch : int
        Steps of the optimiser, and windows in each.
    rate, decay : float
        Largest learning rate of AdamW (warmed up over 5 % of the steps, a cosine ends at 0)
        and its weight decay.
    dropout : float
        Share of hidden numbers that are left out in training.
    late : float
        The loss weighs the k-th step of a prediction by k**late.
    gate : float
        As of :func:`twin.predictors.learned.pretrained.gated`.
    """

    kind: str = "lstm"
    seed: int = 0
    boats: int = 320
    runs: int = 3
    width: int = 64
    layers: int = 1
    steps: int = 3000
    batch: int = 128
    rate: float = 1e-2
    decay: float = 1e-2
    dropout: float = 0.0
    late: float = 0.0
    gate: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in NETS:
            raise FleetError(f"no net is called {self.kind!r}; known: {', '.join(NETS)}")
        for name in ("boats", "runs", "width", "layers", "steps", "batch"):
            if getattr(self, name) < 1:
                raise FleetError(f"{name} = {getattr(self, name)}: must be 1 or more")


SHIPPED = {
    "lstm": FleetSettings(
        width=96, layers=2, steps=12288, batch=32, rate=2.2e-3, decay=9.8e-4, dropout=0.1, late=0.5
    ),
    "transformer": FleetSettings(
        kind="transformer",
        width=96,
        layers=3,
        steps=8192,
        batch=32,
        rate=9.5e-4,
        decay=9.8e-4,
        dropout=0.1,
        late=0.5,
    ),
}
"""Settings of the weights that ship."""


@dataclass(frozen=True)
class Run:
    """A run as a net sees it, and as it was.

    Parameters
    ----------
    particulars : Particulars
        Of the boat.
    rows : ndarray, shape (M, 17)
        History, as in ``twin.predictors.learned.pretrained.tokens``.
    truth : ndarray, shape (M, 6)
        True states at the rows.
    """

    particulars: Particulars
    rows: Array
    truth: Array


def _boat(rng: np.random.Generator) -> Vessel:
    """Return a boat of the fleet: three in five vary around the usv75."""
    if rng.random() < 0.6:
        return Vessel.load("usv75").varied(rng, 0.2)
    while True:
        vessel, n = random_boat(str(rng.choice(KINDS)), rng)
        vessel = dataclasses.replace(vessel, values={**vessel.values, "shaft_speed_manoeuvring": n})
        if vessel.values["length_waterline"] < SLOWEST * vessel.straight_speed(n):
            return vessel


def _commands(vessel: Vessel, slow: float, rng: np.random.Generator) -> Array:
    """Return the commands of a run: a manoeuvre of the benchmark, or throttle steps, at random."""
    t = CONTROL_STEP * np.arange(round(SPAN / CONTROL_STEP))
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
    while kind in ("random", "throttle") and begin < SPAN:
        later = t >= begin
        share[later] = rng.uniform(0.3 if kind == "throttle" else 0.7, 1.05)
        if kind == "random":
            angle[later] = rng.uniform(-1.25, 1.25) * ANGLE
        begin += rng.uniform(3.0, 10.0) * slow
    angle = np.clip(angle, -vessel.helm_max, vessel.helm_max)
    return vessel.command(share * vessel.values["shaft_speed_manoeuvring"], angle)


def _faults(rng: np.random.Generator) -> tuple[Disturbance, ...]:
    """Return losses of sensors: none in half of the runs."""
    draw, kind = rng.random(), str(rng.choice(("gps", "imu", "compass", "all")))
    if draw < 0.5:
        return ()
    if draw < 0.55:
        return (Fault(str(rng.choice(("imu", "compass"))), start=0.0, duration=2.0 * SPAN),)
    if draw < 0.65:
        return (Bursts(kind, loss=rng.uniform(0.05, 0.3), mean=rng.uniform(0.5, 5.0)),)
    return (RandomFaults(kind, gap=(10.0, 40.0), duration=(2.0, 25.0)),)


def sail_boat(seed: int, i: int, runs: int) -> list[Run]:
    """Return the runs of one boat of the fleet.

    Parameters
    ----------
    seed, i : int
        Seed of the fleet, and number of the boat.
    runs : int
        How many.
    """
    rng = np.random.default_rng([_FLEET, seed, i])
    vessel, out = _boat(rng), []
    for _ in range(runs):
        suite = SensorSuite.grade(str(rng.choice(("typical", "typical", "best"))))
        particulars = particulars_of(vessel, suite)
        hs, wind = SEAS[rng.integers(len(SEAS))]
        # small boats get no gale
        calm = min(1.0, 0.15 * particulars.length / max(hs, 1e-9))
        sea = SeaState(hs=calm * hs, wind=math.sqrt(calm) * wind, wind_from=rng.uniform(0, 6.28))
        # the manoeuvres of the study boat are those of the benchmark
        slow = max(particulars.time_scale, 1.0)
        log = simulate(
            _commands(vessel, math.sqrt(slow), rng),
            vessel=vessel,
            sea=sea,
            duration=SPAN,
            seed=int(rng.integers(2**62)),
            faults=_faults(rng),
            suite=suite,
        )
        out.append(seen(log, particulars))
    return [run for run in out if len(run.rows) > 2 * AHEAD * PATCH]


class _Watch(FleetPredictor):
    """Keeps the history that a net would see, and knows no net."""

    look_back = math.inf  # type: ignore[assignment]

    def __init__(self, particulars: Particulars) -> None:
        super(FleetPredictor, self).__init__(particulars)


def seen(log: Any, particulars: Particulars) -> Run:
    """Return a log with its truth as a net sees it.

    Parameters
    ----------
    log : Log
        With the truth.
    particulars : Particulars
        Of the boat.
    """
    watch, before = _Watch(particulars), math.nan
    for t, z, cmd in log:
        watch.update(t, 0.0 if math.isnan(before) else t - before, z, cmd)
        before = t
    rows = np.array(watch._rows, dtype=np.float64).reshape(-1, ROW)
    # the grid begins with the first row that the navigation was ready for
    times = watch._next - GRID * np.arange(len(rows), 0, -1)
    columns = [*log.truth.T]
    columns[2] = np.unwrap(columns[2])
    truth = np.stack([np.interp(times, log.t, column) for column in columns], axis=1)
    return Run(particulars, rows, truth)


CHUNK = 20
"""Boats in one file."""


def sail_fleet(settings: FleetSettings, folder: Path, jobs: int = 1) -> list[Run]:
    """Simulate the fleet, or read what an earlier call has simulated.

    Parameters
    ----------
    settings : FleetSettings
        Seed, boats and runs are used.
    folder : Path
        Where finished parts are kept.
    jobs : int
        Processes; the result does not depend on it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    fleet: list[Run] = []
    for first in track(range(0, settings.boats, CHUNK), description="boats sail"):
        numbers = range(first, min(first + CHUNK, settings.boats))
        part = folder / f"fleet_{settings.seed}_{settings.runs}_{first}_{len(numbers)}.npz"
        if not part.exists():
            found = Parallel(n_jobs=jobs)(
                delayed(sail_boat)(settings.seed, i, settings.runs) for i in numbers
            )
            _keep([run for runs in found for run in runs], part)
        fleet += _kept(part)
    return fleet


def _keep(runs: list[Run], path: Path) -> None:
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            about=np.array([json.dumps(dataclasses.asdict(run.particulars)) for run in runs]),
            length=np.array([len(run.rows) for run in runs]),
            rows=np.concatenate([run.rows for run in runs]).astype(np.float32),
            truth=np.concatenate([run.truth for run in runs]).astype(np.float32),
        )


def _kept(path: Path) -> list[Run]:
    file = read_archive(path, FleetError, "part of a fleet", "delete it: it will be sailed again")
    ends = np.cumsum(file["length"])[:-1]
    parts = zip(
        file["about"], np.split(file["rows"], ends), np.split(file["truth"], ends), strict=True
    )
    return [Run(_boat_of(json.loads(str(about))), *run) for about, *run in parts]


def _boat_of(about: dict[str, Any]) -> Particulars:
    instruments = about.pop("instruments")
    return Particulars.from_tables(about, instruments)


def make_net(settings: FleetSettings, torch: Any) -> Any:
    """Return an untrained net: a torch module from tokens to increments, (B, AHEAD, 3 PATCH).

    Its weights have the names that :mod:`twin.predictors.learned.pretrained` knows.
    """
    nn, width = torch.nn, settings.width
    Module: Any = nn.Module

    class LSTM(Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            between = settings.dropout if settings.layers > 1 else 0.0
            self.body = nn.LSTM(TOKEN, width, settings.layers, batch_first=True, dropout=between)
            self.dropout = nn.Dropout(settings.dropout)
            self.read = nn.Linear(width + TOKEN, 3 * PATCH)

        def forward(self, x: Any) -> Any:
            return self.read(
                torch.cat([self.dropout(self.body(x)[0][:, PAST:]), x[:, PAST:]], dim=2)
            )

    class Layer(Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
            self.qkv, self.mix = nn.Linear(width, 3 * width), nn.Linear(width, width)
            self.up, self.down = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)
            self.dropout = nn.Dropout(settings.dropout)

        def forward(self, x: Any) -> Any:
            B, T = x.shape[:2]
            q, k, v = self.qkv(self.norm1(x)).view(B, T, 3, HEADS, -1).permute(2, 0, 3, 1, 4)
            seen = nn.functional.scaled_dot_product_attention(q, k, v, is_causal=True)
            x = x + self.dropout(self.mix(seen.transpose(1, 2).reshape(B, T, width)))
            return x + self.dropout(self.down(nn.functional.relu(self.up(self.norm2(x)))))

    class Transformer(Module):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.embed = nn.Linear(TOKEN, width)
            self.place = nn.Parameter(0.02 * torch.randn(PAST + AHEAD, width))
            self.register_buffer("heads", torch.zeros(HEADS))
            self.layers = nn.ModuleList(Layer() for _ in range(settings.layers))
            self.norm, self.read = nn.LayerNorm(width), nn.Linear(width + TOKEN, 3 * PATCH)

        def forward(self, x: Any) -> Any:
            h = self.embed(x) + self.place
            for layer in self.layers:
                h = layer(h)
            return self.read(torch.cat([self.norm(h[:, PAST:]), x[:, PAST:]], dim=2))

    net: Any = {"lstm": LSTM, "transformer": Transformer}[settings.kind]()
    # it starts from persistence
    nn.init.zeros_(net.read.weight)
    nn.init.zeros_(net.read.bias)
    return net


def batch(fleet: list[Run], size: int, rng: np.random.Generator) -> tuple[Array, ...]:
    """Return windows of the fleet, some of them seen in a mirror.

    Parameters
    ----------
    fleet : list of Run
        What to draw from.
    size : int
        About how many.
    rng : numpy.random.Generator
        Draws runs, origins and mirrors.

    Returns
    -------
    x : ndarray, shape (B, PAST + AHEAD, TOKEN)
        Tokens.
    start : ndarray, shape (B, 3)
        u, v, r that a roll-out starts from, over their typical size.
    sailed : ndarray, shape (B, 1)
        Lengths travelled in a grid step at the typical speed.
    truth : ndarray, shape (B, AHEAD * PATCH, 6)
        True ends of the steps in the boat's frame at the start: lengths, rad, typical sizes.
    """
    parts = []
    for i in rng.integers(len(fleet), size=max(size // EACH, 1)):
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
        keep = ~wild.any(axis=1)
        sailed = np.full((EACH, 1), GRID * U / L)
        parts.append([a[keep] for a in (x, start, sailed, moved)])
    return tuple(np.concatenate(p).astype(np.float32) for p in zip(*parts, strict=True))


def roll(said: Any, start: Any, sailed: Any, torch: Any) -> Any:
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


def train(
    settings: FleetSettings, fleet: list[Run], folder: Path, *, every: int = 25, name: str = ""
) -> Weights:
    """Train a net on a fleet; go on from where an earlier call stopped.

    Parameters
    ----------
    settings : FleetSettings
        What to train, and how.
    fleet : list of Run
        What to learn from.
    folder : Path
        Where the state of the training is kept.
    every : int
        Steps between two savings.
    name : str
        What the bar of progress is called, if not after the net.

    Returns
    -------
    Weights

    Raises
    ------
    MissingTorch
        Torch is not installed.
    """
    torch = import_torch("the training of nets")
    folder.mkdir(parents=True, exist_ok=True)
    about = json.dumps([dataclasses.asdict(settings), len(fleet), TOKEN])
    state = folder / f"{settings.kind}_{hashlib.sha256(about.encode()).hexdigest()[:12]}.pt"
    with undisturbed(torch):
        torch.manual_seed(settings.seed)
        net = make_net(settings, torch)
        optimiser = torch.optim.AdamW(
            net.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        done = 0
        if state.exists():
            try:
                kept = torch.load(state, weights_only=True)
                net.load_state_dict(kept["net"])
                optimiser.load_state_dict(kept["optimiser"])
                done = int(kept["done"])
            except Exception:  # damaged files fail in many ways
                raise FleetError(f"{state}: is damaged; delete it to train again") from None
        late = np.arange(1, AHEAD * PATCH + 1) ** settings.late
        weight = torch.from_numpy(((late / late.mean())[:, None] / TYPICAL).astype(np.float32))
        for step in _counted(done, settings, name or f"{settings.kind} learns"):
            # a resumed training uses the same dropout masks as an uninterrupted one
            torch.manual_seed((settings.seed << 32) + step + 1)
            share = step / settings.steps
            for group in optimiser.param_groups:
                warm = min(1.0, 20.0 * (step + 1) / settings.steps)
                group["lr"] = settings.rate * warm * (0.5 + 0.5 * math.cos(math.pi * share))
            rng = np.random.default_rng([_FLEET, settings.seed, step, 1])
            x, *rest = batch(fleet, settings.batch, rng)
            inputs = torch.from_numpy(gated(x, settings.gate))
            start, sailed, truth = map(torch.from_numpy, rest)
            loss = torch.mean(torch.abs(roll(net(inputs), start, sailed, torch) - truth) * weight)
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            if (step + 1) % every == 0 or step + 1 == settings.steps:
                kept = {"net": net.state_dict(), "optimiser": optimiser.state_dict()}
                with replacing(state) as partial:
                    torch.save({**kept, "done": step + 1}, partial)
        arrays = {key: value.numpy().copy() for key, value in net.state_dict().items()}
    record = dataclasses.asdict(settings) | {"sailed": len(fleet)}
    return Weights(settings.kind, settings.seed, record, arrays)


def _counted(done: int, settings: FleetSettings, name: str) -> Iterator[int]:
    """Count the steps that are left, with a bar of progress."""
    yield from track(
        range(done, settings.steps), description=name, total=settings.steps, completed=done
    )


app = typer.Typer(add_completion=False)


@app.command()
def main(
    kind: Annotated[str, typer.Argument(help="lstm or transformer")],
    out: Annotated[Path | None, typer.Option(help="File; by default the one that ships.")] = None,
    work: Annotated[Path, typer.Option(help="Folder of what is not finished.")] = Path("fleet"),
    seed: Annotated[int, typer.Option(help="Of boats, weights and batches.")] = 0,
    boats: Annotated[int | None, typer.Option(help="Boats, if other than what shipped.")] = None,
    steps: Annotated[int | None, typer.Option(help="Steps of the optimiser, likewise.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes that sail.")] = 1,
) -> None:
    """Sail a fleet of simulated boats and train a net on it; Ctrl-C, and go on later."""
    try:
        given = {"boats": boats, "steps": steps}
        own: Any = {key: value for key, value in given.items() if value is not None}
        own |= {"kind": kind, "seed": seed}
        settings = dataclasses.replace(SHIPPED.get(kind, SHIPPED["lstm"]), **own)
        weights = train(settings, sail_fleet(settings, work, jobs), work)
    except (FleetError, ImportError) as error:
        raise SystemExit(f"twin.training.fleet: {error}") from None
    except KeyboardInterrupt:
        raise SystemExit(
            f"twin.training.fleet: stopped; the same command goes on from {work}"
        ) from None
    path = out or NETS[kind].file
    weights.write(path)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    app()
