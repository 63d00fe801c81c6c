"""Many cameras: what their pairs told in; clocks and poses of all, and the path, out."""
