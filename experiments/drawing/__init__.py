"""Figures of results and of recordings, drawn the same whenever they are drawn."""
