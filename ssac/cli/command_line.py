"""The command line, and the table of commands that need recordings but no simulator.

A command is imported when it is called: `ssac --help` and shell completion import none of them.
"""

import atexit
import difflib
import gc
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from ssac.cli.exits import BAD_INPUT, PIPE_CLOSED, fail

Sections = Mapping[str, Sequence[tuple[str, str]]]
"""For each heading, a list of names, each with a line of text."""


@dataclass(frozen=True)
class Entry:
    """One command, not yet imported; its module may have `help_sections() -> Sections`."""

    name: str
    group: str  # heading under which it is listed
    summary: str  # one line of the list of commands
    module: str
    function: str


USE = "Use"  # heading of commands for one's own recordings; other commands reproduce results

COMMANDS = tuple(
    Entry(name, USE, summary, f"ssac.cli.{module}", f"{name}_command")
    for name, module, summary in (
        ("sync", "sync", "Find time offset and pose of two or more cameras."),
        ("track", "paths", "Extract the object's image track from a camera's events."),
        ("import", "paths", "Convert a public data set to track files and a rig."),
        ("compare", "paths", "Compare an estimated path in space with a reference."),
    )
)
SYNC, TRACK, IMPORT, COMPARE = COMMANDS


def command_line(entries: Sequence[Entry], description: str) -> typer.Typer:
    """Make the command line of a table of commands."""
    table = {entry.name: entry for entry in entries}

    class Commands(_LazyGroup):
        """The group of these commands."""

        entries = table

    app = typer.Typer(
        cls=Commands,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
        help=description,
    )
    app.callback()(_options_of_all)
    return app


def run(app: typer.Typer, args: Sequence[str], program: str) -> int:
    """Run a command line; return its exit code, wrong usage being one line on stderr."""
    # BLAS starts no threads at its import, as sums depend on the number of threads. Imports make
    # 230,000 objects, those for figures 350,000. To search them for garbage takes 0.13 s, which
    # Python would do several times at its end, when all memory is freed anyway.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(400_000)
    atexit.register(gc.freeze)
    try:
        return get_command(app).main(list(args), program, standalone_mode=False) or 0
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = [arg for arg in args[:1] if not arg.startswith("-")]
        path = context.command_path if context is not None else " ".join([program, *command])
        return fail(f"{error.format_message().rstrip('.')}; see {path} --help", BAD_INPUT)
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # Typer's own exit code is 1
            return PIPE_CLOSED
        raise


# The contexts and formatters that Typer hands to these methods are of classes it does not export.


class _LazyGroup(TyperGroup):
    """A group of commands that lists names and summaries, and imports only the command called."""

    entries: ClassVar[Mapping[str, Entry]] = {}

    def list_commands(self, ctx: Any) -> list[str]:
        """Keep the order of the table."""
        return list(self.entries)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
        """Import a command by its name; if there is none, fail and suggest similar names."""
        entry = self.entries.get(cmd_name)
        if entry is not None:
            module = import_module(entry.module)
            app = typer.Typer(
                add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
            )
            app.command(entry.name, cls=_ListingCommand)(getattr(module, entry.function))
            command = get_command(app)
            assert isinstance(command, _ListingCommand)  # the class given above
            command.sections = getattr(module, "help_sections", dict)
            return command
        if not (ctx.resilient_parsing or cmd_name.startswith("-")):
            close = difflib.get_close_matches(cmd_name, self.entries)
            meant = f": did you mean {' or '.join(close)}?" if close else ""
            ctx.fail(f"there is no command {cmd_name!r}{meant}")
        return None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands under their headings, with whole summaries."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for entry in self.entries.values():
            sections.setdefault(entry.group, []).append((entry.name, entry.summary))
        _write(sections, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Complete a command's name without importing a command."""
        from typer.core import CompletionItem  # type: ignore[attr-defined]

        options = TyperCommand.shell_complete(self, ctx, incomplete)
        return options + [
            CompletionItem(entry.name, help=entry.summary)
            for entry in self.entries.values()
            if entry.name.startswith(incomplete)
        ]


class _ListingCommand(TyperCommand):
    """A command whose help shows arguments as the user types them, and ends with `sections`."""

    sections: Callable[[], Sections] = dict

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Show a required argument without braces."""
        pieces = super().collect_usage_pieces(ctx)
        return [piece.replace("{", "").replace("}", "") for piece in pieces]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments without their Python types, then options."""
        rows: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx)
            if record is not None and param.param_type_name == "argument":
                rows["Arguments"].append((record[0].partition(" <")[0], record[1]))
            elif record is not None:
                rows["Options"].append(record)
        _write({heading: some for heading, some in rows.items() if some}, formatter)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the lists that end the help."""
        _write(self.sections(), formatter)


def _write(sections: Sections, formatter: Any) -> None:
    for heading, rows in sections.items():
        with formatter.section(heading):
            formatter.write_dl(rows)


def _show_version(asked: bool) -> None:
    if asked:
        try:
            number = version("ssac-suite")
        except PackageNotFoundError:
            number = "of an unknown version: the package is not installed"
        typer.echo(f"ssac {number}")
        raise typer.Exit


def _options_of_all(
    context: typer.Context,
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(BAD_INPUT)
