"""Results results in, the numbers and tables that the pages quote out."""
