"""What a kept result depends on beside its settings: versions, and a foreign predictor's files."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import platform
import sys
import time
from collections.abc import Iterator
from importlib.util import resolve_name
from pathlib import Path

from twin.predictors.base import Predictor
from twin.predictors.registry import EXTRAS, PredictorError, predictor_class

__all__ = ["predictor_digest", "versions"]

PACKAGES = ("usv_kernel", "usv_gym", "twin")
"""Those of this program, which :func:`usv_kernel.cache.running_program` covers."""


def versions(predictor: str = "") -> dict[str, str]:
    """Return the versions of Python and of the packages that compute, by name."""
    extra = (EXTRAS[predictor][0],) if predictor in EXTRAS else ()
    return {
        "python": platform.python_version(),
        **{name: _version(name) for name in ("numba", "numpy", "scipy", *extra)},
    }


@functools.cache
def _version(distribution: str) -> str:
    """Return the version of an installed package; ``none`` if it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def predictor_digest(name: str) -> str:
    """Return a hash of a foreign predictor's files; empty for a predictor of this package.

    The files are the modules of the class and of its bases, what the class's module imports from
    its folder, and those that :attr:`~twin.predictors.base.Predictor.files` of each names. A class
    without a module file, as in a notebook, has another hash at each call: nobody can say whether
    it has changed.

    Parameters
    ----------
    name : str
        A name in ``twin.PREDICTORS``, or ``module:Class``.

    Raises
    ------
    PredictorError
        A file that ``files`` names is missing; names it.
    """
    foreign = [base for base in predictor_class(name).__mro__ if _is_foreign(base)]
    if not foreign:
        return ""
    value = hashlib.sha256()
    for base in foreign:
        module = getattr(sys.modules.get(base.__module__), "__file__", None)
        value.update(Path(module).read_bytes() if module else str(time.time_ns()).encode())
        files = [*_named_files(base, Path(module).parent if module else Path.cwd())]
        if base is foreign[0] and module:
            files += _imported_files(base.__module__, Path(module))
        for path in files:
            value.update(path.name.encode() + b"\0" + path.read_bytes())
    return value.hexdigest()


@functools.cache
def _installed() -> frozenset[str]:
    """Return the names of the modules of installed packages, and of this program."""
    return frozenset({*importlib.metadata.packages_distributions(), *PACKAGES})


def _imported_files(module: str, path: Path) -> list[Path]:
    """Return the files of a module and of those that it imports from beside it or its package."""
    top, *inside = module.split(".")
    root, others = path.parents[len(inside) + (path.name == "__init__.py")], _installed() - {top}
    found, todo = {path: module}, [path]
    for file in todo:  # grows meanwhile
        package = found[file] if file.name == "__init__.py" else found[file].rpartition(".")[0]
        for name in _imports(file, package):
            parts = name.split(".")
            for k in range(1, len(parts) + 1) if parts[0] not in others else ():
                at = root.joinpath(*parts[:k])
                for other in (at.with_suffix(".py"), at / "__init__.py"):
                    if other.is_file() and other not in found:
                        found[other] = ".".join(parts[:k])
                        todo.append(other)
    return sorted(found)


def _imports(file: Path, package: str) -> Iterator[str]:
    """Yield the names of the modules that a module of a package imports, or may import."""
    try:
        nodes = ast.walk(ast.parse(file.read_bytes()))
    except (SyntaxError, ValueError):  # compiled, or not to be imported either
        return
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            base = resolve_name(base, package) if node.level else base
            yield from (f"{base}.{each.name}" for each in node.names)


def _is_foreign(kind: type) -> bool:
    """Return whether a class is from outside of this package and of Python."""
    top = kind.__module__.partition(".")[0]
    return top not in PACKAGES and top not in sys.stdlib_module_names


def _named_files(kind: type[Predictor], folder: Path) -> Iterator[Path]:
    """Yield the files that a class itself names, those of a folder in the order of their names."""
    names = vars(kind).get("files", ())
    if isinstance(names, str):
        raise PredictorError(f"{kind.__name__}: files = {names!r}; write a tuple of file names")
    for path in (folder / name for name in names):
        if not path.exists():
            raise PredictorError(
                f"{kind.__name__}: its attribute files names {path.name!r}, but there is no "
                f"{path}; paths count from the folder of the module"
            )
        yield from sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else (path,)
