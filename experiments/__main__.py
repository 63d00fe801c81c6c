"""Where `ssac` and `python -m experiments` begin: even an interrupted import is one line."""

import sys

from ssac.cli.exits import guarded


def main() -> None:
    """Import the command line and run it."""
    sys.exit(guarded(_run))


def _run() -> int:
    from experiments.cli import main

    main()  # ends with its own exit code
    return 0


if __name__ == "__main__":
    main()
