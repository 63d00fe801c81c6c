"""All results in, one HTML page out."""
