"""The root of every error that `sim` raises on purpose."""


class SimError(ValueError):
    """Bad input: the message says what was expected, what came and what to do."""
