"""The journal of a query's progress, beside its hits."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError
from raystream.ray_files.durable import write_durably

_FORMAT = "raystream query progress"
_MAX_BYTES = 2**20


@dataclass
class QueryProgress:
    """Progress counters of a query.

    Attributes
    ----------
    rays : int
        In C order: all rays before this one are traced, and their hits written.
    rows : int
        Hits of ``multi_hit`` written.
    rays_hit, hits, invalid_rays : int
    """

    rays: int = 0
    rows: int = 0
    rays_hit: int = 0
    hits: int = 0
    invalid_rays: int = 0


@dataclass
class Journal:
    """A journal: the identity of a query, and its progress."""

    identity: dict[str, Any]
    done: QueryProgress = field(default_factory=QueryProgress)


def journal_path(output: str | PathLike[str]) -> Path:
    """Return the path of the journal that accompanies a store of hits until it is complete."""
    path = Path(output)
    return path.with_name(f"{path.name}.progress.json")


def write_journal(path: Path, identity: dict[str, Any], done: QueryProgress) -> None:
    """Replace the journal durably."""
    content = {"format": _FORMAT, "identity": identity, "done": asdict(done)}
    write_durably(path, json.dumps(content, indent=2) + "\n")


def read_journal(path: Path) -> Journal:
    """Read a journal.

    Raises
    ------
    FileFormatError
        If it is damaged, or not a journal.
    """
    try:
        if os.path.getsize(path) > _MAX_BYTES:
            raise ValueError
        content = json.loads(path.read_bytes())
        if content["format"] != _FORMAT or not isinstance(content["identity"], dict):
            raise ValueError
        done = parse_counts(content["done"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise FileFormatError(
            path,
            "is not a journal of a query, or is damaged; delete it and the hits to start over, or "
            "choose another output",
        ) from None
    return Journal(content["identity"], done)


def parse_counts(counts: Any) -> QueryProgress:
    """Parse counters read from JSON; ValueError if they are damaged."""
    if not isinstance(counts, dict) or set(counts) != {
        known.name for known in fields(QueryProgress)
    }:
        raise ValueError("done: expected counts by name")
    if not all(type(count) is int and 0 <= count < 2**62 for count in counts.values()):
        raise ValueError("done: expected counts")
    return QueryProgress(**counts)


def check_same_query(
    path: Path, theirs: Any, ours: Mapping[str, Any], words: Mapping[str, str]
) -> None:
    """Raise FileFormatError, with what differs in these words, unless identities are the same."""
    if not isinstance(theirs, dict):
        names = ["all"]
    else:
        keys = (key for key in {*theirs, *ours} if theirs.get(key) != ours.get(key))
        names = sorted({words.get(key, key) for key in keys})
    if names:
        raise FileFormatError(
            path,
            f"belongs to another query (different: {', '.join(names)}); delete it to start over, "
            "or choose another output",
        )
