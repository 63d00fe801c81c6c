"""Events of one camera in; the object's track and its outline out."""
