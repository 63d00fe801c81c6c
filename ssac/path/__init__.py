"""The object's path in space: read and written, fitted, laid over another one."""
