"""Methods that the paper compares with, or should: one file each, all with the same signature."""
