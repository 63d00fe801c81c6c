"""A scene at many instants in, linear luminance of crops that follow the drone out."""
