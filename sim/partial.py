"""A folder's name in; one beside it out, under which the folder is written until it is whole.

    .NAME.HOST.PROCESS.RANDOM.partial

No process of any host gives a name twice, though hosts that share a disk have equal process ids.
Whoever tidies up later can tell what a killed process left from what another is just writing.
"""

import os
import platform
import re
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path

_NAME_LENGTH = 32  # of 255 bytes that a file's name may have, four for each of these letters


def partial_path(parent: Path, name: str) -> Path:
    """Give a path in `parent` to write what will be called `name`; another one at each call."""
    unique = f"{_host()}.{os.getpid()}.{os.urandom(16).hex()}"
    return parent / f".{name[:_NAME_LENGTH]}.{unique}.partial"


@cache
def _host() -> str:
    """Name the place in which a process id has one meaning: a machine, since it was started.

    A container counts as a machine of its own.
    """
    node = platform.node()
    place = [node]
    with suppress(OSError):  # not Linux
        place.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        place.append(os.readlink("/proc/self/ns/pid"))
    name = re.sub(r"[^A-Za-z0-9-]", "-", node)[:20]
    return f"{name}-{sha256(repr(place).encode()).hexdigest()[:8]}"
