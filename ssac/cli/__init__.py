"""The command line: commands for recordings of one's own, and what all commands share."""
