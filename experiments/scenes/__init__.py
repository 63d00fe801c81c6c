"""One recording at a time: simulated, shown, measured."""
