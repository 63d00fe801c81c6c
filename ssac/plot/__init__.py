"""A result in, figures of it out."""
