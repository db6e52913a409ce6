"""Commands of other distributions, found by their entry points."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType

import typer

from raystream.cli.console import BadInputError

#: The group of entry points: ``NAME = "module:function"`` adds ``raystream NAME``.
GROUP = "raystream.commands"

#: Commands of our own distributions: what they do, and how to install them.
_KNOWN = MappingProxyType(
    {
        "lab": (
            "Re-run the experiments of four papers (needs raystream-lab).",
            "pip install ./lab, in a copy of raystream's repository",
        ),
    }
)

#: A command that takes any arguments.
_ANY = {"allow_extra_args": True, "ignore_unknown_options": True}


def add_commands(app: typer.Typer, found: Iterable[EntryPoint] | None = None) -> None:
    """Add the commands that other distributions declare, and say how to install what is not there.

    Parameters
    ----------
    app : typer.Typer
    found : iterable of EntryPoint, optional
        Default: those of `GROUP` that are installed.
    """
    missing = dict(_KNOWN)
    for one in entry_points(group=GROUP) if found is None else found:
        try:
            command = one.load()
        except ImportError as error:
            _add_missing(app, one.name, f"Not available: {error}", f"reinstall it: {error}")
        else:
            app.command(one.name)(command)
        missing.pop(one.name, None)
    for name, (help_text, remedy) in missing.items():
        _add_missing(app, name, help_text, f"is not installed: {remedy}")


def _add_missing(app: typer.Typer, name: str, help_text: str, complaint: str) -> None:
    @app.command(name, context_settings=dict(_ANY), help=help_text)
    def refuse() -> None:
        raise BadInputError(f"{name}: {complaint}")
