"""Entry point of `ssac` and `python -m experiments`: an interrupted import too ends in one line."""

import sys

from sim.errors import SimError
from ssac.cli.exits import guarded


def main() -> None:
    """Import and run the command line; report bad input in one line and anything else as a bug."""
    sys.exit(guarded(_run, (SimError,)))


def _run() -> int:
    from experiments.cli import app
    from ssac.cli.command_line import run

    return run(app, sys.argv[1:], "ssac")


if __name__ == "__main__":
    main()
