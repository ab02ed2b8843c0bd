"""The wheel holds every file that the packages read, and nothing else."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("usv_kernel", "usv_gym", "twin")
JUNK = {"__pycache__"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> set[str]:
    """Return the names in a wheel that is built from this checkout, without network."""
    pytest.importorskip("setuptools", minversion="77")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # setuptools leaves a build folder behind
    names = ("README.md", "LICENSE", "pyproject.toml", *PACKAGES)
    source.mkdir()
    for name in names:
        (source / name).symlink_to(ROOT / name)
    build = "from setuptools import build_meta as b; import sys; print(b.build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", build, str(folder)], cwd=source, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (path,) = folder.glob("*.whl")
    return set(zipfile.ZipFile(path).namelist())


def test_wheel_holds_every_file_of_the_packages(wheel):
    expected = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and not JUNK & set(path.parts)
    }
    assert {name for name in wheel if name.startswith(PACKAGES)} == expected


def test_wheel_has_licences_command_and_data(wheel):
    endings = ("LICENSE", "NOTICE.txt", "entry_points.txt", "/py.typed", "/usv75.toml", ".csv.gz")
    assert not [end for end in endings if not any(name.endswith(end) for name in wheel)]


def test_versions_agree():
    import usv_kernel

    assert f"version: {usv_kernel.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {usv_kernel.__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_the_project_is_named_by_one_address():
    about = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]
    for name in ("README.md", "CITATION.cff", "docs/index.md", "docs/conf.py"):
        assert about["Source"] in (ROOT / name).read_text(), name
