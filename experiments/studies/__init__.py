"""Questions that many runs answer: sweeps, ablations, coverage, refusal, the bound."""
