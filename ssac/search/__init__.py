"""Two tracks in; the time offset of least cost, and what they cannot tell, out."""
