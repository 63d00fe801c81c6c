"""Whether entries of the cache still are what was written; damaged ones are moved aside.

A disk that was full, a machine that was killed or a flipped bit leave entries that can be read and
are wrong. So each has its checksum, beside it or in it, and is held against it before it is used.
"""

import hashlib
import json
import os
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401  its import registers the codecs of recordings with h5py

from ssac.cli.progress import say
from ssac.errors import SsacError
from ssac.files.whole_file import whole_file

SUMS_SUFFIX = ".sha256"
ASIDE = "damaged"
"""Folder of the cache that damaged entries are moved to, for who wants to know what happened."""


def save_sums(folder: Path) -> None:
    """Note the checksums of a folder's files beside it."""
    lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(_sums(folder).items()))
    with whole_file(_beside(folder)) as temporary:
        temporary.write_text(lines, encoding="utf-8")


def is_sound(folder: Path, names: Collection[str] | None = None) -> bool:
    """Whether a folder's files, or those of some names, are those that were written.

    One without checksums, of an older version or of a run that was killed just then, is sound when
    all of it can be read; then it is given some.
    """
    beside = _beside(folder)
    try:
        lines = beside.read_bytes().decode("utf-8", "replace").splitlines()
    except FileNotFoundError:
        if not all(_can_be_read(path) for path in folder.iterdir()):
            return False
        with suppress(OSError, SsacError):  # a cache that is not ours to write to
            save_sums(folder)
        return True
    noted = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    if names is not None:
        noted = {name: digest for name, digest in noted.items() if name in names}
    return noted == _sums(folder, names)


def set_aside(path: Path, cache: Path) -> None:
    """Move a damaged entry of the cache, and its checksums, to where it is not used, and say so."""
    unique = os.urandom(4).hex()
    for one in (path, _beside(path)):
        if not one.exists():
            continue
        aside = cache / ASIDE / f"{one.stem}.{unique}{one.suffix}"
        try:
            aside.parent.mkdir(parents=True, exist_ok=True)
            one.rename(aside)
        except FileNotFoundError:  # another process was faster
            continue
        except OSError as error:
            raise SsacError(
                f"{one}: is damaged and cannot be moved aside ({error.strerror}): delete it"
            ) from error
        if one == path:
            say(f"{path} was damaged: moved to {aside}, and made again")


def text_of_row(row: dict[str, Any]) -> str:
    """Give the text of an entry that holds one measured row."""
    return json.dumps({"row": row, "sha256": _digest_of_row(row)})


def row_of_text(text: bytes) -> dict[str, Any] | None:
    """Read a row; None when the text is damaged."""
    try:
        entry = json.loads(text.decode("utf-8"))
        row: dict[str, Any] = entry["row"]
        return row if entry["sha256"] == _digest_of_row(row) else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _digest_of_row(row: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()


def _beside(folder: Path) -> Path:
    return folder.with_name(folder.name + SUMS_SUFFIX)


def _sums(folder: Path, names: Collection[str] | None = None) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if path.is_file() and (names is None or path.name in names)
    }


def _can_be_read(path: Path) -> bool:
    """Read all of an HDF5 file; others are small, and whoever uses them complains."""
    if path.suffix != ".h5":
        return path.stat().st_size > 0
    try:
        with h5py.File(path, "r") as file:
            file.visititems(_read)
    except Exception:  # h5py raises many
        return False
    return True


def _read(_: str, item: Any) -> None:
    if isinstance(item, h5py.Dataset):
        for _block in item.iter_chunks() if item.chunks else ((),):
            item[_block]
