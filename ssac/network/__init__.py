"""Clocks and poses of many cameras and the object's path, from the estimates of their pairs."""
