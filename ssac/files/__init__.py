"""Event files, rig files and results between disk and memory."""
