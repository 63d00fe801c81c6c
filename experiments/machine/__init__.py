"""Benchmarks of the speed and memory of each part, measured in one run."""
