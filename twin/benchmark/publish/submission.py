"""The check of a folder of results: whether this program, its seeds and its predictors give them.

``usv-twin benchmark --submit-check FOLDER`` runs it. It imports the predictors that the folder
names, from what is installed here or lies in the working directory.
"""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin.benchmark import runner
from twin.benchmark.conformance import Finding
from twin.benchmark.protocol import BenchmarkError, Case, Settings, Unit, units
from twin.benchmark.publish.sources import predictor_digest, versions
from twin.files import compressed_csv, kept
from twin.logs.log import recorded_runs
from usv_kernel import __version__
from usv_kernel.cache import running_program
from usv_kernel.errors import UsvTwinError
from usv_kernel.files import read_json

__all__ = [
    "SAME",
    "check_submission",
]

Results = dict[Unit, dict[str, Any]]

SAME = 1e-3
"""Largest relative difference of a recomputed mean: other processors round in other ways."""

ROUNDING = 1e-9
"""Largest relative difference of a table that is made of equal results."""

REMARKS = ("command", "notes", "program", "version")
"""Parts of the results that are no numbers of the benchmark."""


def check_submission(
    folder: str | Path,
    *,
    logs: Sequence[str | Path] = (),
    sample: int = 1,
    started: Callable[[str], None] = lambda text: None,
) -> Iterator[Finding]:
    """Yield the findings of a folder that ``usv-twin benchmark`` has written.

    Parameters
    ----------
    folder : str or Path
        The folder of results.
    logs : sequence of str or Path
        The recorded runs that it scores, but those that ship with the package.
    sample : int
        So many results of each predictor are computed again. They are drawn by a generator whose
        seed is the hash of ``results.json``: nobody chooses them, and a second check draws the
        same.
    started : callable
        Called with the name of each run that is computed again.

    Yields
    ------
    Finding
        ``passed`` is None where something could not be compared.

    Raises
    ------
    BenchmarkError
        There is no ``results.json``, or it cannot be read; names the remedy.
    """
    folder = Path(folder)
    file = folder / "results.json"
    if not file.is_file():
        raise BenchmarkError(
            f"{file}: no such file; name a folder that usv-twin benchmark has written with --out"
        )
    results = read_json(file, BenchmarkError)
    try:
        settings, missing = _settings_of(results["settings"], folder, logs)
        named = results["program"], results["predictors"], results["against"]
    except (AttributeError, LookupError, TypeError) as error:
        raise BenchmarkError(
            f"{file}: is damaged, or another version wrote it ({type(error).__name__}: {error}); "
            "write it again with this one"
        ) from None
    program = _check_program(results, named[0])
    predictors = _check_predictors(named[1], settings)
    yield program
    yield predictors
    same = bool(program.passed and predictors.passed)
    yield Finding(
        "settings",
        None if missing else True,
        f"the logs {', '.join(missing)} are not at hand; name them with --log"
        if missing
        else f"{len(settings.predictors)} predictors, seeds {_span(settings.seeds)}, "
        f"{len(units(settings))} results",
    )
    done = _stored(settings, folder)
    yield _check_keys(settings, folder, done, same)
    yield _check_tables(settings, folder, results, done, bool(missing))
    yield _check_sample(settings, done, _drawn(file, done, sample), started)


def _span(seeds: Sequence[int]) -> str:
    return f"{min(seeds)} to {max(seeds)}" if seeds else "none"


def _settings_of(
    stored: Mapping[str, Any], folder: Path, logs: Sequence[str | Path]
) -> tuple[Settings, list[str]]:
    """Return the settings of stored results, and the logs that are not at hand."""
    given: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in stored.items()
    }
    given["cases"] = tuple(Case(**case) for case in stored["cases"])
    places = [*map(Path, logs), *recorded_runs().values()]
    known = {path.name: str(path) for path in reversed(places)}
    missing = [name for name in given["logs"] if name not in known]
    given["logs"] = tuple(known[name] for name in given["logs"] if name in known)
    return Settings(**given), missing


def _check_program(results: Mapping[str, Any], program: Mapping[str, str]) -> Finding:
    """The same program, and the same versions of what computes."""
    here = {"sources": running_program(), **versions()}
    other = [f"{name} {program.get(name)}, here {here[name]}" for name in here]
    other = [
        text for text, name in zip(other, here, strict=True) if program.get(name) != here[name]
    ]
    if results["version"] != __version__:
        other.insert(0, f"usv-twin {results['version']}, here {__version__}")
    if other:
        return Finding("program", False, f"made with {'; '.join(other)}: install the same ones")
    return Finding("program", True, f"usv-twin {__version__}, sources {here['sources']}")


def _check_predictors(named: Mapping[str, Any], settings: Settings) -> Finding:
    """The same sources and files of each predictor."""
    other = [
        name
        for name in settings.predictors
        if named.get(name, {}).get("sources") != predictor_digest(name)
    ]
    if other:
        text = f"other sources or files here: {', '.join(other)}; get those that made the results"
        return Finding("predictors", False, text)
    own = [name for name in settings.predictors if predictor_digest(name)]
    foreign = f"; from outside: {', '.join(own)}" if own else ""
    return Finding("predictors", True, f"{', '.join(settings.predictors)}{foreign}")


def _stored(settings: Settings, folder: Path) -> Results:
    """Return the results that are there and undamaged, by whatever program."""
    found: Results = {}
    for unit in units(settings):
        path = runner.result_file(folder, unit)
        try:
            key = read_json(path, BenchmarkError)["key"]
            result = kept(path, key)
            if result["unit"]["seed"] == unit.seed and "plans" in result:
                found[unit] = {**result, "unit": dataclasses.asdict(unit)}
        except (UsvTwinError, LookupError, TypeError):
            continue
    return found


def _check_keys(settings: Settings, folder: Path, done: Results, same: bool) -> Finding:
    """A result of each predictor on each run, with the key of this program and these settings."""
    work = units(settings)
    lacking = [unit for unit in work if unit not in done]
    if lacking:
        first = lacking[0]
        return Finding(
            "results",
            False,
            f"{len(lacking)} of {len(work)} are missing or damaged, the first that of "
            f"{first.predictor} on {first.run}",
        )
    if not same:
        return Finding("results", None, f"{len(work)}, of another program or predictor")
    current = runner.reusable(settings, folder)
    stale = [unit for unit in work if unit not in current]
    if stale:
        return Finding(
            "results",
            False,
            f"{len(stale)} of {len(work)} are of other settings, files or sources, the first that "
            f"of {stale[0].predictor} on {stale[0].run}",
        )
    return Finding("results", True, f"{len(work)}, each of this program and these settings")


def _check_tables(
    settings: Settings, folder: Path, results: Mapping[str, Any], done: Results, partly: bool
) -> Finding:
    """The tables are those of the results."""
    if partly:
        return Finding("tables", None, "not compared: results on logs that are not at hand")
    made = runner.collect(settings, done, "", (), results["against"])
    rows = folder / "rows.csv.gz"
    if "rows" not in results and rows.is_file():
        try:
            content = gzip.decompress(rows.read_bytes())
        except (OSError, EOFError, ValueError):
            content = b""
        if content != gzip.decompress(compressed_csv(made["rows"])):
            return Finding("tables", False, f"{rows} is not what the results give")
    parts = [
        name
        for name in made
        if name not in REMARKS and (name in results or name not in ("rows", "runs", "motion"))
    ]
    made = json.loads(json.dumps(made))
    wrong = [name for name in parts if _difference(made[name], results.get(name)) > ROUNDING]
    if wrong:
        text = f"results.json is not what the results in runs/ give: {', '.join(wrong)}"
        return Finding("tables", False, text)
    return Finding("tables", True, f"{len(parts)} parts, as the results in runs/ give them")


def _drawn(file: Path, done: Results, sample: int) -> list[Unit]:
    """Return the results to compute again: so many of each predictor, drawn by the file's hash."""
    rng = np.random.default_rng(list(hashlib.sha256(file.read_bytes()).digest()))
    by_predictor: dict[str, list[Unit]] = {}
    for unit in done:
        by_predictor.setdefault(unit.predictor, []).append(unit)
    return [
        some[k]
        for some in by_predictor.values()
        for k in sorted(rng.permutation(len(some))[:sample])
    ]


def _check_sample(
    settings: Settings, done: Results, drawn: Sequence[Unit], started: Callable[[str], None]
) -> Finding:
    """Results that are computed again are the same."""
    largest, equal = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        for unit in drawn:
            name = f"{unit.predictor} on {unit.run}"
            started(name)
            try:
                again = runner.run_unit(settings, unit, Path(folder), pictures=False)
            except Exception as error:  # of a user's predictor
                text = f"{name}: {type(error).__name__}: {error}"
                return Finding("computed again", False, text)
            made = json.loads(json.dumps({key: again[key] for key in again if key != "unit"}))
            change = _difference(made, {key: done[unit].get(key) for key in made})
            if change > SAME:
                return Finding(
                    "computed again", False, f"{name}: differs by {100.0 * change:.3g} % from here"
                )
            largest, equal = max(largest, change), equal + (change == 0.0)
    if not drawn:
        return Finding("computed again", None, "none: --sample 0, or no results")
    names = ", ".join(f"{unit.predictor} on {unit.run}" for unit in drawn)
    text = f"{equal} of {len(drawn)} to the last bit, all within {largest:.1g}: {names}"
    return Finding("computed again", True, text)


def _difference(one: Any, other: Any) -> float:
    """Return the largest relative difference of the numbers in two tables.

    It is inf where one has another form, or a NaN where the other has a number.
    """
    if isinstance(one, dict) and isinstance(other, dict):
        if one.keys() != other.keys():
            return float("inf")
        return max((_difference(one[key], other[key]) for key in one), default=0.0)
    if isinstance(one, list) and isinstance(other, list):
        if len(one) != len(other):
            return float("inf")
        return max((_difference(a, b) for a, b in zip(one, other, strict=True)), default=0.0)
    if isinstance(one, float) and isinstance(other, (int, float)):
        if math.isnan(one) or math.isnan(other):
            return 0.0 if math.isnan(one) and math.isnan(other) else float("inf")
        return abs(one - other) / max(abs(one), abs(other), 1e-6)
    return 0.0 if one == other else float("inf")
