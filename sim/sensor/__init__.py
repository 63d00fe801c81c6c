"""Events and intensity frames of a camera that sees luminance over time."""
