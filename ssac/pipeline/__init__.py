"""The pipeline from recordings to an estimate; the command line, Python and every study use it."""
