"""A search for the settings of the fleet's nets: ``python -m twin.training.hyperparameter_search``.

Successive halving: every configuration gets a short training, and the better half of them one
that is twice as long, again and again. All learn from the same boats and are scored on the same
windows of other boats. Results go into a file of JSON lines at once, so Ctrl-C loses
nothing, and the same command goes on.

Source: Jamieson and Talwalkar 2016, Non-stochastic best arm identification and hyperparameter
optimization, AISTATS.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from twin.predictors.learned.lstm import import_torch
from twin.predictors.learned.pretrained import Weights
from twin.training.fleet import (
    _FLEET,
    NETS,
    TYPICAL,
    FleetError,
    FleetSettings,
    Run,
    batch,
    roll,
    sail_fleet,
    train,
)
from usv_kernel.files import write_whole

__all__ = [
    "draw",
    "losses",
    "search",
    "windows",
]

Array = NDArray[Any]

FIRST = 8192
"""Windows that the first, shortest training learns from."""

VALIDATION_WINDOWS = 2048
"""Windows that score a net."""

OTHERS, BOATS = 1, 60
"""Seed and number of the boats for scoring; none is used in training."""

BEGIN = {
    "lstm": FleetSettings(),
    "transformer": FleetSettings(kind="transformer", layers=2, rate=2e-3),
}
"""Where a search begins: settings that a few short trainings had shown to be good."""


def draw(kind: str, i: int, seed: int) -> FleetSettings:
    """Return the i-th configuration of a search for a kind of net; the first is where it begins."""
    begin = BEGIN[kind]
    if i == 0:
        return begin
    rng = np.random.default_rng([_FLEET, seed, i, 2])
    slowest, fastest = {"lstm": (1e-3, 4e-2), "transformer": (5e-4, 1e-2)}[kind]
    return dataclasses.replace(
        begin,
        width=int(rng.choice((32, 48, 64, 96))),
        layers=int(rng.choice({"lstm": (1, 1, 2), "transformer": (1, 2, 3)}[kind])),
        batch=int(rng.choice((32, 64, 128, 256))),
        rate=float(f"{np.exp(rng.uniform(np.log(slowest), np.log(fastest))):.2g}"),
        decay=float(f"{np.exp(rng.uniform(np.log(1e-4), np.log(0.3))):.2g}"),
        dropout=float(rng.choice((0.0, 0.0, 0.05, 0.1, 0.2))),
        late=float(rng.choice((-0.5, 0.0, 0.5))),
        gate=float(rng.choice((0.0, 0.0, 0.5, 1.0))),
    )


def windows(fleet: list[Run], count: int, seed: int) -> list[tuple[Array, ...]]:
    """Return windows of a fleet to score nets with; see :func:`twin.training.fleet.batch`."""
    rng = np.random.default_rng([_FLEET, seed, 3])
    return [batch(fleet, 128, rng) for _ in range(max(count // 128, 1))]


def losses(weights: Weights, validation: list[tuple[Array, ...]]) -> Array:
    """Return the errors (n, 6) of a net on windows of other boats, from :func:`windows`.

    They are means over 10 s of the absolute errors of x, y, psi, u, v, r, over their typical size.
    """
    torch = import_torch("the search for settings of nets")
    out = []
    for x, *rest in validation:
        start, sailed, truth = map(torch.from_numpy, rest)
        path = roll(torch.from_numpy(weights.run(x)), start, sailed, torch)
        out.append((torch.abs(path - truth).mean(dim=1).numpy()) / TYPICAL)
    return np.concatenate(out)


def search(
    configurations: list[FleetSettings],
    fleet: list[Run],
    validation: list[tuple[Array, ...]],
    folder: Path,
    *,
    first: int = FIRST,
    rungs: int = 4,
) -> list[dict[str, Any]]:
    """Return what is known of the configurations that came furthest, the best first.

    Their steps follow from their training windows: ``first`` in the first of the ``rungs``, twice
    as many in each that follows with the better half. ``folder`` keeps ``search.jsonl`` and the
    states of trainings. Returned are ``settings``, ``windows`` and ``loss`` of the last rung's.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "search.jsonl"
    text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
    known = [line for line in map(_result, text.splitlines()) if line]
    field, ranked = configurations, list[dict[str, Any]]()
    for rung in range(rungs):
        ranked = []
        for i, configuration in enumerate(field):
            count = first * 2**rung
            settings = dataclasses.replace(
                configuration, steps=max(count // configuration.batch, 1)
            )
            about = dataclasses.asdict(settings)
            found = next((line for line in known if line["settings"] == about), None)
            if found is None:
                name = f"{settings.kind} {i + 1}/{len(field)}, rung {rung + 1}/{rungs}"
                error = losses(train(settings, fleet, folder, name=name), validation).mean(axis=0)
                found = {
                    "settings": about,
                    "windows": count,
                    "loss": round(float(error.mean()), 5),
                    "channels": [round(float(e), 5) for e in error],
                }
                known.append(found)
                write_whole(path, "".join(json.dumps(line) + "\n" for line in known).encode())
            ranked.append(found)
        order = np.argsort([line["loss"] for line in ranked], kind="stable")
        ranked = [ranked[j] for j in order]
        field = [field[j] for j in order[: max(len(order) // 2, 1)]]
    return ranked


APP = "twin.training.hyperparameter_search"

app = typer.Typer(add_completion=False)


@app.command()
def main(
    kind: Annotated[str, typer.Argument(help="lstm or transformer")],
    work: Annotated[Path, typer.Option(help="Folder of boats and of what was found.")] = Path(
        "fleet"
    ),
    trials: Annotated[int, typer.Option(help="Configurations.", min=1)] = 40,
    rungs: Annotated[int, typer.Option(help="Rungs of the halving.", min=1)] = 4,
    first: Annotated[int, typer.Option(help="Windows in the shortest training.", min=1)] = FIRST,
    seed: Annotated[int, typer.Option(help="Of the configurations.")] = 0,
    boats: Annotated[int, typer.Option(help="Boats to learn from.", min=1)] = 320,
    others: Annotated[
        int, typer.Option(help="Boats for scoring; always as many for one folder.", min=1)
    ] = BOATS,
    jobs: Annotated[int, typer.Option(help="Processes that sail.")] = 1,
) -> None:
    """Search for good settings of a net, by successive halving; Ctrl-C, and go on later."""
    if kind not in NETS:
        raise SystemExit(f"{APP}: no net is called {kind!r}; known: {', '.join(NETS)}")
    try:
        tried = [dataclasses.replace(draw(kind, i, seed), boats=boats) for i in range(trials)]
        fleet = sail_fleet(tried[0], work, jobs)
        rest = sail_fleet(dataclasses.replace(tried[0], seed=OTHERS, boats=others), work, jobs)
        validation = windows(rest, VALIDATION_WINDOWS, OTHERS)
        best = search(tried, fleet, validation, work, first=first, rungs=rungs)
    except (FleetError, ImportError) as error:
        raise SystemExit(f"{APP}: {error}") from None
    except KeyboardInterrupt:
        raise SystemExit(f"{APP}: stopped; the same command goes on from {work}") from None
    for line in best:
        print(f"{line['loss']:.4f}  {line['settings']}")


if __name__ == "__main__":
    app()


def _result(line: str) -> dict[str, Any] | None:
    """Return a finished training; None for a damaged line, whose training is repeated."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    names = {"settings", "windows", "loss", "channels"}
    return found if isinstance(found, dict) and names <= set(found) else None
