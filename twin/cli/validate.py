"""``usv-twin validate``: compare ship and sea with published numbers."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from twin.cli.common import INTERRUPTED, console, errors, note, write_json, write_text

if TYPE_CHECKING:
    from usv_gym.validation.study import Section, Study


def validate_command(
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; fail if the page is out of date.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Every row in full precision.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder of the page; default docs/explanation."),
    ] = None,
) -> None:
    """Compute published and measured results, and write the comparison as a page.

    With --check the page is read instead. The exit code is 1 if a value is out of its tolerance
    or differs from the page.
    """
    from usv_gym.validation import page as validation_page
    from usv_gym.validation.study import Study, shared_folder

    home = Path(__file__).resolve().parents[2]
    # an installed package has no docs: use the present folder
    folder = out or (home / "docs/explanation" if (home / "pyproject.toml").is_file() else Path())
    page = folder / validation_page.PAGE
    before = page.read_text(encoding="utf-8") if page.is_file() else ""
    if check and not before:
        raise FileNotFoundError(errno.ENOENT, "no page to check", str(page))
    study = Study(shared_folder(home))
    try:
        sections = _sections(study)
    except KeyboardInterrupt:
        errors.print("stopped: nothing is written", style="yellow")
        raise typer.Exit(INTERRUPTED) from None
    _print_validation(sections)
    if json_file is not None:
        write_json(json_file, validation_page.to_json(sections))
    wrong = validation_page.failures(sections)
    if check:
        wrong += validation_page.compare(before, sections)
    else:
        from usv_gym.validation.figures import draw

        folder.mkdir(parents=True, exist_ok=True)
        write_text(page, validation_page.render(sections, before))
        with console.status("drawing the pictures"):
            drawn = draw(study, folder / validation_page.FOLDER)
        console.print(f"{page}, {len(drawn)} pictures in {folder / validation_page.FOLDER}")
    for text in wrong:
        errors.print(text, style="red", highlight=False, soft_wrap=True)
    if wrong:
        raise typer.Exit(1)


def _sections(study: Study) -> list[Section]:
    """Compute all sections of the page with a progress bar."""
    from usv_gym.validation.sections import SECTIONS

    sections = []
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), console=console
    ) as progress:
        bar = progress.add_task("validating", total=len(SECTIONS))
        for name, section in SECTIONS.items():
            progress.update(bar, description=name)
            sections.append(section(study))
            progress.advance(bar)
    return sections


def _print_validation(sections: list[Section]) -> None:
    """Print the number of rows by result."""
    table = Table(title="validation", box=SIMPLE_HEAD)
    for name in ("section", "ok", "out", "reported", "skipped"):
        table.add_column(name, justify="left" if name == "section" else "right")
    reasons: list[str] = []
    for section in sections:
        skipped = [row.skipped for row in section.rows if row.skipped]
        results = [row.ok for row in section.rows if not row.skipped]
        counts = results.count(True), results.count(False), results.count(None), len(skipped)
        table.add_row(section.title, *map(str, counts))
        reasons += skipped
    console.print(table)
    for reason in dict.fromkeys(reasons):
        note(f"skipped: {reason}")
