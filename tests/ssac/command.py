"""Runs command lines of `python -m ssac.cli` within the test's process."""

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple
from unittest.mock import patch

import pytest

from ssac.cli.__main__ import main
from ssac.screen import columns


class Run(NamedTuple):
    exit_code: int
    stdout: str
    stderr: str


def run(*args, code=0):
    """Run a command line, which must end with a code, as on a screen that is wide enough."""
    out, err = io.StringIO(), io.StringIO()
    wide = patch.object(columns, "__defaults__", (sys.maxsize,))
    with redirect_stdout(out), redirect_stderr(err), wide:
        ended = Run(main([*map(str, args)]), out.getvalue(), err.getvalue())
    assert code in (None, ended.exit_code), ended.stderr
    return ended


def read_json(path):
    return json.loads(path.read_text(), parse_constant=pytest.fail)  # NaN is not JSON
