"""Where `ssac` and `python -m experiments` begin: even an interrupted import is one line."""

import sys

from sim.errors import SimError
from ssac.cli.exits import guarded


def main() -> None:
    """Import the command line and run it; what the user got wrong is one line, else it is a bug."""
    sys.exit(guarded(_run, (SimError,)))


def _run() -> int:
    from experiments.cli import app
    from ssac.cli.command_line import run

    return run(app, sys.argv[1:], "ssac")


if __name__ == "__main__":
    main()
