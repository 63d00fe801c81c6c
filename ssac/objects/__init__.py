"""Events of one camera in; the things that move in them, and which piece follows which, out."""
