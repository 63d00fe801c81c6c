"""What is filmed: trajectory, drone, background, and the rig of cameras that look on."""
