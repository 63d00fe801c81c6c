"""Where the object is in the image of one camera, from its events or its track."""
