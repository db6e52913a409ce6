"""query_zarr: a query of all rays of a store, whose hits go to another."""

from __future__ import annotations

import contextlib
import operator
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError
from raystream.core.query import counts_surfaces
from raystream.jit.threads import Progress, part_of
from raystream.tracer import Crossings, Tracer
from raystream.zarr_queries.asking import Answer, QueryInputs
from raystream.zarr_queries.beginning import begin
from raystream.zarr_queries.durable import locked
from raystream.zarr_queries.errors import StoreWritingError, require_zarr
from raystream.zarr_queries.hit_store import COLUMNS, HitStore
from raystream.zarr_queries.identity import identify
from raystream.zarr_queries.pipeline import Waits, run
from raystream.zarr_queries.progress_file import Done, progress_beside, write_progress
from raystream.zarr_queries.ray_store import RayStore

__all__ = ["BLOCK_RAYS", "QUERIES", "QueryReport", "query_zarr"]

QUERIES = tuple(COLUMNS)

#: Rays of a block: with their hits some 50 MB, and enough to keep many cores busy.
BLOCK_RAYS = 2**20


@dataclass(frozen=True)
class QueryReport:
    """What a query of a store found.

    Attributes
    ----------
    rays : int
        Of the store.
    rays_before : int
        Traced already by runs before this one.
    rays_hit, hits : int
        Rays that hit anything, and hits of all of them together.
    invalid_rays : int or None
        None where the query does not tell.
    seconds : float
        Of this run, from the first ray read to the last hit written.
    reading_wait, writing_wait : float
        Seconds of these in which nothing was traced.
    """

    rays: int
    rays_before: int
    rays_hit: int
    hits: int
    invalid_rays: int | None
    seconds: float
    reading_wait: float
    writing_wait: float


def query_zarr(
    tracer: Tracer,
    rays: str | PathLike[str],
    output: str | PathLike[str],
    query: str = "first_hit",
    *,
    max_hits: int | None = None,
    crossings: Crossings = "triangles",
    block_rays: int = BLOCK_RAYS,
    resume: bool = False,
    progress: Progress | None = None,
) -> QueryReport:
    """Trace the rays of a Zarr store, of any size, and write their hits to another.

    Parameters
    ----------
    tracer : Tracer
    rays : str or path
        A folder or ``.zip`` with a Zarr group, v2 or v3, of arrays ``origins`` and
        ``directions`` of shape S + (3,), which broadcast against each other, and perhaps
        ``t_min`` and ``t_max``, which broadcast to S; of floats or integers.
    output : str or path
        A folder for a Zarr group, v3; one of hits that is complete is replaced. It gets ``t``,
        ``u``, ``v``, ``prim_id``, ``mesh_id``, ``status`` of ``first_hit``; ``hit`` of
        ``any_hit``; ``count`` of ``count_hits``; each of shape S. Of ``multi_hit``, ``status``
        of shape S, ``ray_splits`` of shape (N + 1,), and ``t``, ``u``, ``v``, ``prim_id`` of
        shape (K,). They have the bits of the tracer's answer to all rays at once.
    query : {"first_hit", "any_hit", "multi_hit", "count_hits"}
    max_hits : int, optional
        Of ``multi_hit``: the nearest of each ray.
    crossings : {"triangles", "surfaces"}
        Of ``multi_hit`` and ``count_hits``.
    block_rays : int
        About how many rays are traced at a time, and how many a chunk of hits has.
    resume : bool
        Go on where a run that was broken off left the output. Where nothing was begun, it
        begins; where all is done, nothing is to be done.
    progress : callable, optional
        Called with (rays done, rays) on the calling thread; first with those of runs before.

    Returns
    -------
    QueryReport

    Raises
    ------
    FileFormatError
        If the rays cannot be read; or if the output holds something else, or hits that were
        broken off and are not to be gone on with, or of another question.
    StoreWritingError
        If hits cannot be written.
    RaystreamError
        If the package zarr is not installed.
    ValueError, TypeError
        If an argument is bad.

    Notes
    -----
    Memory is that of a few blocks, whatever the number of rays, of hits, and of hits of a ray.
    What is done is recorded on the disk after each block, in ``output.progress.json``, which is
    removed at the end: a process may be killed at any moment, and the machine go down. While
    it is there, numbers that were not written yet are NaN; -2 of ``prim_id`` and
    ``mesh_id``; -1 of counts; False; 255 of ``status``.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> report = rs.query_zarr(tracer, "rays.zarr", "hits.zarr", resume=True)  # doctest: +SKIP
    """
    if query not in QUERIES:
        raise ValueError(f"query: expected {' or '.join(QUERIES)}, got {query!r}")
    options = _options(query, max_hits, crossings)
    if operator.index(block_rays) < 1:
        raise ValueError(f"block_rays: expected at least 1, got {block_rays}")
    require_zarr()
    target = Path(output)
    source = RayStore(rays)
    _keep_apart(Path(rays), target)
    blocks = source.divide(operator.index(block_rays))
    identity = identify(tracer, source, blocks, query, options)
    with _writing(target), _alone(target):
        done, is_complete = begin(target, query, blocks, identity, resume)
        before, waits, started = done.rays, Waits(), time.perf_counter()
        if not is_complete:
            store = HitStore(target, query, blocks, done.rays, done.rows)
            writer = _Writer(store, progress_beside(target), identity, done)
            asking = QueryInputs(tracer, query, options)
            if progress is not None:
                progress(before, blocks.ray_count)
            waits = run(
                blocks.after(done.rays),
                source.read,
                lambda block, read: asking(
                    block, read, part_of(progress, block.begin, blocks.ray_count)
                ),
                writer.write,
            )
            writer.complete()
    has_status = "status" in COLUMNS[query]
    return QueryReport(
        blocks.ray_count,
        before,
        done.rays_hit,
        done.hits,
        done.invalid_rays if has_status else None,
        time.perf_counter() - started,
        waits.reading,
        waits.writing,
    )


def _options(query: str, max_hits: int | None, crossings: Crossings) -> dict[str, Any]:
    options: dict[str, Any] = {}
    counts_surfaces(crossings)
    if query in ("multi_hit", "count_hits"):
        options["crossings"] = crossings
    elif crossings != "triangles":
        raise ValueError(f"crossings: {query} has none; multi_hit and count_hits do")
    if query == "multi_hit":
        options["max_hits"] = None if max_hits is None else operator.index(max_hits)
        if max_hits is not None and max_hits < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
    elif max_hits is not None:
        raise ValueError(f"max_hits: {query} has none; multi_hit does")
    return options


def _keep_apart(rays: Path, output: Path) -> None:
    """Refuse an output that is the input, or lies in it, or around it."""
    given, target = rays.resolve(), output.resolve()
    if given == target or given in target.parents or target in given.parents:
        raise FileFormatError(output, "is the store of rays, or one of them lies in the other")


@contextlib.contextmanager
def _writing(target: Path) -> Iterator[None]:
    try:
        yield
    except (FileFormatError, StoreWritingError):
        raise
    except OSError as error:
        raise StoreWritingError(target, error) from error


@contextlib.contextmanager
def _alone(target: Path) -> Iterator[None]:
    """Make the folder, and hold it: two processes would write into each other's hits."""
    is_new = not target.exists()
    if not is_new and not target.is_dir():
        raise FileFormatError(target, "is a file, not a folder for hits")
    target.mkdir(exist_ok=True)
    try:
        with locked(target) as is_mine:
            if not is_mine:
                raise FileFormatError(target, "another process is writing these hits")
            yield
    finally:
        if is_new:  # and nothing came of it
            with contextlib.suppress(OSError):
                os.rmdir(target)


class _Writer:
    """Writes answers, and records what is done."""

    def __init__(self, store: HitStore, record: Path, identity: dict[str, Any], done: Done) -> None:
        self._store, self._record, self._identity, self._done = store, record, identity, done

    def write(self, answer: Answer) -> None:
        """Write an answer; the last of a block is recorded."""
        done = self._done
        if answer.rows is not None:
            self._store.append(answer.rows)
            done.rows += len(answer.rows.t)
        done.rays_hit += answer.rays_hit
        done.hits += answer.hits
        done.invalid_rays += answer.invalid_rays
        if answer.arrays:
            self._store.write_block(answer.block, answer.arrays)
            self._store.synchronize()
            done.rays = answer.block.end
            write_progress(self._record, self._identity, done)

    def complete(self) -> None:
        """Say that all is done, and remove the record."""
        self._store.complete(asdict(self._done))
        self._record.unlink()
