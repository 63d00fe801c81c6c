"""Code that all studies share, from their cells to their files, checks and commands."""
