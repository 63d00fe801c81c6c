"""Inputs of all kinds, damaged in all ways, and what becomes of them."""
