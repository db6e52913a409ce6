"""What the command line says: figures on stdout, warnings and refusals on stderr."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

from raystream.core.errors import RaystreamError, RaystreamWarning

__all__ = [
    "BadInputError",
    "BrokenOffError",
    "mute",
    "one_line",
    "open_streams",
    "refuse",
    "show_warnings",
    "silence_stdout",
    "write_json",
    "write_line",
    "write_note",
]


class BadInputError(RaystreamError):
    """Something that the user can put right: one line, without a traceback."""


class BrokenOffError(RaystreamError):
    """Ctrl-C, where there is something to say about it: one line, and the exit code of Ctrl-C."""


@contextlib.contextmanager
def refuse(*kinds: type[Exception], where: str = "") -> Iterator[None]:
    """Turn these exceptions into `BadInputError`.

    Only for calls whose documented errors of these kinds blame an argument: anywhere else
    they are bugs, and must show as such.

    Parameters
    ----------
    *kinds
        Exceptions to turn.
    where : str, optional
        The file or option at fault, when the message does not say.
    """
    try:
        yield
    except kinds as error:
        reason = str(error)
        if isinstance(error, OSError) and error.strerror:
            reason = error.strerror
        raise BadInputError(f"{where}: {reason}" if where else reason) from error


def one_line(text: str) -> str:
    """Put text from anywhere on one line, without control characters for the terminal."""
    words = " ".join(text.split())
    return "".join(letter if letter.isprintable() else "?" for letter in words)


@contextlib.contextmanager
def show_warnings() -> Iterator[None]:
    """Print each `RaystreamWarning` as one line on stderr; leave other warnings alone."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RaystreamWarning)
        show_others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
            if issubclass(category, RaystreamWarning):
                print(f"warning: {one_line(str(message))}", file=sys.stderr)  # noqa: T201
            else:
                show_others(message, category, *place)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


def write_line(text: str = "") -> None:
    """Print on stdout, at once.

    Raises
    ------
    BadInputError
        If stdout is a file on a full disk, say.
    BrokenPipeError
        If nobody reads it any more.
    """
    try:
        print(text, flush=True)  # noqa: T201
    except BrokenPipeError:
        raise
    except UnicodeEncodeError:
        print(text.encode("ascii", "backslashreplace").decode(), flush=True)  # noqa: T201
    except OSError as error:
        silence_stdout()
        raise BadInputError(f"stdout: {error.strerror}") from error


def write_note(text: str) -> None:
    """Print a line on stderr, for people."""
    print(one_line(text), file=sys.stderr, flush=True)  # noqa: T201


def write_json(figures: Mapping[str, Any]) -> None:
    """Print figures on stdout as JSON."""
    text = json.dumps(figures, indent=2, allow_nan=False)
    # Vectors on one line. Strings are safe: their line breaks are escaped.
    text = re.sub(r"\[\n[\s\d.,e+-]+\]", _on_one_line, text)
    write_line(text)


def _on_one_line(numbers: re.Match[str]) -> str:
    return "".join(numbers[0].split()).replace(",", ", ")


def open_streams() -> None:
    """Give a process that was started without stdout or stderr somewhere to write."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def silence_stdout() -> None:
    """Let what is still buffered for stdout go nowhere, so that exiting does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


@contextlib.contextmanager
def mute() -> Iterator[None]:
    """Drop what libraries of others print while the block runs, in Python or in C.

    For those that print what their exceptions say again.
    """
    kept = nowhere = None
    try:
        with contextlib.suppress(OSError):  # there may be no stderr
            kept = os.dup(2)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 2)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        if kept is not None:
            os.dup2(kept, 2)
        for handle in (kept, nowhere):
            if handle is not None:
                os.close(handle)
