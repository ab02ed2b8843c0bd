"""What a result depends on: sources, files and versions."""

from __future__ import annotations

import sys

import pytest

from twin.benchmark import runner as bench
from twin.benchmark.protocol import Settings, Unit
from twin.benchmark.publish import sources
from twin.predictors.baselines import Persistence
from twin.predictors.registry import PREDICTORS, PredictorError, predictor_class

MAIN = """
from twin.predictors.baselines import Persistence
from yard.models import gain

class Mine(Persistence):
    files = ("weights",)
    average = gain
"""

INNER = """
def half():
    import side_by_side
    return side_by_side.gain
"""


@pytest.fixture
def yard(tmp_path, monkeypatch):
    """A package of a user's, beside a module and a folder that it does not use."""
    texts = {
        "yard/__init__.py": "",
        "yard/predict.py": MAIN,
        "yard/models.py": "from .deep import inner\ngain = inner.half()\n",
        "yard/deep/__init__.py": "",
        "yard/deep/inner.py": INNER,
        "yard/deep/unused.py": "gain = 3\n",
        "side_by_side.py": "gain = 0.5\n",
        "yard/weights/a.txt": "1",
        "yard/weights/b.txt": "2",
        "yard/notes.txt": "3",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    forget()
    yield tmp_path
    forget()


def forget():
    """Let the next import read the files again."""
    for name in [name for name in sys.modules if name.split(".")[0] in ("yard", "side_by_side")]:
        del sys.modules[name]


SETTINGS = Settings(scenarios=("turn",), predictors=("persistence",), seeds=(0,))


def digest_now(predictor="yard.predict:Mine"):
    forget()
    return bench.digest(SETTINGS, Unit("turn", "none", 0, predictor))


def test_sources_are_those_that_are_imported(yard):
    found = sources.sources_of(predictor_class("yard.predict:Mine"))
    assert set(found.files) == {
        *("yard", "yard.predict", "yard.models", "yard.deep", "yard.deep.inner", "side_by_side"),
    }
    assert found.complete
    assert found.packages == ()


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("yard/predict.py", True),
        ("yard/models.py", True),
        ("yard/deep/inner.py", True),
        ("yard/deep/__init__.py", True),
        ("side_by_side.py", True),
        ("yard/weights/b.txt", True),
        ("yard/deep/unused.py", False),
        ("yard/notes.txt", False),
    ],
)
def test_an_edit_of_what_is_used_changes_the_key(yard, name, counts):
    before = digest_now()
    assert digest_now() == before
    path = yard / name
    path.write_text(path.read_text() + "\n" * 2)
    assert (digest_now() != before) is counts


def test_a_result_is_not_reused_after_an_edit_of_a_helper(yard, tmp_path):
    settings = Settings(
        scenarios=("turn",),
        faults=("none",),
        seeds=(0,),
        plans=("hold",),
        predictors=("yard.predict:Mine", "persistence"),
        identify_s=20.0,
        duration_s=32.0,
    )
    done = dict(bench.runs(settings, tmp_path / "out"))
    assert len(bench.reusable(settings, tmp_path / "out")) == 2
    (yard / "side_by_side.py").write_text("gain = 4.0\n")
    forget()
    assert [unit.predictor for unit in bench.reusable(settings, tmp_path / "out")] == [
        "persistence"
    ]
    again = dict(bench.runs(settings, tmp_path / "out"))
    changed = {
        unit.predictor for unit, result in again.items() if result["plans"] != done[unit]["plans"]
    }
    assert changed == {"yard.predict:Mine"}
    (yard / "yard/weights/a.txt").write_text("5")
    assert len(bench.reusable(settings, tmp_path / "out")) == 1


def test_a_moved_folder_changes_no_key(yard, tmp_path, monkeypatch):
    before = digest_now()
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for name in ("yard", "side_by_side.py"):
        (yard / name).rename(moved / name)
    monkeypatch.setattr(sys, "path", [str(moved), *sys.path[1:]])
    monkeypatch.chdir(moved)
    assert digest_now() == before


def test_a_missing_file_is_named(yard):
    (yard / "yard/predict.py").write_text(MAIN.replace('"weights"', '"wieghts.npz"'))
    with pytest.raises(PredictorError, match=r"declares the file 'wieghts.npz', but there is no"):
        digest_now()
    (yard / "yard/predict.py").write_text(MAIN.replace('("weights",)', '"weights"'))
    with pytest.raises(PredictorError, match="write a tuple of file names"):
        digest_now()


def test_installed_packages_count_by_version(yard, monkeypatch):
    (yard / "yard/models.py").write_text("import numpy.linalg\ngain = 1.0\n")
    forget()
    (package,) = sources.sources_of(predictor_class("yard.predict:Mine")).packages
    assert package == f"numpy {sources.versions()['numpy']}"


def test_a_class_without_a_file_shares_no_results(monkeypatch):
    kinds = [type("Typed", (Persistence,), {"__module__": "typed_in"}) for _ in range(2)]
    keys = []
    for kind in kinds:
        monkeypatch.setitem(PREDICTORS, "typed", kind)
        keys += [sources.predictor_digest("typed")] * 2
        assert sources.predictor_digest("typed") == keys[-1]
    assert keys[0] != keys[2]


def test_predictors_of_the_package_have_no_sources_of_their_own():
    assert sources.predictor_digest("dsw-ukf-plus") == ""
    assert "torch" in sources.versions("lstm") and "torch" not in sources.versions("ukf")
