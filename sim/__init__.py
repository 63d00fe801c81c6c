"""Recordings with known truth: a drone on a random path, seen by event cameras.

`sim.recording.simulate` is the whole chain. Nothing here knows how offsets are estimated.
"""
