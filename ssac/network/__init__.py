"""Clocks, poses and the object's path of many cameras, from what their pairs say."""
