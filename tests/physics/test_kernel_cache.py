"""Compiled code on disk: any edit of any kernel source must be seen by every caller of it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import usv_kernel

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
    seen = {usv_kernel.sources_digest(tree)}
    assert seen == {usv_kernel.sources_digest(tree)}
    assert seen == {usv_kernel.sources_digest()}  # where the tree lies does not matter
    sources = sorted(path for package in PACKAGES for path in (tree / package).rglob("*.py"))
    assert len(sources) > 20
    for number, path in enumerate(sources, start=1):
        path.write_text(path.read_text(encoding="utf-8") + "#\n", encoding="utf-8")
        seen.add(usv_kernel.sources_digest(tree))
        assert len(seen) == number + 1, f"an edit of {path.relative_to(tree)} was not seen"


def test_the_digest_sees_a_file_moved_renamed_or_added(tree: Path) -> None:
    seen = {usv_kernel.sources_digest(tree)}
    (tree / "usv_gym" / "physics" / "hull.py").rename(tree / "usv_gym" / "physics" / "body.py")
    seen.add(usv_kernel.sources_digest(tree))
    (tree / "twin" / "new.py").write_text("", encoding="utf-8")
    seen.add(usv_kernel.sources_digest(tree))
    assert len(seen) == 3


CALLS = {
    # usv_gym/tasks.py calls usv_kernel.wrap, which numba compiles into it
    "wrap": """
import numpy as np
from usv_gym.tasks import path_errors
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
        usv_kernel._source.cache_clear()
        return usv_kernel.module_digest("usv_gym.physics.ship", tree)

    before = digest()
    assert usv_kernel.module_digest("usv_gym.physics.ship") == before
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
    for source in ("twin/ukf.py", "usv_gym/env.py"):
        path = tree / source
        path.write_text(path.read_text(encoding="utf-8") + "#\n", encoding="utf-8")
    assert digest() == before


def test_imports_are_found_in_every_form(tmp_path: Path) -> None:
    path = tmp_path / "some.py"
    path.write_text(
        "import usv_gym.rao, math\nfrom twin import (\n    ukf as u,\n    model,\n)\n"
        "def f():\n    from usv_gym.physics import hull  # late\n",
        encoding="utf-8",
    )
    assert usv_kernel._source(path)[1] == {
        *("usv_gym.rao", "math", "twin", "twin.ukf", "twin.model"),
        *("usv_gym.physics", "usv_gym.physics.hull"),
    }


def test_only_the_newest_folders_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    usv_kernel.cache_directory.cache_clear()
    for age in range(1, 7):
        folder = tmp_path / f"twin.ukf-{age}"
        folder.mkdir()
        os.utime(folder, (1e9 - age, 1e9 - age))
    mine = usv_kernel.cache_directory("twin.ukf")
    usv_kernel.cache_directory.cache_clear()
    assert mine == tmp_path / f"twin.ukf-{usv_kernel.module_digest('twin.ukf')}"
    assert {path.name for path in tmp_path.iterdir()} == {
        mine.name,
        "twin.ukf-1",
        "twin.ukf-2",
        "twin.ukf-3",
    }


def test_an_edited_module_counts_as_not_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(usv_kernel, "_MODULES", {"twin.ukf", "twin.dsw"})
    usv_kernel.cache_directory.cache_clear()
    assert not usv_kernel.cached()
    folder = usv_kernel.cache_directory("twin.ukf")
    assert folder is not None
    (folder / "f.nbi").write_bytes(b"")
    assert usv_kernel.cached()  # twin.dsw was never needed
    old = tmp_path / "twin.dsw-0"
    old.mkdir()
    (old / "f.nbi").write_bytes(b"")
    assert not usv_kernel.cached()
    usv_kernel.cache_directory.cache_clear()


def test_without_a_writable_folder_kernels_are_still_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked))
    monkeypatch.setattr(usv_kernel, "_MODULES", set())
    usv_kernel.cache_directory.cache_clear()
    assert usv_kernel.cache_directory("twin.ukf") is None
    assert not usv_kernel.cached()

    def double(x: float) -> float:
        return 2.0 * x

    assert usv_kernel.kernel(double)(3.0) == 6.0
    usv_kernel.cache_directory.cache_clear()


SAIL = """
import numpy as np
from usv_gym.sea import SeaState
from usv_gym.simulation import Simulation
from usv_gym.vessel import Vessel
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
