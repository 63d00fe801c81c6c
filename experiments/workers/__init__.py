"""Who does the work: processes, the workers of a cluster, and which of them is on what."""
