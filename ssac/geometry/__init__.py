"""Epipolar geometry of two views: points and poses in, distances, F and poses out."""
