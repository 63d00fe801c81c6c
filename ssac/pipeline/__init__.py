"""The one way from recordings to an estimate, for the command line, Python and every study."""
