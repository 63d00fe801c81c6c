"""The provenance of a result: code, versions, processor, GL backend and configuration."""

import json
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from experiments.lab.code import ROOT, package_versions
from experiments.lab.results import PROVENANCE, File
from sim.render.gl_context import GLContext

_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "pyrender", "PyOpenGL", "trimesh",
             "pandas", "matplotlib", "pillow")  # fmt: skip


def plain(value: Any) -> Any:
    """Convert nested dataclasses, tuples and paths to JSON types.

    Parts whose `is_none` is true, and fields with `later` in their metadata that have their default
    value, are left out: a new feature changes no provenance of a result that does not use it.
    """
    if is_dataclass(value) and not isinstance(value, type):
        parts = ((one, getattr(value, one.name)) for one in fields(value))
        return {
            one.name: plain(part)
            for one, part in parts
            if not ("later" in one.metadata and part == one.default)
            and not getattr(part, "is_none", False)
        }
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def code_commit() -> str:
    """Name the code's commit, `-dirty` when any file but results differs; "unknown" outside git."""
    top, head = ["rev-parse", "--show-toplevel"], ["rev-parse", "--short=12", "HEAD"]
    status = ["status", "--porcelain", "--untracked-files=no", "--", ".", ":!results"]
    try:
        folder, commit, changed = (
            subprocess.run(
                ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
            ).stdout.strip()
            for arguments in (top, head, status)
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    if Path(folder).resolve() != ROOT:  # of a project in whose environment this one is installed
        return "unknown"
    return f"{commit}-dirty" if changed else commit


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that numbers depend on."""
    return {"python": platform.python_version(), **package_versions(_PACKAGES)}


def processor() -> str:
    """Return LLVM's name of the processor, on which the last digits of results depend."""
    return str(get_host_cpu_name())


def provenance(
    command: str, config: Any, wall_time_s: float, gl: GLContext | None, **more: Any
) -> dict[str, Any]:
    """Return the provenance of a result; `gl` is the OpenGL context, None where there is none."""
    return {
        "command": command,
        "commit": code_commit(),
        "versions": versions(),
        "processor": processor(),
        "gl": plain(gl) if gl else None,
        "config": plain(config),
        "wall_time_s": round(wall_time_s, 1),
        **plain(more),
    }


def provenance_file(of: str, content: Mapping[str, Any]) -> File:
    """Return a finished provenance as the file beside a table, or of pictures by a name of all."""
    text = json.dumps(plain(content), indent=1) + "\n"
    return f"{of.removesuffix('.csv')}{PROVENANCE}", text.encode()
