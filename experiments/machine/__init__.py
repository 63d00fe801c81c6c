"""What the machine makes of our code: speed and memory, as ratios side by side in one run."""
