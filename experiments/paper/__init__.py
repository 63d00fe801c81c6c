"""Runs in, the paper's tables, their comparison and the page of both, out."""
