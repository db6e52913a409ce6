"""``raystream query`` for rays in a Zarr store: block by block, resumable."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raystream.cli.bars import Bars
from raystream.cli.console import BadInputError, InterruptedRunError, write_note
from raystream.cli.load import Stopwatch

if TYPE_CHECKING:
    from raystream.ray_files import QueryReport
    from raystream.tracer import Tracer

#: The tracer's queries, by their command-line names.
QUERIES = {"first": "first_hit", "any": "any_hit", "multi": "multi_hit", "count": "count_hits"}


def is_store(rays: Path, output: Path) -> bool:
    """Whether the rays or hits are in a Zarr store, judging by their names."""
    names = (rays.suffix.lower(), output.suffix.lower())
    return ".zarr" in names or names[0] == ".zip" or rays.is_dir()


def check_stores(rays: Path, output: Path) -> None:
    """Check rays and output before any work is done for them.

    Raises
    ------
    BadInputError
        If the output is not named ``.zarr``, is a file, or its folder does not exist.
    RaystreamError
        If the rays cannot be read, or Zarr is not installed.
    """
    from raystream.ray_files.ray_store import RayStore

    if output.suffix.lower() != ".zarr":
        raise BadInputError(f"{output}: hits of rays in a Zarr store must be written to a .zarr")
    if not output.parent.is_dir():
        raise BadInputError(f"{output}: folder {output.parent} does not exist")
    if output.exists() and not output.is_dir():
        raise BadInputError(f"{output}: is a file, not a folder")
    RayStore(rays)


def trace_store(
    tracer: Tracer,
    rays: Path,
    output: Path,
    kind: str,
    arguments: dict[str, Any],
    bars: Bars,
    watch: Stopwatch,
) -> QueryReport:
    """Trace the rays of a store block by block.

    Parameters
    ----------
    tracer : Tracer
    rays, output : Path
    kind : str
        Kind of query: a key of `QUERIES`.
    arguments : dict
        Other arguments of `query_zarr`.
    bars : Bars
    watch : Stopwatch
        Records "trace", "read" and "write": the last two are waits included in the first.

    Raises
    ------
    InterruptedRunError
        After Ctrl-C; its message says how much is done.
    """
    from raystream.ray_files import query_zarr

    with bars.step("tracing", "rays") as progress, _reporting_progress(output):
        shown = _ResumeProgress(output, progress)
        report = query_zarr(tracer, rays, output, QUERIES[kind], progress=shown, **arguments)
    watch.seconds["trace"] = report.seconds
    watch.seconds["read"] = report.reading_wait
    watch.seconds["write"] = report.writing_wait
    return report


class _ResumeProgress:
    """Progress callback that reports where a query resumes."""

    def __init__(self, output: Path, shown: Callable[[int, int], None] | None) -> None:
        self._output, self._shown = output, shown
        self._is_first = True

    def __call__(self, done: int, total: int) -> None:
        if self._is_first and done:
            write_note(f"{self._output}: resumed at {done:,} of {total:,} rays")
        self._is_first = False
        if self._shown is not None:
            self._shown(done, total)


@contextlib.contextmanager
def _reporting_progress(output: Path) -> Iterator[None]:
    """After Ctrl-C, report how much is done; after a write error, say how to resume."""
    from raystream.ray_files import StoreWriteError, journal_path
    from raystream.ray_files.journal import read_journal

    record = journal_path(output)
    try:
        yield
    except KeyboardInterrupt:
        if not record.exists():
            raise
        done = read_journal(record).done.rays
        raise InterruptedRunError(
            f"{done:,} rays are done, with their hits in {output}; rerun with --resume to continue"
        ) from None
    except StoreWriteError as error:
        note = "; finished blocks are saved; rerun with --resume to continue"
        raise BadInputError(
            f"{output}: {error.strerror}{note if record.exists() else ''}"
        ) from error
