"""`Tracer` options on the command line: ``KEY=VALUE``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from raystream.cli import options
from raystream.cli.console import BadInputError
from raystream.core.errors import RaystreamError

__all__ = ["blame_options", "machine_figures", "parse_keywords", "tracer_options"]

#: `Tracer` options that have a command-line option of the same name.
FLAGS = ("structure", "device", "adapter", "gpu", "traversal", "machine", "scheduler")


def parse_keywords(where: str, words: Sequence[str]) -> dict[str, Any]:
    """Parse ``key=value`` pairs; a value is a number, a list, true, false or null, else text.

    Raises
    ------
    BadInputError
        If a word is not such a pair, or its key cannot be set on the command line.
    """
    parsed: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.strip().partition("=")
        if not equals or not key.isidentifier():
            raise BadInputError(f"{where}: expected KEY=VALUE, got {word!r}")
        if key in ("scene", "progress"):
            raise BadInputError(f"{where}: {key} cannot be set")
        try:
            parsed[key] = json.loads(value)
        except (ValueError, RecursionError):
            parsed[key] = value
    return parsed


def tracer_options(words: Sequence[str], device: str, **named: str | int | None) -> dict[str, Any]:
    """Collect `Tracer` options from ``--option`` and the named command-line options.

    Parameters
    ----------
    words : sequence of str
        Values of ``--option``.
    device : str
        Value of ``--device``.
    **named
        ``adapter``, ``gpu``, ``traversal``, ``machine``, ``scheduler``: the value of the option
        of that name, or None.

    Raises
    ------
    BadInputError
        If they contradict each other, or a key has an option of its own.
    """
    parsed = parse_keywords("--option", words)
    for key in ("structure", "device"):
        if key in parsed:
            raise BadInputError(f"--option: pass {key} with --{key}")
    for key, value in named.items():
        if value is not None and parsed.setdefault(key, value) != value:
            raise BadInputError(f"--option: {key} differs from --{key}")
    if named.get("scheduler") is not None and parsed.get("machine") != "multipass":
        raise BadInputError("--scheduler: only with --machine multipass")
    if named.get("adapter") is not None and device != "graphics":
        raise BadInputError("--adapter: only with --device graphics")
    if named.get("gpu") is not None and device != "cuda":
        raise BadInputError("--gpu: only with --device cuda")
    return parsed


@contextlib.contextmanager
def blame_options(chosen: Mapping[str, Any]) -> Iterator[None]:
    """Turn a tracer's errors about its options into `BadInputError`.

    Parameters
    ----------
    chosen : mapping
        `Tracer` options; if empty, errors are bugs and pass through unchanged.
    """
    try:
        yield
    except RaystreamError:
        raise
    except (ValueError, TypeError) as error:
        if not chosen:
            raise
        name = str(error).partition(":")[0]
        raise BadInputError(f"--{error}" if name in FLAGS else f"--option: {error}") from error


def machine_figures(chosen: Mapping[str, Any], device: str) -> dict[str, Any]:
    """Describe the execution for ``--json``: ``device``, ``machine``, multipass ``scheduler``.

    Parameters
    ----------
    chosen : mapping
        `Tracer` options.
    device : str
    """
    machine = chosen.get("machine", options.DEFAULT_MACHINES[device])
    figures = {"machine": machine, "device": device}
    if machine == "multipass":
        figures["scheduler"] = chosen.get("scheduler", options.SCHEDULERS[0])
    return figures
