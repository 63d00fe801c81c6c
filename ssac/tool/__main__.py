"""The tool without the simulator: `python -m ssac.tool sync CAM1 CAM2 --rig rig.yaml`."""

import sys
from collections.abc import Sequence

from ssac.console.exits import guarded

PROGRAM = "python -m ssac.tool"


def main(args: Sequence[str]) -> int:
    """Run a command line; return its exit code."""
    return guarded(lambda: _run(args))


def _run(args: Sequence[str]) -> int:
    from ssac.console.command_line import command_line, run
    from ssac.tool.commands import COMMANDS

    return run(
        command_line(COMMANDS, "Synchronise and calibrate two event cameras."), args, PROGRAM
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
