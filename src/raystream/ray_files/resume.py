"""Decide whether a query's output starts empty, resumes, or is complete."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError
from raystream.ray_files.blocks import Blocks
from raystream.ray_files.hit_store import (
    Columns,
    HitStore,
    is_replaceable,
    remove_store,
    store_attributes,
)
from raystream.ray_files.journal import (
    QueryProgress,
    check_same_query,
    journal_path,
    parse_counts,
    read_journal,
    write_journal,
)

#: What people call the parts of an identity.
_WORDS = {
    "block": "block_rays",
    "ray_digest": "the rays",
    "scene_digest": "the scene",
    "triangles": "the scene",
    "shape": "the rays' shape",
}


def prepare_output(
    target: Path, columns: Columns, blocks: Blocks, identity: dict[str, Any], resume: bool
) -> tuple[QueryProgress, bool]:
    """Prepare an output for writing, or find its progress.

    Parameters
    ----------
    target : Path
        A folder.
    columns : Columns
    blocks : Blocks
    identity : dict
        Identity of the query.
    resume : bool
        Whether to resume existing hits.

    Returns
    -------
    done : QueryProgress
    is_complete : bool

    Raises
    ------
    FileFormatError
        If the folder holds other files, or hits that must be neither lost nor mixed.
    """
    record = journal_path(target)
    found = store_attributes(target)
    theirs = found.get("identity")
    if record.exists():
        if not resume:
            raise FileFormatError(
                record,
                "is the journal of an interrupted query; pass resume=True (--resume) to continue, "
                "or delete it and the hits",
            )
        progress = read_journal(record)
        _check_same(record, progress.identity, identity)
        if progress.done.rays:
            if theirs != identity:
                raise FileFormatError(target, f"is not the store that {record} describes")
            return progress.done, False
    elif found.get("is_complete") is True and resume:
        _check_same(target, theirs, identity)
        return _done(target, found.get("counts")), True
    elif found and found.get("is_complete") is not True:
        raise FileFormatError(
            target, f"holds incomplete hits, but {record} is missing; delete the folder"
        )
    elif not found and any(target.iterdir()):
        raise FileFormatError(target, "holds files other than hits; choose another output")
    if not is_replaceable(target):
        raise FileFormatError(target, "holds other files besides hits; choose another output")
    # The journal first: until a block is done, it marks the folder's content as replaceable.
    write_journal(record, identity, QueryProgress())
    remove_store(target)
    HitStore.create(target, columns, blocks, identity)
    return QueryProgress(), False


def _check_same(path: Path, theirs: Any, ours: dict[str, Any]) -> None:
    if isinstance(theirs, dict) and theirs.get("block") != ours["block"]:
        theirs = {**theirs, "ray_digest": ours["ray_digest"]}  # of other rays, with other blocks
    check_same_query(path, theirs, ours, _WORDS)


def _done(target: Path, found: Any) -> QueryProgress:
    try:
        return parse_counts(found)
    except ValueError:
        raise FileFormatError(
            target, "its attributes are damaged; delete it to start over"
        ) from None
