"""The validation page has the tables that its script prints."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs/explanation/validation.md").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize(("function", "rows"), [("tanks", 11), ("boundary_elements", 4)])
def test_the_page_has_the_printed_rows(
    function: str,
    rows: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples/validation")
    runpy.run_path(str(ROOT / "examples/validation/compare.py"))[function]()
    printed = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert len(printed) == rows + 2
    assert not set(printed[2:]) - set(PAGE)
