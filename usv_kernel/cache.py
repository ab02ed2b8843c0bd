"""Disk cache of compiled kernels: its folders and the digests of sources that name them."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shutil
from pathlib import Path

import platformdirs

__all__ = [
    "KERNEL_MODULES",
    "cache_directory",
    "cached",
    "module_digest",
    "running_program",
    "sources_digest",
]

_ROOT = Path(__file__).resolve().parent.parent

_PROGRAM = {".py", ".csv", ".npz", ".toml"}

_PACKAGES = ("usv_kernel", "usv_gym", "twin")

KERNEL_MODULES: set[str] = set()
"""Imported modules that define kernels."""


def sources_digest(root: Path = _ROOT, without: tuple[str, ...] = ()) -> str:
    """Return 20 hexadecimal digits that change with every source, vessel, prior or weight file.

    But for those whose paths begin as one of ``without`` does.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            name = path.relative_to(root).as_posix()
            if path.suffix in _PROGRAM and not name.startswith(without):
                digest.update(name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:20]


@functools.cache
def running_program() -> str:
    """Return :func:`sources_digest` of the running program, computed once per process."""
    return sources_digest()


def module_digest(module: str, root: Path = _ROOT) -> str:
    """Return 20 hexadecimal digits that change with a module and all that it imports from here.

    numba's own cache checks the file of the outermost function only. It would run old machine
    code after an edit of a function that this one calls in another file.
    """
    found: set[str] = set()
    todo = [*_files_of(module, root)]
    while todo:
        path = todo.pop()
        if path not in found:
            found.add(path)
            todo += _source(path, root)[1]
    digest = hashlib.sha256()
    for path in sorted(found):
        digest.update(path.encode() + b"\0" + _source(path, root)[0])
    return digest.hexdigest()[:20]


@functools.cache
def _files_of(module: str, root: Path) -> tuple[str, ...]:
    """Return the file of a module of the three packages below ``root``; none for other names."""
    package, *_ = parts = module.split(".")
    if package not in _PACKAGES:
        return ()
    path = "/".join(parts)
    return tuple(file for file in (f"{path}.py", f"{path}/__init__.py") if (root / file).is_file())


_IMPORT = re.compile(rb"^[ \t]*(?:from[ ]+([\w.]+)[ ]+)?import[ ]+(\([^)]*\)|[^\n]*)", re.MULTILINE)

_COMMENT = re.compile(rb"#[^\n]*")


@functools.cache
def _source(path: str, root: Path) -> tuple[bytes, frozenset[str]]:
    """Return the digest of a file below ``root``, and the files that it may import."""
    # a pattern, as parsing would slow down every import of the packages
    content = (root / path).read_bytes()
    names = set()
    for origin, listed in _IMPORT.findall(_COMMENT.sub(b"", content)):
        start = origin.decode()
        items = [item.split()[0] for item in listed.decode().strip("()").split(",") if item.strip()]
        names |= {start, *(f"{start}.{item}" for item in items)} if start else set(items)
    files = frozenset(file for name in names for file in _files_of(name, root))
    return hashlib.sha256(content).digest(), files


@functools.cache
def cache_directory(module: str) -> Path | None:
    """Return the folder for a module's compiled kernels, or None where none can be written.

    Its name ends with :func:`module_digest`; the newest three of earlier versions are kept.
    ``NUMBA_CACHE_DIR`` sets the folder that holds it.
    """
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or platformdirs.user_cache_dir("usv-twin"))
    ours = bool(_files_of(module, _ROOT))
    folder = base / f"{module}-{module_digest(module) if ours else sources_digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for stale in _of_module(folder)[:-4]:
            shutil.rmtree(stale, ignore_errors=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def _of_module(folder: Path) -> list[Path]:
    """Return the cache folders of all versions of a module, oldest first."""
    name = folder.name.rpartition("-")[0]
    return sorted(folder.parent.glob(f"{name}-*"), key=lambda path: path.stat().st_mtime)


def cached() -> bool:
    """Return whether the imported kernels are on disk, compiled from the present sources."""
    fresh = False
    for folder in filter(None, map(cache_directory, KERNEL_MODULES)):
        compiled = {path for path in _of_module(folder) if next(path.rglob("*.nbi"), None)}
        if compiled and folder not in compiled:
            return False
        fresh = fresh or folder in compiled
    return fresh
