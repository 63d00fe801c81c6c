"""The paper's outdoor experiment as a twin: two cameras 20 m apart, one drone, its path by RTK."""
