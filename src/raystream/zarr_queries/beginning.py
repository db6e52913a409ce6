"""Beginning: whether a query's output is made anew, gone on with, or complete."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError
from raystream.zarr_queries.blocks import Blocks
from raystream.zarr_queries.hit_store import HitStore, about, is_replaceable, remove_store
from raystream.zarr_queries.progress_file import (
    Done,
    differing,
    parse_done,
    progress_beside,
    read_progress,
    write_progress,
)

__all__ = ["begin"]


def begin(
    target: Path, query: str, blocks: Blocks, identity: dict[str, Any], resume: bool
) -> tuple[Done, bool]:
    """Make an output ready to be written, or find out how far it is.

    Parameters
    ----------
    target : Path
        A folder.
    query : str
    blocks : Blocks
    identity : dict
        What is asked.
    resume : bool
        Whether hits that are there already are gone on with.

    Returns
    -------
    done : Done
    is_complete : bool

    Raises
    ------
    FileFormatError
        If the folder holds something else, or hits that must be neither lost nor mixed.
    """
    record = progress_beside(target)
    found = about(target)
    asked = found.get("asked")
    if record.exists():
        if not resume:
            raise FileFormatError(
                record,
                "is the record of a query that was broken off; go on from it with resume=True "
                "(--resume), or remove it and the hits",
            )
        progress = read_progress(record)
        _check_same(record, progress.identity, identity)
        if progress.done.rays:
            if asked != identity:
                raise FileFormatError(target, f"is not the store that {record} tells of")
            return progress.done, False
    elif found.get("is_complete") is True and resume:
        _check_same(target, asked, identity)
        return _done(target, found.get("found")), True
    elif found and found.get("is_complete") is not True:
        raise FileFormatError(
            target, f"holds hits that were broken off, but {record} is missing; remove the folder"
        )
    elif not found and any(target.iterdir()):
        raise FileFormatError(target, "holds something else than hits; choose another output")
    if not is_replaceable(target):
        raise FileFormatError(target, "holds more than hits; choose another output")
    # The record first: until a block is done, it says that what lies here is to be made anew.
    write_progress(record, identity, Done())
    remove_store(target)
    HitStore.create(target, query, blocks, identity)
    return Done(), False


def _check_same(path: Path, theirs: Any, ours: dict[str, Any]) -> None:
    names = differing(theirs, ours) if isinstance(theirs, dict) else "all"
    if names:
        raise FileFormatError(
            path,
            f"is of another question ({names} differ); remove it to begin anew, or choose another "
            "output",
        )


def _done(target: Path, found: Any) -> Done:
    try:
        return parse_done(found)
    except ValueError:
        raise FileFormatError(
            target, "its attributes are damaged; remove it to begin anew"
        ) from None
