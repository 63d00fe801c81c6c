"""Commands that simulate, show or measure one recording at a time."""
