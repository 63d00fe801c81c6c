"""Files of results in, `SHA256SUMS` out: what each was when its command wrote it.

The file is of the form that `sha256sum --check` takes. Every command that writes results records
them here, so a file that was changed by hand, or by a command that was stopped, does not agree.
"""

import fcntl
import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

SUMS_FILE = "SHA256SUMS"

_DIGITS = 64  # of a digest


def record_checksums(folder: Path, paths: Iterable[Path]) -> None:
    """Note what files of a folder of results are now; the notes on its other files stay.

    Parameters
    ----------
    folder
        Of the results. Several commands may write to it at once.
    paths
        Files in it that were just written, each with its provenance if that lies beside it.
    """
    with _alone(folder):
        sums = read_checksums(folder) if (folder / SUMS_FILE).exists() else {}
        for path in paths:
            beside = path.with_suffix(".provenance.json")
            for one in {path, beside} if beside.exists() else {path}:
                sums[one.relative_to(folder).as_posix()] = sha256(one)
        kept = {name: digest for name, digest in sums.items() if (folder / name).exists()}
        lines = [f"{digest}  {name}\n" for name, digest in sorted(kept.items())]
        with whole_file(folder / SUMS_FILE) as temporary:
            temporary.write_text("".join(lines), encoding="utf-8", newline="\n")


def read_checksums(folder: Path) -> dict[str, str]:
    """Read the notes of a folder: name -> digest.

    Raises
    ------
    SsacError
        If the file cannot be read, or a line of it is none.
    """
    path = folder / SUMS_FILE
    try:
        lines = path.read_bytes().decode("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SsacError(f"{path} cannot be read: {error}") from error
    sums = {}
    for number, line in enumerate(lines, start=1):
        digest, gap, name = line[:_DIGITS], line[_DIGITS : _DIGITS + 2], line[_DIGITS + 2 :]
        if set(digest) - set("0123456789abcdef") or gap != "  " or not name:
            raise SsacError(f"{path}: line {number} is no digest and name: {line[:100]!r}")
        sums[name] = digest
    return sums


def sha256(path: Path) -> str:
    """Digest of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep other commands from changing the notes meanwhile."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
