"""Two tracks and an offset to start from in; offset, pose and their deviations out."""
