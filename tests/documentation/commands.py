"""Commands that pages show: whether their options, extras and files exist."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import typer

from raystream.cli import app

REPOSITORY = Path(__file__).resolve().parents[2]


def commands_of(text: str) -> Iterator[tuple[str, str]]:
    r"""Yield each command after ``$``, with ``\`` at the end of a line, and its output."""
    lines = text.splitlines()
    at = 0
    while at < len(lines):
        if not lines[at].startswith("$ "):
            raise AssertionError(f"expected a command after '$ ', got {lines[at]!r}")
        command = lines[at][2:]
        while command.endswith("\\") and at + 1 < len(lines):
            at += 1
            command = command[:-1] + lines[at].strip()
        at += 1
        printed = []
        while at < len(lines) and not lines[at].startswith("$ "):
            printed.append(lines[at])
            at += 1
        yield command, "\n".join(printed).strip()


def check(command: str) -> None:
    """Raise if a command names options, extras or files that do not exist."""
    for one in command.split(" && "):
        words = shlex.split(one, comments=True)
        while words and re.match(r"^[A-Z_]+=", words[0]):  # variables before a command
            words = words[1:]
        name = Path(words[0]).name
        if name == "raystream":
            _check_raystream(words[1:])
        elif name in ("pip", "pip3"):
            _check_extras(words[1:])
        elif name in ("python", "python3"):
            _check_python(words[1:])
        elif name not in _OTHERS:
            raise AssertionError(f"{name}: an unknown command; give it the comment 'not run'")


#: Commands of systems and tools, which are not checked.
_OTHERS = {"apt", "cd", "export", "jupyter", "source", "ssh"}


def _check_raystream(words: list[str]) -> None:
    group = typer.main.get_command(app)
    if words and words[0] in group.commands:  # type: ignore[attr-defined]
        command = group.commands[words[0]]  # type: ignore[attr-defined]
        command.make_context(words[0], list(words[1:]))
    else:
        raise AssertionError(f"raystream has no command {words[:1]}")


def _check_extras(words: list[str]) -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    known = project["project"]["optional-dependencies"]
    for word in words:
        if match := re.match(r"^(?:raystream|\.)\[(.+)\]$", word):
            missing = set(match[1].split(",")) - set(known)
            assert not missing, f"pyproject.toml has no extra {sorted(missing)}"


def _check_python(words: list[str]) -> None:
    if words[0] == "-m":
        assert words[1] in {"venv", "sphinx", "pytest", "http.server", "pip"}, words[1]
        return
    assert (REPOSITORY / words[0]).is_file(), f"{words[0]} does not exist"
