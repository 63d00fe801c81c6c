"""The pictures of a scene: linear luminance of crops that follow the drone."""
