"""Compiled code on disk: any edit of any kernel source must be seen by every caller of it."""

from __future__ import annotations

import ast
import gc
import io
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

import usv_kernel
from usv_kernel import cache, compiler, jit
from usv_kernel import warmup as first_use

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


def test_the_digest_sees_every_source(tree: Path) -> None:
    seen = {cache.sources_digest(tree)}
    assert seen == {cache.sources_digest(tree)}
    assert seen == {cache.sources_digest()}  # where the tree lies does not matter
    sources = sorted(path for package in PACKAGES for path in (tree / package).rglob("*.py"))
    assert len(sources) > 20
    for number, path in enumerate(sources, start=1):
        path.write_text(path.read_text(encoding="utf-8") + "#\n", encoding="utf-8")
        seen.add(cache.sources_digest(tree))
        assert len(seen) == number + 1, f"an edit of {path.relative_to(tree)} was not seen"


def test_the_digest_sees_a_file_moved_renamed_or_added(tree: Path) -> None:
    seen = {cache.sources_digest(tree)}
    (tree / "usv_gym" / "physics" / "hull.py").rename(tree / "usv_gym" / "physics" / "body.py")
    seen.add(cache.sources_digest(tree))
    (tree / "twin" / "new.py").write_text("", encoding="utf-8")
    seen.add(cache.sources_digest(tree))
    assert len(seen) == 3


CALLS = {
    # usv_gym/envs/tasks.py calls usv_kernel.scalar.wrap, which numba compiles into it
    "wrap": """
import numpy as np
from usv_gym.envs.tasks import path_errors
errors = np.zeros(4)
path_errors(0.0, 0.0, 0.5, np.array([[0.0, 0.0], [10.0, 0.0]]), 0, errors)
print(repr(float(errors[2])))
""",
    # usv_gym/physics/wind.py calls frames.to_body
    "frames": """
import numpy as np
from usv_gym.physics import parameters, wind
p = np.ones(parameters.PACKED_SIZE)
print(repr(float(wind.wind_loads(0.0, 0.0, 0.0, 10.0, 0.0, p)[0])))
""",
}


def run(tree: Path, cache: Path, call: str) -> float:
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
    where = f"import usv_kernel\nassert usv_kernel.__file__.startswith({str(tree)!r})\n"
    done = subprocess.run(
        [sys.executable, "-c", where + CALLS[call]],
        cwd=cache,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


@pytest.mark.parametrize(
    ("call", "source", "old", "new"),
    [
        (
            "wrap",
            "usv_kernel/__init__.py",
            "    return angle - 2.0 * math.pi * math",
            "    return 7.0 + angle - 2.0 * math.pi * math",
        ),
        (
            "frames",
            "usv_gym/physics/frames.py",
            "    return north * c + east * s, east",
            "    return 2.0 * (north * c + east * s), east",
        ),
    ],
)
def test_stale_machine_code_cannot_run(
    tree: Path, tmp_path: Path, call: str, source: str, old: str, new: str
) -> None:
    """Edit a kernel that another file's kernel calls: the next process must feel it."""
    cache = tmp_path / "cache"
    cache.mkdir()
    before = run(tree, cache, call)
    compiled = list(cache.rglob("*.nbi"))
    assert compiled, "nothing was kept on disk: this test would prove nothing"
    assert run(tree, cache, call) == before
    edit(tree / source, old, new)
    after = run(tree, cache, call)
    # wrap gains 7 rad; twice the wind makes four times the load
    expected = before + 7.0 if call == "wrap" else 4.0 * before
    assert after == pytest.approx(expected, rel=1e-12)


def test_a_module_sees_what_it_imports_and_nothing_else(tree: Path) -> None:
    def digest() -> str:
        cache._source.cache_clear()
        return cache.module_digest("usv_gym.physics.ship", tree)

    before = digest()
    assert cache.module_digest("usv_gym.physics.ship") == before
    for source in (
        "usv_gym/physics/frames.py",
        "usv_gym/physics/__init__.py",
        "usv_kernel/__init__.py",
    ):
        path = tree / source
        path.write_text(path.read_text(encoding="utf-8") + "#\n", encoding="utf-8")
        after = digest()
        assert after != before, f"an edit of {source} was not seen"
        before = after
    for source in ("twin/filters/ukf.py", "usv_gym/envs/env.py"):
        path = tree / source
        path.write_text(path.read_text(encoding="utf-8") + "#\n", encoding="utf-8")
    assert digest() == before


def test_imports_are_found_in_every_form(tmp_path: Path) -> None:
    path = tmp_path / "some.py"
    path.write_text(
        "import usv_gym.manoeuvring.rao, math\nfrom twin import (\n    ukf as u,  # (one)\n    model,\n)\n"
        "def f():\n    from usv_gym.physics import hull  # late\n",
        encoding="utf-8",
    )
    assert cache._source(path)[1] == {
        *("usv_gym.manoeuvring.rao", "math", "twin", "twin.filters.ukf", "twin.model.rollout"),
        *("usv_gym.physics", "usv_gym.physics.hull"),
    }


def test_no_import_of_ours_is_overlooked() -> None:
    """A name that the pattern misses would be a source whose edits are not seen."""
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        found = cache._source(path)[1]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                wanted = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: relative imports are not followed"
                wanted = {str(node.module), *(f"{node.module}.{a.name}" for a in node.names)}
            else:
                continue
            ours = {name for name in wanted if name.partition(".")[0] in PACKAGES}
            assert ours <= found, f"{path.name}, line {node.lineno}"


LOOK = """
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


def test_kernels_cannot_depend_on_data() -> None:
    """The digest of a module covers sources only, so nothing else may be read while importing."""
    found = subprocess.run(
        [sys.executable, "-c", LOOK],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert [path for path in found if Path(path).is_relative_to(ROOT)] == []


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have kernels of this file kept in an empty folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(usv_kernel, "_MODULES", set())
    cache.cache_directory.cache_clear()
    yield
    cache.cache_directory.cache_clear()


def twice(x: float) -> float:
    return 2.0 * x


def test_another_numba_compiles_anew(fresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def hits() -> int:
        compiled = jit.kernel(twice)
        assert compiled(3.0) == 6.0
        return sum(compiled.stats.cache_hits.values())

    assert (hits(), hits()) == (0, 1)
    monkeypatch.setattr(numba, "__version__", "0.0")
    assert hits() == 0


def test_a_number_in_a_call_costs_no_specialisation(fresh: None) -> None:
    @jit.kernel
    def power(x, n):
        result = 1.0
        for _ in range(n):
            result *= x
        return result

    @jit.kernel
    def both(x):
        return power(x, 2) + power(x, 3)

    assert both(2.0) == 12.0
    assert len(power.part.signatures) == 1


def test_what_only_kernels_call_is_no_machine_code_until_python_calls_it(fresh: None) -> None:
    def pair():
        inner = jit.kernel(twice)
        return inner, jit.kernel(lambda x: inner(x) + 1.0)

    inner, outer = pair()
    assert outer(3.0) == 7.0
    assert not inner.signatures
    (part,) = inner.part.overloads.values()
    assert not part.library._codegen._engine.is_symbol_defined(part.fndesc.mangled_name)
    assert inner(3.0) == 6.0
    assert not inner.stats.cache_hits
    # as in a new process: both are on disk
    inner, outer = pair()
    assert (inner(3.0), outer(3.0)) == (6.0, 7.0)
    assert inner.stats.cache_hits
    assert inner.part.stats.cache_hits


def test_without_parts_kernels_give_the_same(fresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "_PARTS", False)
    inner = jit.kernel(twice)
    assert inner.part is inner

    @jit.kernel
    def outer(x):
        return inner(x) + 1.0

    assert outer(3.0) == 7.0
    assert len(inner.signatures) == 1


def test_without_tuning_of_passes_kernels_give_the_same(
    fresh: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "PipelineTuningOptions", None)  # as llvmlite had it before 0.45
    inner = jit.kernel(twice)

    @jit.kernel
    def outer(x):
        return inner(x) + 1.0

    assert outer(3.0) == 7.0


def test_remembered_types_are_those_of_the_arguments(fresh: None) -> None:
    @jit.kernel
    def added(x, y):
        return x + y

    assert type(added(1, 2)) is int
    assert type(added(1, 2.0)) is float
    assert type(added(1.0, 2.0)) is float
    assert type(added(3, 4)) is int


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Event:
    def __init__(self, function) -> None:
        self.data = {"dispatcher": numba.njit(function)}


@pytest.mark.parametrize(("stream", "quiet"), [("file", ""), ("terminal", ""), ("file", "1")])
def test_whoever_waits_is_told_once(
    monkeypatch: pytest.MonkeyPatch, stream: str, quiet: str
) -> None:
    shown = Terminal() if stream == "terminal" else io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.setattr(first_use, "PATIENCE", 0.0)
    monkeypatch.setenv(first_use.QUIET, quiet)
    listener = first_use.Compiling({__name__})
    for _ in range(2):
        listener.on_start(Event(twice))
        assert not gc.isenabled()
        listener.on_start(Event(ast.parse))  # what a kernel of ours calls
        time.sleep(0.05)
        listener.on_end(Event(ast.parse))
        assert not gc.isenabled()
        listener.on_end(Event(twice))
        assert gc.isenabled()
    text = shown.getvalue()
    if quiet:
        assert text == ""
    elif stream == "file":
        assert text == first_use.TEXT + "\n"
    else:
        assert text.count(first_use.TEXT) >= 2 and text.endswith("\r\x1b[K") and "\n" not in text


def test_others_kernels_and_short_waits_are_not_worth_a_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    monkeypatch.delenv(first_use.QUIET, raising=False)
    listener = first_use.Compiling({__name__})
    listener.on_start(Event(twice))
    listener.on_end(Event(twice))
    monkeypatch.setattr(first_use, "PATIENCE", 0.0)
    listener.on_start(Event(ast.parse))
    time.sleep(0.05)
    listener.on_end(Event(ast.parse))
    assert shown.getvalue() == ""


def test_a_plain_script_says_that_it_compiles_the_first_time_only(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    environment.pop(first_use.QUIET, None)
    impatient = "from usv_kernel import compiler, first_use\nfirst_use.PATIENCE = 0.0\n"
    said = [
        subprocess.run(
            [sys.executable, "-c", impatient + CALLS["wrap"]],
            capture_output=True,
            text=True,
            env=environment,
            check=True,
        ).stderr
        for _ in range(2)
    ]
    assert said == [first_use.TEXT + "\n", ""]


def test_only_the_newest_folders_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    cache.cache_directory.cache_clear()
    for age in range(1, 7):
        folder = tmp_path / f"twin.filters.ukf-{age}"
        folder.mkdir()
        os.utime(folder, (1e9 - age, 1e9 - age))
    mine = cache.cache_directory("twin.filters.ukf")
    cache.cache_directory.cache_clear()
    assert mine == tmp_path / f"twin.filters.ukf-{cache.module_digest('twin.filters.ukf')}"
    assert {path.name for path in tmp_path.iterdir()} == {
        mine.name,
        "twin.filters.ukf-1",
        "twin.filters.ukf-2",
        "twin.filters.ukf-3",
    }


def test_an_edited_module_counts_as_not_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(usv_kernel, "_MODULES", {"twin.filters.ukf", "twin.predictors.dsw_ukf"})
    cache.cache_directory.cache_clear()
    assert not cache.cached()
    folder = cache.cache_directory("twin.filters.ukf")
    assert folder is not None
    (folder / "f.nbi").write_bytes(b"")
    assert cache.cached()  # twin.predictors.dsw_ukf was never needed
    old = tmp_path / "twin.predictors.dsw_ukf-0"
    old.mkdir()
    (old / "f.nbi").write_bytes(b"")
    assert not cache.cached()
    cache.cache_directory.cache_clear()


def test_without_a_writable_folder_kernels_are_still_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked))
    monkeypatch.setattr(usv_kernel, "_MODULES", set())
    cache.cache_directory.cache_clear()
    assert cache.cache_directory("twin.filters.ukf") is None
    assert not cache.cached()

    def double(x: float) -> float:
        return 2.0 * x

    assert jit.kernel(double)(3.0) == 6.0
    cache.cache_directory.cache_clear()


SAIL = """
import numpy as np
from usv_gym.world.sea import SeaState
from usv_gym.world.simulation import Simulation
from usv_gym.vessel.vessel import Vessel
simulation = Simulation(1, Vessel.load("usv75"), SeaState(hs=0.5, wind=4.5))
simulation.reset([0], [np.random.default_rng(0)])
for _ in range(200):
    simulation.step(np.array([[20.4, 20.4, 0.2, 0.2]]))
print(simulation.state.tobytes().hex())
"""


def test_fresh_and_cached_code_give_the_same_bits(tmp_path: Path) -> None:
    """What was just compiled and what was read from disk are two pieces of machine code."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    ends = [
        subprocess.run(
            [sys.executable, "-c", SAIL],
            capture_output=True,
            text=True,
            env=environment,
            check=True,
            timeout=300,
        ).stdout
        for _ in range(2)
    ]
    assert ends[0] == ends[1]
