"""The command line, run in this process."""

from __future__ import annotations

from typer.testing import CliRunner

from twin.cli.main import app

__all__ = ["run"]


def run(*arguments, check=0):
    """Run the command line in this process; ``check`` is the exit code, None any."""
    result = CliRunner().invoke(app, [str(item) for item in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert check is None or result.exit_code == check, result.output
    return result
