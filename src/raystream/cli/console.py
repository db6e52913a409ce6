"""Console output: figures on stdout, warnings and errors on stderr."""

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


class BadInputError(RaystreamError):
    """An error that the user can fix: one line, without a traceback."""


class InterruptedRunError(RaystreamError):
    """Ctrl-C with a message: one line, and the exit code of Ctrl-C."""


@contextlib.contextmanager
def refuse(*kinds: type[Exception], where: str = "") -> Iterator[None]:
    """Turn these exceptions into `BadInputError`.

    Use it only around calls whose documented errors of these kinds blame an argument:
    elsewhere they are bugs, and must show as such.

    Parameters
    ----------
    *kinds
        Exceptions to convert.
    where : str, optional
        The file or option at fault, if the message does not name it.
    """
    try:
        yield
    except kinds as error:
        reason = str(error)
        if isinstance(error, OSError) and error.strerror:
            reason = error.strerror
        raise BadInputError(f"{where}: {reason}" if where else reason) from error


def one_line(text: str) -> str:
    """Collapse text to one line, without control characters for the terminal."""
    words = " ".join(text.split())
    return "".join(letter if letter.isprintable() else "?" for letter in words)


@contextlib.contextmanager
def show_warnings() -> Iterator[None]:
    """Print each `RaystreamWarning` as one line on stderr, once; leave other warnings alone."""
    shown: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", RaystreamWarning)
        show_others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
            if issubclass(category, RaystreamWarning):
                text = one_line(str(message))
                if text not in shown:
                    print(f"warning: {text}", file=sys.stderr)  # noqa: T201
                    shown.add(text)
            else:
                show_others(message, category, *place)

        warnings.showwarning = show  # type: ignore[assignment]
        yield


def write_line(text: str = "") -> None:
    """Print a line on stdout and flush.

    Raises
    ------
    BadInputError
        If stdout cannot be written, for example to a full disk.
    BrokenPipeError
        If the reader has closed stdout.
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


def write_bytes(content: bytes) -> None:
    """Write to stdout and flush; raises as `write_line`."""
    try:
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        silence_stdout()
        raise BadInputError(f"stdout: {error.strerror}") from error


def write_note(text: str) -> None:
    """Print a line on stderr."""
    print(one_line(text), file=sys.stderr, flush=True)  # noqa: T201


def write_json(figures: Mapping[str, Any]) -> None:
    """Print figures on stdout as JSON."""
    text = json.dumps(figures, indent=2, allow_nan=False)
    # Put vectors on one line. Strings are safe: their line breaks are escaped.
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
    """Redirect stdout's buffered output to the null device, so that exiting does not fail."""
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, sys.stdout.fileno())
    os.close(null_device)


@contextlib.contextmanager
def mute() -> Iterator[None]:
    """Suppress everything that other libraries print during the block, in Python or in C.

    For libraries that also print what their exceptions say.
    """
    saved_stderr = null_device = None
    try:
        with contextlib.suppress(OSError):  # there may be no stderr
            saved_stderr = os.dup(2)
            null_device = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null_device, 2)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        if saved_stderr is not None:
            os.dup2(saved_stderr, 2)
        for handle in (saved_stderr, null_device):
            if handle is not None:
                os.close(handle)
