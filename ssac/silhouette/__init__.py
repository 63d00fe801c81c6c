"""The object's whole image out of its events, and what perspective makes of it."""
