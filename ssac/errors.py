"""The base classes of the errors that `ssac` raises on purpose."""


class SsacError(ValueError):
    """Bad input: the message says what was expected, what came and what to do."""


class WriteError(SsacError):
    """Something cannot be written: a full disk, no permission. Nothing is wrong with the data."""


class PluginError(RuntimeError):
    """A method of another package has crashed: the message names the package, its file and line."""
