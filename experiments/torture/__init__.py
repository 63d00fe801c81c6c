"""Damaged inputs, full disks and killed processes: what becomes of them."""
