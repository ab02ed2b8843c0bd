"""The code of every page runs: all of a tutorial, and the Python of other pages."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
NOT_RUN = ("index", "ardurover")
"""Pages without code, and one that needs a program that is not ours."""

TUTORIALS = sorted(p for p in (DOCS / "tutorials").glob("*.md") if p.stem not in NOT_RUN)
OTHERS = [
    path
    for path in sorted(DOCS.rglob("*.md"))
    if path not in TUTORIALS and "\n```python\n" in path.read_text(encoding="utf-8")
]
BLOCK = re.compile(
    r"^```(?:(python|sh)\n|\{code-block\} \w+\n:caption: (\S+)\n)(.*?)^```$", re.M | re.S
)


def blocks_of(page: Path) -> list[tuple[str, str, str]]:
    """Return kind, name of the file to write, and text of each block that a reader would run."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


def script_of(page: Path) -> str:
    """Return a program that runs a page's blocks of Python in one process, and its commands."""
    lines = ["import subprocess, sys", "sys.path.insert(0, '')", "names = {'__name__': 'page'}"]
    for number, (kind, name, text) in enumerate(blocks_of(page), 1):
        if name:
            lines.append(f"open({name!r}, 'w').write({text!r})")
        elif kind == "sh":
            lines.append(f"subprocess.run({text!r}, shell=True, check=True)")
        else:
            code = f"compile({text!r}, 'block {number} of {page.name}', 'exec')"
            lines.append(f"exec({code}, names)")
    return "\n".join(lines)


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict[str, str]:
    """Return an environment whose command usv-twin is that of this checkout."""
    folder = tmp_path_factory.mktemp("bin")
    command = folder / "usv-twin"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m twin.cli "$@"\n')
    command.chmod(0o755)
    path = os.pathsep.join([str(folder), os.environ["PATH"]])
    # modules that pages import from the working directory
    modules = os.pathsep.join(
        [str(DOCS.parent / "examples"), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    # torch on two threads of a busy machine is slower by far
    changed = {"PATH": path, "PYTHONPATH": modules, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    return os.environ | changed


@pytest.mark.slow
@pytest.mark.parametrize("page", [*TUTORIALS, *OTHERS], ids=lambda page: page.stem)
def test_page_runs(page, environment, tmp_path):
    if "stable_baselines3" in page.read_text(encoding="utf-8"):
        pytest.importorskip("stable_baselines3")
    done = subprocess.run(
        [sys.executable, "-c", script_of(page)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def test_each_tutorial_has_code():
    assert len(TUTORIALS) == 6
    assert all(len(blocks_of(page)) >= 4 for page in TUTORIALS)
