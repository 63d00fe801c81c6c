"""Cells in, scored rows out: recordings, cache, schedule, score, provenance."""
