"""A command line of `python -m ssac.cli`, run within the test."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ssac.cli.__main__ import main


class Run(NamedTuple):
    """What a command line gave."""

    exit_code: int
    stdout: str
    stderr: str


def run(*args: object) -> Run:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([*map(str, args)])
    return Run(code, unfolded(out.getvalue()), unfolded(err.getvalue()))


def unfolded(text: str) -> str:
    """Join the lines of rows that were too long for a screen of 100 columns."""
    rows, before = list[str](), ""
    for line in text.splitlines():
        word = line.split(maxsplit=1)[:1]
        if word and line.startswith(6 * " ") and len(f"{before} {word[0]}") > 100:
            rows[-1] += f" {line.strip()}"
        else:
            rows.append(line)
        before = line
    return "".join(f"{row}\n" for row in rows)


run_sync = partial(run, "sync")


def read_json(path: Path) -> Any:
    def refuse(constant: str) -> None:
        raise ValueError(f"{constant} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)
