"""A path in; a file that appears under it only when it is complete."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssac.files.temporary import temporary_path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder to write to; rename it to `path` at the end.

    If the block fails, the temporary file is removed and whatever was at `path` stays as it was.
    """
    temporary = temporary_path(path)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
