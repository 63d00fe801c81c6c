"""The search for the time offset of least cost, and what two tracks leave undetermined."""
