"""The laboratory: what every study shares, from its cells to its files, checks and commands."""
