"""One recording at a time: made, shown, measured."""
