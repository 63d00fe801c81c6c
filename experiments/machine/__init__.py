"""Speed and memory of each part, side by side in one run."""
