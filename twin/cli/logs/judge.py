"""``usv-twin judge``: whether a twin of a log may be trusted, in five lines or six."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.benchmark.trust import RULES, TrustMeter, Verdict
from twin.cli.common import (
    LogArgument,
    MappingOption,
    ModelOption,
    ShipOption,
    console,
    open_log,
    print_health,
    row_progress,
    write_json,
)
from twin.cli.logs.judge_picture import draw_verdict
from twin.integrity.findings import Finding
from twin.integrity.log_check import check_recording
from twin.logs.log import read_table
from twin.logs.recording import Recording
from twin.particulars import Particulars
from twin.predictors.registry import DEFAULT, PREDICTORS
from usv_kernel.files import write_whole

STYLES = {"green": "green", "amber": "yellow", "red": "red"}


def verdict_command(
    log: LogArgument,
    predictor: Annotated[
        str,
        typer.Option("--predictor", "-p", help=f"One of: {', '.join(PREDICTORS)}."),
    ] = DEFAULT,
    model: ModelOption = None,
    ship: ShipOption = None,
    mapping: MappingOption = None,
    until: Annotated[float | None, typer.Option(help="Stop at this time of the log, s.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture, PNG. [<log>_judge.png]")
    ] = None,
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw none.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Everything, in full precision.")
    ] = None,
) -> None:
    """Judge a log; the help page is below."""
    run, twin = open_log(log, predictor, ship=ship, until=until, model=model, mapping=mapping)
    meter = TrustMeter(twin, run)
    with row_progress("scoring", len(run)) as advance:

        def on_row() -> None:
            meter()
            advance()

        twin.run(run, on_row)
    print_health(twin)
    verdict = meter.verdict(findings_of(log, mapping, twin.particulars, until))
    print_verdict(verdict)
    if json_file is not None:
        write_json(json_file, {**verdict.to_json(), "health_notes": list(twin.notes)})
    if not no_picture:
        path = picture or Path(f"{run.name}_judge.png")
        write_whole(path, draw_verdict(verdict, run))
        console.print(f"picture: {path}", soft_wrap=True)
    if verdict.colour == "red":
        raise typer.Exit(1)


verdict_command.__doc__ = f"""Say in a few lines and one colour whether a twin may be trusted.

    The twin runs over the log once. Forecasts are scored against the log's own fixes and headings,
    beside persistence. Copies of the twin go on without fixes in the later half of the log.
    Without GPS a position may be off by the boat's length, 5 m or 5 standard deviations of a fix,
    whichever is largest. Where the log shows roll and pitch, a sixth line scores their forecasts
    against what the twin finds two seconds later, beside the present angles, held.

    {RULES.replace(chr(10), chr(10) + "    ")}

    Exit code 0: green or amber; 1: red; 2: it cannot be read.
    """


def findings_of(
    log: Path, mapping: Path | None, particulars: Particulars, until: float | None
) -> tuple[Finding, ...]:
    """Return what ``usv-twin log check`` finds in a log up to a time (s), and cannot tell."""
    table = read_table(log, mapping)
    data = table.data
    if until is not None:
        kept = data["t_s"] <= until
        data = {name: column[kept] for name, column in data.items()}
    recording = Recording.of(data, table.given, table.name, table.plane)
    return check_recording(recording, particulars).findings


def print_verdict(verdict: Verdict) -> None:
    """Print the colour and the lines."""
    console.print()
    title = f"{verdict.log}, {verdict.predictor}: {verdict.colour}"
    console.print(title, style=STYLES[verdict.colour], highlight=False, soft_wrap=True)
    width = max(len(answer.about) for answer in verdict.answers)
    for answer in verdict.answers:
        line = f"{answer.colour:<6}{answer.about:<{width}}  {answer.text}"
        console.print(line, style=STYLES[answer.colour], highlight=False, soft_wrap=True)
