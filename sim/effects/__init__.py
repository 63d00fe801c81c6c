"""What makes a real sensor worse than the ideal one: lens, lamps, pixels, readout and frames."""
