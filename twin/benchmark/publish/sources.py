"""What a result depends on beside its settings: sources, files and versions.

A kept result is reused only if none of it has changed, and a submission names it.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from twin.predictors.base import Predictor
from twin.predictors.registry import EXTRAS, PredictorError, predictor_class

__all__ = [
    "PACKAGES",
    "Sources",
    "declared_files",
    "is_foreign",
    "predictor_digest",
    "sources_of",
    "versions",
]

PACKAGES = ("usv_kernel", "usv_gym", "twin")
"""Those of this program, which :func:`usv_kernel.cache.running_program` covers."""

_INSTALLED = {"site-packages", "dist-packages"}


class Sources(NamedTuple):
    """The sources of a predictor from outside of this package."""

    files: dict[str, Path]  # by the dotted name of the module
    packages: tuple[str, ...]  # installed packages that these import, with versions
    complete: bool  # False where a class has no file, as in a notebook


def is_foreign(module: str) -> bool:
    """Return whether a module is from outside of this package and of Python."""
    top = module.partition(".")[0]
    return top not in PACKAGES and top not in sys.stdlib_module_names


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
    """Return a hash of a predictor's sources and files; empty for one of this package.

    The sources are those of the class and of all modules that it imports, and they in turn: from
    its own folder or from others that are not installed. Of installed packages the versions count.
    The files are those that :attr:`Predictor.files` declares.

    Parameters
    ----------
    name : str
        A name in ``twin.PREDICTORS``, or ``module:Class``.

    Raises
    ------
    PredictorError
        A declared file is missing; names it.
    """
    kind = predictor_class(name)
    if not any(is_foreign(base.__module__) for base in kind.__mro__):
        return ""
    value = hashlib.sha256(_source_digest(kind).encode())
    for text, path in sorted(declared_files(kind).items()):
        value.update(f"{text}\0{_file_digest(path, path.stat().st_mtime_ns)}\0".encode())
    return value.hexdigest()


# of the class, not of its name: a module that is loaded again has a new one
@functools.cache
def _source_digest(kind: type[Predictor]) -> str:
    """Return a hash of a class's sources, as they are when it is first asked for."""
    found = sources_of(kind)
    value = hashlib.sha256(repr(found.packages).encode())
    for module, path in sorted(found.files.items()):
        value.update(module.encode() + b"\0" + path.read_bytes() + b"\0")
    if not found.complete:
        # nobody can say whether it has changed: no other process reuses its results
        value.update(f"{kind!r} {time.time_ns()}".encode())
    return value.hexdigest()


@functools.cache
def _file_digest(path: Path, modified: int) -> str:
    """Return the hash of a file that was modified at a time."""
    with path.open("rb") as file:
        value = hashlib.sha256()
        while piece := file.read(1 << 20):
            value.update(piece)
    return value.hexdigest()


def declared_files(kind: type[Predictor]) -> dict[str, Path]:
    """Return the files that a class and its bases declare, by the names that they are declared by.

    Raises
    ------
    PredictorError
        One is missing, or ``files`` is no tuple of names.
    """
    found: dict[str, Path] = {}
    for base in kind.__mro__:
        declared: Any = vars(base).get("files", ())
        if not is_foreign(base.__module__) or not declared:
            continue
        who = f"{base.__module__}:{base.__qualname__}"
        if not isinstance(declared, (tuple, list)):
            raise PredictorError(f"{who}: files = {declared!r}; write a tuple of file names")
        file = getattr(sys.modules.get(base.__module__), "__file__", None)
        folder = Path(file).resolve().parent if file else Path.cwd()
        for name in map(str, declared):
            path = folder / name
            inside = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
            for each in inside:
                if not each.is_file():
                    raise PredictorError(
                        f"{who}: declares the file {name!r}, but there is no {each}; its paths "
                        "count from the folder of the module"
                    )
                found[f"{name}/{each.relative_to(path)}" if each != path else name] = each
    return found


def sources_of(kind: type[Predictor]) -> Sources:
    """Return the source files of a class from outside, with all that they import.

    Imports are found in the text: also those inside of functions, and those by ``import_module``
    of a literal name. Standard library and this package are left out.
    """
    found: dict[str, Path] = {}
    packages: set[str] = set()
    tops: set[str] = set()
    folders: set[Path] = set()
    todo: list[str] = []
    complete = True
    for base in kind.__mro__:
        if not is_foreign(base.__module__):
            continue
        module = sys.modules.get(base.__module__)
        file = getattr(module, "__file__", None)
        if file is None or not Path(file).is_file():
            complete = False
            continue
        path, name = Path(file).resolve(), base.__module__
        found[name] = path
        tops.add(name.partition(".")[0])
        # a script's imports are found beside it, those of a package beside its top folder
        folders.add(path.parents[name.count(".") + (path.name == "__init__.py")])
        todo.append(name)
        todo += [n for n in _parents(name) if _add(n, tuple(folders), tops, found)]
    while todo:
        module_name = todo.pop()
        path = found[module_name]
        for name in _imports(path, module_name):
            top = name.partition(".")[0]
            if not is_foreign(top):
                continue
            own = [n for n in (*_parents(name), name) if _add(n, tuple(folders), tops, found)]
            todo += own
            if top not in found:
                packages.add(top)
    return Sources(found, tuple(sorted(map(_package, packages))), complete)


def _parents(name: str) -> list[str]:
    """Return the packages that a dotted name lies in, outermost first."""
    parts = name.split(".")
    return [".".join(parts[:k]) for k in range(1, len(parts))]


def _add(name: str, folders: tuple[Path, ...], tops: set[str], found: dict[str, Path]) -> bool:
    """Add the file of a module that is not installed; return whether it is a new one."""
    if name in found:
        return False
    path = _file_of(name, folders)
    top = name.partition(".")[0]
    if path is None or (top not in tops and _INSTALLED & set(path.parts)):
        return False
    found[name] = path
    return True


def _file_of(name: str, folders: tuple[Path, ...]) -> Path | None:
    """Return the file of a module by its dotted name, without importing it."""
    top, *rest = name.split(".")
    places = [folder / top for folder in folders]
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):  # a module without a specification, such as a script
        spec = None
    if spec is not None:
        places += [Path(folder) for folder in spec.submodule_search_locations or ()]
        if spec.has_location and spec.origin and not spec.submodule_search_locations:
            places.append(Path(spec.origin).with_suffix(""))
    for place in places:
        path = place.joinpath(*rest)
        for file in (path / "__init__.py", path.with_name(f"{path.name}.py")):
            if file.is_file():
                return file.resolve()
        # a compiled module has more in its name
        compiled = [*path.parent.glob(f"{path.name}.*.so"), *path.parent.glob(f"{path.name}.*.pyd")]
        if compiled:
            return compiled[0].resolve()
    return None


def _imports(path: Path, module: str) -> Iterator[str]:
    """Yield the dotted names that a source file may import."""
    if path.suffix != ".py":
        return
    try:
        tree = ast.parse(path.read_bytes())
    except SyntaxError:  # imported at most where its error is caught
        return
    package = module.split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (item.name for item in node.names)
        elif isinstance(node, ast.ImportFrom):
            up = package[: len(package) - node.level + 1] if node.level else []
            start = ".".join([*up, *([node.module] if node.module else [])])
            if start:
                yield start
            for item in node.names:
                yield f"{start}.{item.name}" if start else item.name
        elif isinstance(node, ast.Call) and node.args:
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            called = node.func.id if isinstance(node.func, ast.Name) else called
            first = node.args[0]
            literal = isinstance(first, ast.Constant) and isinstance(first.value, str)
            if called in ("import_module", "__import__") and literal:
                yield first.value.lstrip(".")  # type: ignore[attr-defined, union-attr]


@functools.cache
def _distributions() -> dict[str, list[str]]:
    return dict(importlib.metadata.packages_distributions())


def _package(top: str) -> str:
    """Return the installed package of a module, with its version."""
    names = sorted(set(_distributions().get(top, [])))
    return ", ".join(f"{name} {_version(name)}" for name in names) or top
