"""Files of events, tracks and rigs, and writing files whole."""
