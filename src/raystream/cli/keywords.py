"""Options of `Tracer` on the command line: ``KEY=VALUE``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from raystream.cli import options
from raystream.cli.messages import BadInputError
from raystream.core.errors import RaystreamError

__all__ = ["blame_options", "machine_figures", "parse_keywords", "tracer_options"]

#: Options of `Tracer` that the command line has by their names.
FLAGS = ("structure", "device", "adapter", "gpu", "traversal", "machine", "scheduler")


def parse_keywords(where: str, words: Sequence[str]) -> dict[str, Any]:
    """Read ``key=value``; a value is a number, a list, true, false or null, else text.

    Raises
    ------
    BadInputError
        If a word is none, or its key is not for the command line.
    """
    parsed: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.strip().partition("=")
        if not equals or not key.isidentifier():
            raise BadInputError(f"{where}: expected KEY=VALUE, got {word!r}")
        if key in ("scene", "progress"):
            raise BadInputError(f"{where}: {key} cannot be chosen")
        try:
            parsed[key] = json.loads(value)
        except (ValueError, RecursionError):
            parsed[key] = value
    return parsed


def tracer_options(words: Sequence[str], device: str, **named: str | int | None) -> dict[str, Any]:
    """Options of `Tracer` from ``--option``, and from options of the command line.

    Parameters
    ----------
    words : sequence of str
        What ``--option`` was given.
    device : str
        What ``--device`` was given.
    **named
        ``adapter``, ``gpu``, ``traversal``, ``machine``, ``scheduler``: what the option of that
        name was given, or None.

    Raises
    ------
    BadInputError
        If they contradict each other, or have options of their own.
    """
    parsed = parse_keywords("--option", words)
    for key in ("structure", "device"):
        if key in parsed:
            raise BadInputError(f"--option: give {key} as --{key}")
    for key, value in named.items():
        if value is not None and parsed.setdefault(key, value) != value:
            raise BadInputError(f"--option: another {key} than --{key}")
    if named.get("scheduler") is not None and parsed.get("machine") != "multipass":
        raise BadInputError("--scheduler: only with --machine multipass")
    if named.get("adapter") is not None and device != "graphics":
        raise BadInputError("--adapter: only with --device graphics")
    if named.get("gpu") is not None and device != "cuda":
        raise BadInputError("--gpu: only with --device cuda")
    return parsed


@contextlib.contextmanager
def blame_options(chosen: Mapping[str, Any]) -> Iterator[None]:
    """Turn a tracer's complaints about its options into `BadInputError`.

    Parameters
    ----------
    chosen : mapping
        Options of `Tracer`; without any, complaints are bugs and stay as they are.
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
    """What traces, as ``--json`` prints it: ``device``, ``machine``, ``scheduler`` of multipass.

    Parameters
    ----------
    chosen : mapping
        Options of `Tracer`.
    device : str
    """
    machine = chosen.get("machine", options.USUAL_MACHINES[device])
    figures = {"machine": machine, "device": device}
    if machine == "multipass":
        figures["scheduler"] = chosen.get("scheduler", options.SCHEDULERS[0])
    return figures
