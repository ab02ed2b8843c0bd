"""Words that made the first version hard to read stay out of code, tests and documents.

CONTRIBUTING.md says how to write instead. CHANGELOG.md maps old names to new, and is left out.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RETIRED = re.compile(
    r"foretells?|foretold|likeness|\bstrangers\b|\brivals?\b|ripple|believed?|beliefs?|slowness|\btold\b"
    r"|\bkit\b|\brooms?\b|\banew\b|\bastray\b|\bhold_inside\b|plus_look|plus_spread|look_ahead"
    r"|\bshe\b|\bher\b|\bfelt\b|\busual\b|\bsisters?\b|in_python|\bunborn\b|\bspoiled\b"
    r"|\bdraw(?:n)? back\b",
    re.IGNORECASE,
)
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


def test_exceptions_are_still_needed():
    assert not [name for name in ALLOWED if not RETIRED.search((ROOT / name).read_text("utf-8"))]
