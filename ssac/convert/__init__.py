"""Recordings in one form in, the same in another out."""
