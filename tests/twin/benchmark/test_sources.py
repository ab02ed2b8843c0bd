"""A kept result is reused until the files of its predictor change."""

from __future__ import annotations

import sys

import pytest

from twin.benchmark import runner
from twin.benchmark.protocol import Settings
from twin.benchmark.sources import predictor_digest, versions
from twin.predictors.baselines import Persistence
from twin.predictors.registry import PREDICTORS, PredictorError

NAME = "yard_predict:Mine"

MAIN = """
from twin.predictors.baselines import Persistence

class Mine(Persistence):
    files = ("weights", "yard_models.py")
"""


@pytest.fixture
def yard(tmp_path, monkeypatch):
    """A user's module with weights and a helper, beside a file that it does not name."""
    (tmp_path / "weights").mkdir()
    for name, text in {
        "yard_predict.py": MAIN,
        "yard_models.py": "gain = 1.0",
        "weights/a.txt": "1",
        "notes.txt": "2",
    }.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.delitem(sys.modules, "yard_predict", raising=False)
    yield tmp_path
    sys.modules.pop("yard_predict", None)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("yard_predict.py", True),
        ("yard_models.py", True),
        ("weights/a.txt", True),
        ("notes.txt", False),
    ],
)
def test_an_edit_of_a_named_file_changes_the_hash(yard, name, counts):
    before = predictor_digest(NAME)
    assert predictor_digest(NAME) == before
    (yard / name).write_text((yard / name).read_text() + "\n")
    assert (predictor_digest(NAME) != before) is counts


IMPORTED = {
    "helper.py": "import nets.deep",
    "nets/__init__.py": "",
    "nets/deep.py": "from . import b",
    "nets/b.py": "x = 1",
    "late.py": "def broken(:",
    "bare/one.py": "import numpy",  # of a folder without __init__.py
}


@pytest.mark.parametrize("name", IMPORTED)
def test_an_edit_of_an_imported_module_beside_it_changes_the_hash(yard, name):
    """Also of one that another one imports, that a method imports, or of a package."""
    for each, text in {**IMPORTED, "plot.py": ""}.items():
        (yard / each).parent.mkdir(exist_ok=True)
        (yard / each).write_text(text)
    late = "    def estimate(self):\n        import late, numpy, bare.one\n"
    (yard / "yard_predict.py").write_text(f"import helper\n{MAIN}{late}")
    before = predictor_digest(NAME)
    (yard / "plot.py").write_text("a script that it does not import")
    assert predictor_digest(NAME) == before
    (yard / name).write_text("x = 2")
    assert predictor_digest(NAME) != before
    for each in ("helper", "nets", "nets.deep", "nets.b"):
        sys.modules.pop(each, None)


def test_a_result_is_computed_again_after_an_edit(yard, tmp_path):
    settings = Settings(
        scenarios=("turn",),
        faults=("none",),
        seeds=(0,),
        plans=("hold",),
        predictors=(NAME, "persistence"),
        identify_s=20.0,
        duration_s=32.0,
    )
    assert len(dict(runner.runs(settings, tmp_path / "out"))) == 2
    assert len(runner.reusable(settings, tmp_path / "out")) == 2
    (yard / "weights" / "a.txt").write_text("5")
    (left,) = runner.reusable(settings, tmp_path / "out")
    assert left.predictor == "persistence"


def test_a_missing_file_is_named(yard):
    predictor_digest(NAME)
    kind = sys.modules["yard_predict"].Mine
    kind.files = ("wieghts.npz",)
    with pytest.raises(PredictorError, match=r"wieghts\.npz"):
        predictor_digest(NAME)
    kind.files = "weights"
    with pytest.raises(PredictorError, match="tuple"):
        predictor_digest(NAME)


def test_a_class_without_a_file_shares_no_results(monkeypatch):
    kind = type("Typed", (Persistence,), {"__module__": "typed_in"})
    monkeypatch.setitem(PREDICTORS, "typed", kind)
    assert predictor_digest("typed") != predictor_digest("typed")


def test_predictors_of_the_package_have_no_hash():
    assert predictor_digest("dsw-ukf-plus") == ""
    assert "torch" in versions("lstm") and "torch" not in versions("ukf")
