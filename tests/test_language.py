"""Words that made the first version hard to read stay out of code, tests and documents.

CONTRIBUTING.md says how to write instead. CHANGELOG.md maps old names to new, and is left out.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def words(pattern: str) -> str:
    """Return a pattern for whole words, also between underscores."""
    return rf"(?<![A-Za-z])(?:{pattern})(?![A-Za-z])"


RETIRED = re.compile(
    r"foretells?|foretold|likeness|ripple|believed?|beliefs?|slowness|hold_inside"
    r"|plus_look|plus_spread|look_ahead|in_python|"
    + words(
        "strangers|rivals?|told|kit|rooms?|anew|astray|she|her|felt|usual|sisters?|unborn|spoiled"
        "|draw(?:n)? back|whence|hither|thither|nought|aught|lest|whilst|upon|thereof"
    ),
    re.IGNORECASE,
)
NAMES = re.compile(
    words(
        "grams|watchers?|patience|settle|judge[ds]?|renew|beside|finer|boat_like|feel_wind|spread_now"
        "|spread_ahead|keep_factor|largest_root|echo|alike|fed|stage_course|followers?|rests|fours"
        "|doubt|miss|bands|take_course|sailing"
    ),
    re.IGNORECASE,
)
"""Retired as names of things only; in a sentence they are plain English."""
ALLOWED: dict[str, str] = {
    "tests/test_language.py": "the list itself",
}
"""Files in which a word is unavoidable, and why."""

SUFFIXES = (".py", ".md", ".toml", ".html", ".jinja", ".yml", ".cff", ".csv", ".css", ".js")
GENERATED = "command_line.md"  # from the help texts in twin/cli, which are read anyway
PLACES = ("usv_kernel", "usv_gym", "twin", "tests", "docs", "examples", ".ci", ".github")
TOP = ("README.md", "CONTRIBUTING.md", "CITATION.cff", "pyproject.toml")


def files() -> list[Path]:
    """Return every text that people read."""
    found = [ROOT / name for name in TOP]
    for place in PLACES:
        found += [
            path
            for path in sorted((ROOT / place).rglob("*"))
            if path.suffix in SUFFIXES and "_build" not in path.parts and path.name != GENERATED
        ]
    return found


def test_no_retired_word_is_used():
    found = [
        f"{path.relative_to(ROOT)}:{number}: {match.group()}"
        for path in files()
        if str(path.relative_to(ROOT)) not in ALLOWED
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        for match in RETIRED.finditer(line)
    ]
    assert not found, f"{len(found)} uses\n" + "\n".join(found[:200])


def defined_names(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and name of what a module defines: functions, classes, arguments, variables."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def test_no_name_is_a_retired_word():
    found = [
        f"{path.relative_to(ROOT)}:{number}: {name}"
        for path in files()
        if path.suffix == ".py" and str(path.relative_to(ROOT)) not in ALLOWED
        for number, name in defined_names(path)
        if NAMES.search(name)
    ]
    assert not found, f"{len(found)} names\n" + "\n".join(found[:200])


def test_exceptions_are_still_needed():
    assert not [name for name in ALLOWED if not RETIRED.search((ROOT / name).read_text("utf-8"))]
