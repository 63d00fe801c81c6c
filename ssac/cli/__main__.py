"""The command line without the simulator: `python -m ssac.cli sync CAM1 CAM2 --rig rig.yaml`."""

import sys
from collections.abc import Sequence

from ssac.cli.exits import guarded


def main(args: Sequence[str]) -> int:
    """Run a command line; return its exit code."""
    return guarded(lambda: _run(args))


def _run(args: Sequence[str]) -> int:
    from ssac.cli.command_line import COMMANDS, command_line, run

    app = command_line(COMMANDS, "Synchronise and calibrate two event cameras.")
    return run(app, args, "python -m ssac.cli")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
