"""query_zarr: trace all rays of a store and write their hits to another."""

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

from raystream.core.checks import check_least
from raystream.core.errors import FileFormatError
from raystream.core.query import Crossings, counts_surfaces
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress, part_of
from raystream.ray_files.block_query import BlockQuery, BlockResult
from raystream.ray_files.durable import locked
from raystream.ray_files.errors import StoreWriteError, require_zarr
from raystream.ray_files.hit_store import COLUMNS, Columns, HitStore
from raystream.ray_files.identity import identify
from raystream.ray_files.journal import QueryProgress, journal_path, write_journal
from raystream.ray_files.pipeline import Waits, run
from raystream.ray_files.ray_store import RayStore
from raystream.ray_files.resume import prepare_output
from raystream.tracer import Tracer

QUERIES = tuple(COLUMNS)

#: Rays per block: about 50 MB with their hits, and enough to keep many cores busy.
BLOCK_RAYS = 2**20


@dataclass(frozen=True)
class QueryReport:
    """Summary of a query of a store.

    Attributes
    ----------
    rays : int
        Rays in the store.
    rays_before : int
        Rays traced by earlier runs.
    rays_hit, hits : int
        Number of rays that hit anything, and number of all hits.
    invalid_rays : int or None
        Number of invalid rays; None if the query does not report it.
    seconds : float
        Duration of this run, from the first ray read to the last hit written.
    reading_wait, writing_wait : float
        Part of the duration in which tracing waited for reads and for writes, in seconds.
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
    """Trace the rays of a Zarr store of any size and write their hits to another.

    Parameters
    ----------
    tracer : Tracer
    rays : str or path
        A folder or ``.zip`` file with a Zarr group, v2 or v3, of arrays ``origins`` and
        ``directions`` of shape S + (3,), which broadcast against each other, and optionally
        ``t_min`` and ``t_max``, which broadcast to S; floats or integers.
    output : str or path
        A folder for a Zarr group, v3; a complete group of hits is replaced. ``first_hit`` writes
        ``t``, ``u``, ``v``, ``prim_id``, ``mesh_id`` and ``status``, ``any_hit`` writes ``hit``,
        and ``count_hits`` writes ``count``; each of shape S. ``multi_hit`` writes ``status``
        of shape S, ``ray_splits`` of shape (N + 1,), and ``t``, ``u``, ``v``, ``prim_id``,
        ``mesh_id`` of shape (K,). Both also write ``face_id``, unless the tracer has no scene but a
        saved structure, and ``instance_id`` in a scene with instances. The bits equal those of
        tracing all rays at once.
    query : {"first_hit", "any_hit", "multi_hit", "count_hits"}
    max_hits : int, optional
        ``multi_hit`` only: keep the nearest hits of each ray.
    crossings : {"triangles", "surfaces"}
        ``multi_hit`` and ``count_hits`` only.
    block_rays : int
        Approximate number of rays traced at a time, and of rays per chunk of hits.
    resume : bool
        Resume an interrupted run. Starts a new one if there is none; does nothing if the
        output is complete.
    progress : callable, optional
        Called with (rays done, rays) on the calling thread, first with those of earlier runs.
        Rays of a block that is not yet written count; an interrupted run traces them again.

    Returns
    -------
    QueryReport

    Raises
    ------
    FileFormatError
        If the rays cannot be read; or if the output holds other files, hits of an interrupted
        run without ``resume``, or hits of another query.
    StoreWriteError
        If hits cannot be written.
    RaystreamError
        If the package zarr is not installed.
    ValueError, TypeError
        If an argument is invalid.

    Notes
    -----
    Memory use is that of a few blocks, whatever the number of rays, of hits, and of hits per
    ray. Progress is recorded on disk after each block, in ``output.progress.json``, which is
    deleted at the end: the process may be killed, or the machine fail, at any moment. While
    it exists, values not written yet are NaN; -2 for ``prim_id`` and other ids; -1 for
    counts; False; 255 for ``status``.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> report = rs.query_zarr(tracer, "rays.zarr", "hits.zarr", resume=True)  # doctest: +SKIP
    """
    if query not in QUERIES:
        raise ValueError(f"query: expected {' or '.join(QUERIES)}, got {query!r}")
    options = _options(query, max_hits, crossings)
    block_rays = check_least("block_rays", block_rays, 1)
    require_zarr()
    target = Path(output)
    source = RayStore(rays)
    _check_separate(Path(rays), target)
    blocks = source.divide(block_rays)
    triangles: Any = tracer.structure.triangles
    check_support("query_zarr", triangles)
    columns = Columns.of(query, triangles)
    identity = identify(tracer, source, blocks, query, options)
    with _converting_errors(target), _exclusive(target):
        done, is_complete = prepare_output(target, columns, blocks, identity, resume)
        before, waits, started = done.rays, Waits(), time.perf_counter()
        if not is_complete:
            store = HitStore(target, columns, blocks, done.rays, done.rows)
            writer = _Writer(store, journal_path(target), identity, done)
            block_query = BlockQuery(tracer, query, options, tuple(columns.of_rays))
            if progress is not None:
                progress(before, blocks.ray_count)
            waits = run(
                blocks.after(done.rays),
                source.read,
                lambda block, read: block_query(
                    block,
                    read,
                    part_of(progress, block.begin, block.end - block.begin, blocks.ray_count),
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
        raise ValueError(f"crossings: not supported by {query}; use multi_hit or count_hits")
    if query == "multi_hit":
        options["max_hits"] = None if max_hits is None else operator.index(max_hits)
        if max_hits is not None and max_hits < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
    elif max_hits is not None:
        raise ValueError(f"max_hits: not supported by {query}; use multi_hit")
    return options


def _check_separate(rays: Path, output: Path) -> None:
    """Reject an output that is the input, lies inside it, or contains it."""
    given, target = rays.resolve(), output.resolve()
    if given == target or given in target.parents or target in given.parents:
        raise FileFormatError(output, "rays and hits must be separate stores, not nested")


@contextlib.contextmanager
def _converting_errors(target: Path) -> Iterator[None]:
    try:
        yield
    except (FileFormatError, StoreWriteError):
        raise
    except OSError as error:
        raise StoreWriteError(target, error) from error


@contextlib.contextmanager
def _exclusive(target: Path) -> Iterator[None]:
    """Create and lock the folder, so that two processes never write the same hits."""
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
        if is_new:  # remove the folder if it is still empty
            with contextlib.suppress(OSError):
                os.rmdir(target)


class _Writer:
    """Writes hits, and records the progress."""

    def __init__(
        self, store: HitStore, record: Path, identity: dict[str, Any], done: QueryProgress
    ) -> None:
        self._store, self._record, self._identity, self._done = store, record, identity, done

    def write(self, result: BlockResult) -> None:
        """Write a result; the last one of a block is recorded in the journal."""
        done = self._done
        if result.rows is not None:
            self._store.append(result.rows)
            done.rows += len(result.rows.t)
        done.rays_hit += result.rays_hit
        done.hits += result.hits
        done.invalid_rays += result.invalid_rays
        if result.arrays:
            self._store.write_block(result.block, result.arrays)
            self._store.synchronize()
            done.rays = result.block.end
            write_journal(self._record, self._identity, done)

    def complete(self) -> None:
        """Mark the store as complete, and delete the journal."""
        self._store.complete(asdict(self._done))
        self._record.unlink()
