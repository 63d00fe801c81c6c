"""Figures of results and of recordings, the same for the same data."""
