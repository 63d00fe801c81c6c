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

COMMANDS = (SYNC,)
