"""Disk cache of kernels: an edit of a source recompiles every caller of it."""

import ast
import gc
import io
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from numba.core.compiler import DefaultPassBuilder, Flags

import usv_kernel
from usv_kernel import cache, compiler, jit, warmup

ROOT = Path(usv_kernel.__file__).resolve().parent.parent
PACKAGES = ("usv_kernel", "usv_gym", "twin")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a copy of the packages."""
    root = tmp_path / "tree"
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    return root


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count(old) == 1, f"{path.name} has changed: this test must edit another line"
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_sources_digest_changes_with_every_program_file(tmp_path: Path) -> None:
    names = ("usv_kernel/a.py", "usv_gym/vessels/b.toml", "twin/priors/c.csv", "twin/d/e.npz")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1", encoding="utf-8")
    seen = [cache.sources_digest(tmp_path)]
    for name in names:
        (tmp_path / name).write_text("2", encoding="utf-8")
        seen.append(cache.sources_digest(tmp_path))
    (tmp_path / names[0]).rename(tmp_path / "usv_kernel" / "b.py")
    seen.append(cache.sources_digest(tmp_path))
    (tmp_path / "twin" / "new.py").write_text("", encoding="utf-8")
    seen.append(cache.sources_digest(tmp_path))
    assert len(set(seen)) == len(seen)
    (tmp_path / "twin" / "notes.txt").write_text("", encoding="utf-8")
    assert cache.sources_digest(tmp_path) == seen[-1]


# an inlined function of another package, and a kernel of another file
CALLS = """
import numpy as np
import usv_kernel
from usv_gym.envs.scoring import (path_errors)
from usv_gym.physics import parameters, wind
errors = np.zeros(4)
path_errors(0.0, 0.0, 0.5, np.array([[0.0, 0.0], [10.0, 0.0]]), 0, errors)
p = np.ones(1, parameters.PARAMETERS)[0]
load = wind.wind_loads(0.0, 0.0, 0.0, 10.0, 0.0, p)[0]
print(usv_kernel.__file__, repr(float(errors[2])), repr(float(load)))
"""


def run(tree: Path, folder: Path) -> tuple[float, float, str]:
    """Return the heading error, the wind load and what was printed on stderr."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(folder)}
    environment.pop(warmup.QUIET, None)
    done = subprocess.run(
        [sys.executable, "-c", CALLS],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    file, error, load = done.stdout.split()
    assert Path(file).is_relative_to(tree)
    return float(error), float(load), done.stderr


def test_an_edit_of_a_called_kernel_recompiles_its_callers(tree: Path, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    folder.mkdir()
    error, load, message = run(tree, folder)
    assert message == warmup.MESSAGE + "\n"
    assert list(folder.rglob("*.nbi"))
    assert run(tree, folder) == (error, load, "")
    edit(
        tree / "usv_kernel" / "scalar.py",
        "    return angle - 2.0 * math.pi * math",
        "    return 7.0 + angle - 2.0 * math.pi * math",
    )
    edit(
        tree / "usv_gym" / "physics" / "frames.py",
        "    return north * c + east * s, east",
        "    return 2.0 * (north * c + east * s), east",
    )
    # twice the wind speed makes four times the load
    assert run(tree, folder)[:2] == pytest.approx((error + 7.0, 4.0 * load), rel=1e-12)


def test_every_import_of_the_packages_is_followed() -> None:
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        followed = cache._source(path.relative_to(ROOT).as_posix(), ROOT)[1]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                wanted = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: relative imports are not followed"
                wanted = {str(node.module), *(f"{node.module}.{a.name}" for a in node.names)}
            else:
                continue
            ours = [ROOT.joinpath(*name.split(".")) for name in wanted]
            files = [one.with_suffix(".py") for one in ours] + [o / "__init__.py" for o in ours]
            found = {one.relative_to(ROOT).as_posix() for one in files if one.is_file()}
            assert found <= followed, f"{path.name}, line {node.lineno}"


def test_numba_has_what_the_compiler_of_kernels_needs() -> None:
    assert compiler._PARTS and compiler._FILES
    passes = DefaultPassBuilder.define_nopython_pipeline(
        SimpleNamespace(func_ir=None, flags=Flags())
    )
    assert {one.name() for one, _ in passes.passes} >= compiler._UNUSED


OPENED_FILES = """
import pkgutil, importlib, sys
opened = set()
sys.addaudithook(lambda event, args: opened.add(str(args[0])) if event == "open" else None)
import usv_gym, twin
for package in usv_gym, twin:
    for entry in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        path = entry.module_finder.find_spec(entry.name).origin
        if "@kernel" in open(path).read():
            importlib.import_module(entry.name)
print(*sorted(path for path in opened if path.endswith((".csv", ".toml", ".npz", ".json"))))
"""


def test_imports_of_kernels_read_no_data_files() -> None:
    """The digest of a module covers Python sources only."""
    found = subprocess.run(
        [sys.executable, "-c", OPENED_FILES],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    # a virtual environment may lie in the checkout
    own = [path for path in map(Path, found) if not path.is_relative_to(sys.prefix)]
    assert [path for path in own if path.is_relative_to(ROOT)] == []


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile the kernels of this file into an empty cache."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    modules: set[str] = set()
    monkeypatch.setattr(cache, "KERNEL_MODULES", modules)
    monkeypatch.setattr(jit, "KERNEL_MODULES", modules)
    cache.cache_directory.cache_clear()
    yield
    cache.cache_directory.cache_clear()


def twice(x: float) -> float:
    return 2.0 * x


def test_another_numba_version_recompiles(fresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def hits() -> int:
        compiled = jit.kernel(twice)
        assert compiled(3.0) == 6.0
        return sum(compiled.stats.cache_hits.values())

    assert (hits(), hits()) == (0, 1)
    monkeypatch.setattr(numba, "__version__", "0.0")
    assert hits() == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [("_PARTS", False), ("PipelineTuningOptions", None)],  # the second as llvmlite before 0.45
)
def test_kernels_compiled_in_other_ways_give_equal_results(
    fresh: None, monkeypatch: pytest.MonkeyPatch, name: str, value: object
) -> None:
    monkeypatch.setattr(compiler, name, value)
    inner = jit.kernel(twice)
    assert (inner.part is inner) == (name == "_PARTS")

    @jit.kernel
    def outer(x):
        return inner(x) + 1.0

    assert outer(3.0) == 7.0


def test_cached_operator_types_depend_on_the_arguments(fresh: None) -> None:
    @jit.kernel
    def added(x, y):
        return x + y

    assert type(added(1, 2)) is int
    assert type(added(1, 2.0)) is float
    assert type(added(1.0, 2.0)) is float
    assert type(added(3, 4)) is int


class Event:
    def __init__(self, function) -> None:
        self.data = {"dispatcher": numba.njit(function)}


@pytest.mark.parametrize("quiet", ["", "1"])
def test_compile_message_appears_once(monkeypatch: pytest.MonkeyPatch, quiet: str) -> None:
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setenv(warmup.QUIET, quiet)
    listener = warmup.CompileListener({__name__})
    for _ in range(2):
        listener.on_start(Event(twice))
        assert not gc.isenabled()
        listener.on_start(Event(ast.parse))  # called by our kernel
        listener.on_end(Event(ast.parse))
        assert not gc.isenabled()
        listener.on_end(Event(twice))
        assert gc.isenabled()
    assert shown.getvalue() == ("" if quiet else warmup.MESSAGE + "\n")


def test_kernels_compile_without_a_writable_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked))
    monkeypatch.setattr(cache, "KERNEL_MODULES", set())
    cache.cache_directory.cache_clear()
    assert cache.cache_directory("twin.filters.ukf") is None
    assert not cache.cached()

    def double(x: float) -> float:
        return 2.0 * x

    assert jit.kernel(double)(3.0) == 6.0
    cache.cache_directory.cache_clear()


def test_a_damaged_cache_is_made_again(fresh: None, tmp_path: Path) -> None:
    """Every file of it cut off or with a changed byte: the same number each time."""
    rng, hits = np.random.default_rng(5), []
    for damage in range(4):
        compiled = jit.kernel(twice)
        assert compiled(3.0) == 6.0
        hits.append(sum(compiled.stats.cache_hits.values()))
        files = [path for path in tmp_path.rglob("*") if path.suffix in (".nbi", ".nbc")]
        assert len({path.suffix for path in files}) == 2
        for path in files:
            content = bytearray(path.read_bytes())
            if damage == 1:
                content = content[: len(content) // 2]
            elif damage == 2:
                content[int(rng.integers(len(content)))] ^= 1
            path.write_bytes(content)
    # compiled at first and after each damage, read from the disk after none
    assert hits == [0, 1, 0, 0]


def test_a_cache_that_names_types_of_an_earlier_version_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = types.ModuleType("usv_kernel_gone")
    module.Gone = type("Gone", (), {"__module__": "usv_kernel_gone"})
    monkeypatch.setitem(sys.modules, "usv_kernel_gone", module)
    file = tmp_path / "index"
    file.write_bytes(compiler._sealed({module.Gone: 1}))
    assert len(compiler._opened(str(file))) == 1
    monkeypatch.delitem(sys.modules, "usv_kernel_gone")
    with pytest.raises(compiler._DamageError, match="outdated"):
        compiler._opened(str(file))
