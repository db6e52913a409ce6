"""The command line: parses arguments, calls the library, prints figures."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NoReturn

import typer

from raystream._version import __version__
from raystream.cli import options
from raystream.cli.bench import bench
from raystream.cli.compare import compare
from raystream.cli.console import (
    InterruptedRunError,
    one_line,
    open_streams,
    show_warnings,
    silence_stdout,
    write_note,
)
from raystream.cli.export import export
from raystream.cli.info import info
from raystream.cli.interrupts import end_quietly, keep_interrupts
from raystream.cli.plugins import add_commands
from raystream.cli.query import query
from raystream.cli.render import render
from raystream.cli.view import view
from raystream.cli.warm import warm
from raystream.core.errors import RaystreamError

__all__ = ["app", "main"]

#: Exit codes: 1 is left to a bug, which shows its traceback.
BAD_INPUT = 2
INTERRUPTED = 130

#: What typer raises for arguments that it cannot use; where the class lives differs between
#: versions of typer, and this one is its child in all of them.
UsageError: type[Exception] = typer.BadParameter.mro()[1]

app = typer.Typer(
    help="Trace rays against triangles, and render images.",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    rich_markup_mode=None,  # help is plain text: Rich reads ":100:" and "[more]" as its own codes
)
app.command()(render)
app.command()(info)
app.command()(query)
app.command()(compare)
app.command()(bench)
app.command()(view)
app.command()(export)
app.command()(warm)
add_commands(app)


@dataclass
class _GlobalSettings:
    """Options given before the command name."""

    debug: bool


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"raystream {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def before_command(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001 - its callback does it
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
    debug: Annotated[
        bool,
        options.flag("--debug", "Show tracebacks for bad input too, as RAYSTREAM_DEBUG=1 does."),
    ] = False,
) -> None:
    """Trace rays against triangles, and render images."""
    context.obj.debug = context.obj.debug or debug
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, and exit.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: the arguments of the process.

    Raises
    ------
    SystemExit
        Always: with 0, with 2 after bad input (one line on stderr), with 130 after Ctrl-C,
        or with 1 when stdout has been closed. A bug shows as any other exception.
    """
    settings = _GlobalSettings(debug=os.environ.get("RAYSTREAM_DEBUG", "") not in ("", "0"))
    command = typer.main.get_command(app)
    given = None if arguments is None else list(arguments)
    open_streams()
    try:
        with show_warnings(), keep_interrupts():
            code = command.main(given, "raystream", standalone_mode=False, obj=settings)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except InterruptedRunError as error:
        write_note(f"interrupted; {error}")
        end_quietly()
        sys.exit(INTERRUPTED)
    except (RaystreamError, MemoryError, UsageError) as error:
        if settings.debug:
            traceback.print_exc()
        print(f"raystream: {_message(error)}", file=sys.stderr)  # noqa: T201
        sys.exit(BAD_INPUT)
    except BrokenPipeError:
        silence_stdout()
        sys.exit(1)
    if code == INTERRUPTED:  # typer turns a KeyboardInterrupt into this code
        print("interrupted", file=sys.stderr)  # noqa: T201
        end_quietly()
    sys.exit(code if isinstance(code, int) else 0)


def _message(error: Exception) -> str:
    """Format an error as one line."""
    if isinstance(error, UsageError):
        text = one_line(error.format_message()).rstrip(".")  # type: ignore[attr-defined]
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "raystream"
        return f"{text[:1].lower()}{text[1:]} (see {command} --help)"
    if isinstance(error, MemoryError):
        return f"out of memory: {one_line(str(error))}" if str(error) else "out of memory"
    return one_line(str(error))
