"""Runs in, the paper's tables, their comparison and the check of all that is committed, out."""
