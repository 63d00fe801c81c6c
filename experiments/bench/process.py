"""A module and its arguments in; what it prints as JSON, run alone on one core, out."""

import json
import os
import subprocess
import sys
from typing import Any

from ssac.errors import SsacError

_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def in_own_process(module: str, *arguments: str) -> Any:
    """Run a module on one core in a new process, so that none sees another's memory.

    Raises
    ------
    SsacError
        With the last line that it wrote to stderr, when it fails.
    """
    environment = {**os.environ, **_ONE_CORE}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-m", module, *arguments]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        last = result.stderr.strip().splitlines()[-1:] or [f"exit code {result.returncode}"]
        raise SsacError(last[0])
    return json.loads(result.stdout)
