"""Exit codes, and errors of commands as one line on stderr, never a traceback.

On a terminal the line is folded. The modules imported here need only the standard library, so that
`guarded` also covers the imports of everything else.
"""

import io
import os
import platform
import shlex
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from ssac.errors import PluginError, SsacError
from ssac.files.whole_file import write_whole
from ssac.screen import columns, folded

DONE = 0
NO_ESTIMATE = 1  # of `ssac verify`: something differs; never a crash
BAD_INPUT = 2  # wrong usage, or a file that cannot be read or written
BUG = 3  # a mistake of ours, or of a package whose method was run
INTERRUPTED = 128 + 2  # Ctrl-C, as shells count it: 128 and the signal's number
TERMINATED = 128 + 15  # SIGTERM, which `kill`, `timeout` and job schedulers send
ENDED = {INTERRUPTED: "interrupted", TERMINATED: "terminated"}
PIPE_CLOSED = 128 + 13  # the reader of our output stopped reading, as `head` does

NO_KERNELS = (
    "compiled code can be kept nowhere: the package's folder and your home cannot be written; set"
    " NUMBA_CACHE_DIR to a folder of yours"
)


def guarded(run: Callable[[], int], blames_input: tuple[type[Exception], ...] = ()) -> int:
    """Run a command, and turn whatever it raises into one line and an exit code.

    `blames_input` are further error types that, like SsacError and OSError, blame the input.
    """
    if sys.stderr is None:  # closed by the parent process: errors are no results
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    faults_of_input: tuple[type[Exception], ...] = (SsacError, OSError, *blames_input)
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr: names may be no UTF-8
    try:
        with _signals_as_exceptions():
            code = run()
        if sys.stdout is not None:  # None: closed by the parent process, as some services do
            sys.stdout.flush()
    except (KeyboardInterrupt, SystemExit) as ended:
        return _ended(ended)
    except BrokenPipeError:
        _let_go(sys.stdout)
        return PIPE_CLOSED
    except faults_of_input as error:
        return fail(str(error), BAD_INPUT)
    except Exception as error:
        if "no locator available" in str(error):  # Numba's words
            return fail(NO_KERNELS, BAD_INPUT)
        raised = _signal_within(error)
        return fail(_bug_line(error), BUG) if raised is None else _ended(raised)
    return _ended(KeyboardInterrupt()) if code == INTERRUPTED else code


def _ended(raised: BaseException) -> int:
    """Say which signal has ended the command; return the code."""
    code = raised.code if isinstance(raised, SystemExit) else INTERRUPTED
    if code not in ENDED:
        raise raised from None
    print(ENDED[code], file=sys.stderr)
    return code


def fail(message: str, code: int) -> int:
    """Print an error as one line on stderr; return the code."""
    _say("error", message)
    return code


def _say(kind: str, message: object) -> None:
    """Print a message as one line on stderr, folded if stderr is a terminal."""
    line = f"{kind}: {' '.join(str(message).split())}"
    width = columns(sys.stderr, sys.maxsize)
    try:
        print("\n".join(folded(line, width, len(kind) + 2)), file=sys.stderr, flush=True)
    except BrokenPipeError:  # the exit code says the same
        _let_go(sys.stderr)


def _let_go(stream: TextIO) -> None:
    """Write to nowhere, as the reader has gone: Python flushes once more when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Show each warning as one line on stderr."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: _say("warning", message)
        yield


@contextmanager
def _signals_as_exceptions() -> Iterator[None]:
    """Raise an exception in the block on Ctrl-C and SIGTERM, unless these have other handlers."""
    raised: list[BaseException] = []

    def end(number: int, _: object) -> None:
        if number == signal.SIGTERM:
            raised.append(SystemExit(TERMINATED))
        elif number == signal.SIGINT:
            raised.append(KeyboardInterrupt())
        # Repeated every 3 s, as imports and finalisers swallow some; in between, temporary files
        # can be removed.
        if can_insist:
            signal.setitimer(signal.ITIMER_REAL, 3.0)
        raise raised[-1]

    def unraisable(args: "sys.UnraisableHookArgs") -> None:
        if args.exc_value not in raised:  # a finaliser cannot be ended; the next try will do
            hook(args)

    defaults = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    can_insist = hasattr(signal, "setitimer")  # not on every system
    numbers = [
        number for number, default in defaults.items() if signal.getsignal(number) is default
    ]
    if can_insist and numbers:
        numbers.append(signal.SIGALRM)
    before = {number: signal.signal(number, end) for number in numbers}
    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    try:
        yield
    finally:
        if signal.SIGALRM in before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook


def _signal_within(error: BaseException) -> BaseException | None:
    """Return what a signal raised amid compiled code, which makes a SystemError of it."""
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    return cause if isinstance(cause, KeyboardInterrupt | SystemExit) else None


def _bug_line(error: Exception) -> str:
    """Write the traceback to a new file; return a line with the error and the file's path."""
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    lines = [
        f"command: {shlex.join(sys.argv)}\n",
        f"python: {platform.python_version()} on {platform.platform()}\n\n",
        *traceback.format_exception(error),
    ]
    try:
        path = Path(tempfile.mkdtemp(prefix="ssac-bug-")) / "traceback.txt"
        write_whole(path, "".join(lines))
    except (OSError, UnicodeError, SsacError) as unwritten:
        where = f"the traceback could not be written ({unwritten}): {' '.join(lines)}"
    else:
        where = f"please report it with the traceback in {path}"
    if isinstance(error, PluginError):  # its message names the package
        return f"{error}; {where}"
    return f"a bug in this program, {what}; {where}"
