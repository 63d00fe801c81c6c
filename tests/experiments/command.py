"""Command lines of `ssac`, run in the process of the test; exceptions reach the test."""

from typer import Typer
from typer.testing import CliRunner

from experiments import cli


def run(*words: object, app: Typer = cli.app, exit_code: int = 0) -> str:
    """Run a command that must end with this code, and return its output."""
    result = CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False)
    assert result.exit_code == exit_code, result.output
    return result.output
