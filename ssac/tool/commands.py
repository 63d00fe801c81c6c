"""The commands that need recordings alone, no simulator, as entries of a command line."""

from ssac.console.command_line import Entry

USE = "Use"
"""Heading of the commands for recordings of one's own; the others reproduce results."""

SYNC = Entry(
    "sync",
    USE,
    "Find time offset and pose of two or more cameras.",
    "ssac.tool.sync_command",
    "sync_command",
)

TRACK = Entry(
    "track",
    USE,
    "Extract the object's image track from a camera's events.",
    "ssac.convert.track_command",
    "track_command",
)

IMPORT = Entry(
    "import",
    USE,
    "Convert a public data set to track files and a rig.",
    "ssac.convert.import_command",
    "import_command",
)

COMPARE = Entry(
    "compare",
    USE,
    "Compare an estimated path in space with a reference.",
    "ssac.compare.compare_command",
    "compare_command",
)

COMMANDS = (SYNC, TRACK, IMPORT, COMPARE)
