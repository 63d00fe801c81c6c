"""Epipolar geometry of two views: distances, fundamental matrices and poses."""
