"""Command lines of `ssac`, run in the process of the test; exceptions reach the test."""

from typer.testing import CliRunner

from experiments.cli import app


def run(*words: object) -> str:
    """Run a command that must succeed, and return its output."""
    result = CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output
