"""The commands that need recordings alone, no simulator, as entries of a command line."""

from ssac.console.command_line import Entry

USE = "Use"
"""Heading of the commands for recordings of one's own; the others reproduce results."""

SYNC = Entry(
    "sync",
    USE,
    "Offset and pose of two cameras from their recordings.",
    "ssac.tool.sync_command",
    "sync_command",
)

TRACK = Entry(
    "track",
    USE,
    "The object's path in one camera's events, as a track file.",
    "ssac.convert.track_command",
    "track_command",
)

IMPORT = Entry(
    "import",
    USE,
    "A public data set as track files and a rig.",
    "ssac.convert.import_command",
    "import_command",
)

COMPARE = Entry(
    "compare",
    USE,
    "How far a path in space is from the truth.",
    "ssac.compare.compare_command",
    "compare_command",
)

COMMANDS = (SYNC, TRACK, IMPORT, COMPARE)
