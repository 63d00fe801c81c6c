"""A command line of `ssac`, run within the test; what it raises comes out."""

from typer.testing import CliRunner

from experiments.cli import app


def run(*words: object) -> str:
    """Run one that ends well, and give what it said."""
    result = CliRunner().invoke(app, [*map(str, words)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output
