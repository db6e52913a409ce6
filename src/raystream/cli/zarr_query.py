"""``raystream query`` of rays in a Zarr store: block by block, and resumed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raystream.cli.bars import Bars
from raystream.cli.messages import BadInputError, BrokenOffError, write_note
from raystream.cli.opening import Stopwatch

if TYPE_CHECKING:
    from raystream.tracer import Tracer
    from raystream.ray_files import QueryReport

__all__ = ["check_stores", "is_store", "trace_store"]

#: The tracer's queries, by the command line's names.
QUERIES = {"first": "first_hit", "any": "any_hit", "multi": "multi_hit", "count": "count_hits"}


def is_store(rays: Path, output: Path) -> bool:
    """Whether rays are in a Zarr store, as names tell."""
    names = (rays.suffix.lower(), output.suffix.lower())
    return ".zarr" in names or names[0] == ".zip" or rays.is_dir()


def check_stores(rays: Path, output: Path) -> None:
    """Refuse rays and an output before any work is done for them.

    Raises
    ------
    BadInputError
        If the output is no ``.zarr``, its folder is not there, or it is a file.
    RaystreamError
        If the rays are none, or Zarr is not installed.
    """
    from raystream.ray_files.ray_store import RayStore

    if output.suffix.lower() != ".zarr":
        raise BadInputError(f"{output}: hits of rays in a Zarr store go to one; name it .zarr")
    if not output.parent.is_dir():
        raise BadInputError(f"{output}: there is no folder {output.parent}")
    if output.exists() and not output.is_dir():
        raise BadInputError(f"{output}: is a file, not a folder")
    RayStore(rays)


def trace_store(
    tracer: Tracer,
    rays: Path,
    output: Path,
    kind: str,
    asked: dict[str, Any],
    *,
    resume: bool,
    bars: Bars,
    watch: Stopwatch,
) -> QueryReport:
    """Trace the rays of a store.

    Parameters
    ----------
    tracer : Tracer
    rays, output : Path
    kind : str
        Of the query: a key of `QUERIES`.
    asked : dict
        Options of the query.
    resume : bool
    bars : Bars
    watch : Stopwatch
        Gets "trace", "read" and "write": the last two are waits, and part of the first.

    Raises
    ------
    BrokenOffError
        After Ctrl-C, says how much is done.
    """
    from raystream.ray_files import query_zarr

    with bars.step("tracing", "rays") as progress, _keeping(output):
        report = query_zarr(
            tracer,
            rays,
            output,
            QUERIES[kind],
            **asked,
            resume=resume,
            progress=_Noted(output, progress),
        )
    watch.seconds["trace"] = report.seconds
    watch.seconds["read"] = report.reading_wait
    watch.seconds["write"] = report.writing_wait
    return report


class _Noted:
    """Progress that tells where a query goes on."""

    def __init__(self, output: Path, shown: Callable[[int, int], None] | None) -> None:
        self._output, self._shown = output, shown
        self._is_first = True

    def __call__(self, done: int, total: int) -> None:
        if self._is_first and done:
            write_note(f"{self._output}: goes on from {done:,} of {total:,} rays")
        self._is_first = False
        if self._shown is not None:
            self._shown(done, total)


@contextlib.contextmanager
def _keeping(output: Path) -> Iterator[None]:
    """After Ctrl-C, say how much is done; and after a full disk, how to go on."""
    from raystream.ray_files import StoreWriteError, journal_path
    from raystream.ray_files.journal import read_journal

    record = journal_path(output)
    try:
        yield
    except KeyboardInterrupt:
        if not record.exists():
            raise
        done = read_journal(record).done.rays
        raise BrokenOffError(
            f"{done:,} rays are done, and their hits in {output}: the same command with --resume "
            "goes on from them"
        ) from None
    except StoreWriteError as error:
        kept = "; what is done is kept: the same command with --resume goes on from it"
        raise BadInputError(
            f"{output}: {error.strerror}{kept if record.exists() else ''}"
        ) from error
