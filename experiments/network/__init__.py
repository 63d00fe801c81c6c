"""Many cameras at once: four of events round a drone, and how time grows with eight of frames."""
