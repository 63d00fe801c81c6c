"""Where simulated recordings meet the method: the command line, the demo and the benchmarks."""
