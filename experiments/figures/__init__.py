"""Results and recordings in, the figures of `results/` out."""
