"""The folder of results in, whether it can be trusted out: whole, as written, and made again."""
