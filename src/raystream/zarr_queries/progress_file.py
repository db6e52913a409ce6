"""The record of what is done of a query, beside its hits."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError
from raystream.zarr_queries.durable import write_durably

__all__ = ["Done", "differing", "parse_done", "progress_beside", "read_progress", "write_progress"]

_FORMAT = "raystream query progress"
_MAX_BYTES = 2**20


@dataclass
class Done:
    """What is done of a query.

    Attributes
    ----------
    rays : int
        In C order: all before it are traced, and their hits written.
    rows : int
        Hits written of ``multi_hit``.
    rays_hit, hits, invalid_rays : int
    """

    rays: int = 0
    rows: int = 0
    rays_hit: int = 0
    hits: int = 0
    invalid_rays: int = 0


@dataclass
class Progress:
    """A record: what was asked, and what is done of it."""

    identity: dict[str, Any]
    done: Done = field(default_factory=Done)


def progress_beside(output: str | PathLike[str]) -> Path:
    """The file that keeps the record of a store of hits until it is complete."""
    path = Path(output)
    return path.with_name(f"{path.name}.progress.json")


def write_progress(path: Path, identity: dict[str, Any], done: Done) -> None:
    """Replace the record, for good."""
    content = {"format": _FORMAT, "asked": identity, "done": asdict(done)}
    write_durably(path, json.dumps(content, indent=2) + "\n")


def read_progress(path: Path) -> Progress:
    """Read a record.

    Raises
    ------
    FileFormatError
        If it is damaged, or no such record.
    """
    try:
        if os.path.getsize(path) > _MAX_BYTES:
            raise ValueError
        content = json.loads(path.read_bytes())
        if content["format"] != _FORMAT or not isinstance(content["asked"], dict):
            raise ValueError
        done = parse_done(content["done"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise FileFormatError(
            path,
            "is no record of a query, or a damaged one; remove it and the hits to begin anew, or "
            "choose another output",
        ) from None
    return Progress(content["asked"], done)


def parse_done(counts: Any) -> Done:
    """Make it of what JSON has; raises ValueError if that is damaged."""
    if not isinstance(counts, dict) or set(counts) != {known.name for known in fields(Done)}:
        raise ValueError("done: expected counts by name")
    if not all(type(count) is int and 0 <= count < 2**62 for count in counts.values()):
        raise ValueError("done: expected counts")
    return Done(**counts)


def differing(theirs: dict[str, Any], ours: dict[str, Any]) -> str:
    """Name what differs between two questions; nothing if they are the same."""
    names = sorted({*theirs, *ours})
    return ", ".join(name for name in names if theirs.get(name) != ours.get(name))
