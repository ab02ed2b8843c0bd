"""What all commands share: where they print, and how options are read and results written."""

from __future__ import annotations

import json
from typing import Any

from rich.console import Console

from twin.protocol import BenchmarkError

__all__ = ["INTERRUPTED", "console", "errors", "listed", "note", "results_text", "seeds_of"]

console = Console(markup=False)
errors = Console(stderr=True, markup=False)
INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def note(text: str) -> None:
    """Print what a user should know."""
    console.print(f"note: {text}", style="yellow", highlight=False, soft_wrap=True)


def listed(text: str, option: str) -> tuple[str, ...]:
    """Return the items of a comma-separated option, each once."""
    items = tuple(dict.fromkeys(item.strip() for item in text.split(",") if item.strip()))
    if not items:
        raise BenchmarkError(f"{option}: name at least one")
    return items


def seeds_of(text: str) -> tuple[int, ...]:
    """Return seeds: ``A-B``, ``A:B`` for A to B - 1, or a list as ``0,4,7``."""
    try:
        found: list[int] = []
        for item in text.split(","):
            first, mark, last = item.partition(":" if ":" in item else "-")
            begin = int(first) if first or mark != ":" else 0
            found += range(begin, int(last) + (mark == "-") if mark else begin + 1)
        seeds = tuple(dict.fromkeys(found))
    except ValueError:
        raise BenchmarkError(
            f"--seeds {text}: write A-B, A:B for A to B - 1, or a list as 0,4,7"
        ) from None
    if not seeds or min(seeds) < 0:
        raise BenchmarkError(f"--seeds {text}: holds no seed of 0 or more")
    return seeds


def results_text(results: dict[str, Any]) -> str:
    """Return results as JSON with a line for each row of each table."""
    lines = []
    for key, value in results.items():
        text = json.dumps(value, indent=1) if isinstance(value, dict) else json.dumps(value)
        if isinstance(value, list) and value and isinstance(value[0], dict):
            text = "[\n  " + ",\n  ".join(json.dumps(row) for row in value) + "\n ]"
        lines.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"
