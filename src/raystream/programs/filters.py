"""Filters: queries that ignore some hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.store import Store
from raystream.jit.threads import Progress, rising
from raystream.kernels.hits import (
    HitAccumulator,
    HitAddresses,
    HitArrays,
    HitBatch,
    copy_rows,
    for_each_chunk,
)
from raystream.programs.filters_at_hits import FilterAtHits
from raystream.programs.loop_source import Goal
from raystream.programs.program import Program
from raystream.programs.ray_subset import PendingRays, RaySubset
from raystream.programs.rounds import FindHits, visit
from raystream.programs.scene_forms import form_of


def _keep_all(hit: Any) -> bool:
    """The filter of a query that only skips triangles: it keeps every hit."""
    return hit.prim_id >= 0


class Bound(NamedTuple):
    """A filter with constants passed at run time: new values need no compilation.

    Attributes
    ----------
    function : callable
        ``function(hit, constants)``.
    constants : tuple
        Numbers, and tuples of numbers.
    kept : object
        Keeps alive the memory at addresses among the constants.
    """

    function: Callable[..., Any]
    constants: tuple[Any, ...]
    kept: object = None


class Filter(NamedTuple):
    """The hits that a query ignores.

    Attributes
    ----------
    function : callable
        The user's function.
    skipped : ndarray of shape (N, k) or (N, k, 2), int32, or None
        Triangles that each ray skips, see `rows.skipped_triangles`; on a device, as the caller
        gave them.
    triangles : Store
    bound : Bound, optional
        If the function has constants.
    """

    function: Callable[..., Any]
    skipped: Any
    triangles: Store
    bound: Bound | None = None

    @classmethod
    def of(cls, on_hit: Any, skipped: Any, triangles: Store) -> Filter:
        """The filter of a function, or of None, which keeps all hits that are not skipped."""
        if isinstance(on_hit, Bound):
            return cls(on_hit.function, skipped, triangles, on_hit)
        return cls(_keep_all if on_hit is None else on_hit, skipped, triangles)

    @property
    def is_bare(self) -> bool:
        """Whether there is no function to call: without instances traversals skip triangles."""
        return self.function is _keep_all and form_of(self.triangles).skips_in_traversal

    def at_hits(self, rays: RayBatch) -> FilterAtHits:
        """The filter compiled to be called by traversals."""
        function = None if self.is_bare else self.function
        constants = None if self.bound is None else self.bound.constants
        return FilterAtHits(function, self.skipped, constants, self.triangles, rays)

    def program(self, goal: Goal, *arguments: Any) -> Program:
        """The filter compiled into a loop."""
        constants = None if self.bound is None else self.bound.constants
        return Program(self.function, goal, self.skipped, arguments, self.triangles, constants)


def filter_first(
    filter_: Filter,
    find: FindHits,
    batch: RayBatch,
    hits: HitArrays,
) -> None:
    """Replace ignored first hits by the nearest hits that are kept.

    Parameters
    ----------
    filter_ : Filter
    find : callable
    batch : RayBatch
    hits : HitArrays
        The first hits without the filter; changed in place.
    """
    program = filter_.program("first", HitAddresses.of(hits))
    program.compile()
    whole = RaySubset(batch, None, 0)
    pending = PendingRays.of(whole, 0)
    for_each_chunk(HitBatch(hits, None, None, 0), lambda found: program.run(found, pending))
    ignored = np.flatnonzero(pending.open_rays)  # rays without hits are closed
    if len(ignored) == 0:
        return
    for array, value in zip(hits, (np.inf, 0.0, 0.0, -1), strict=True):
        array[ignored] = value
    visit(find, whole.part(ignored), program.run, np.zeros(len(ignored), np.uint8), delivered=1)


def count_filtered(
    filter_: Filter, find: FindHits, batch: RayBatch, progress: Progress | None
) -> NDArray[np.int64]:
    """Count the hits of each ray that are kept."""
    progress = rising(progress)
    counts = np.zeros(len(batch), np.int64)
    program = filter_.program("count", np.uint64(counts.ctypes.data))
    program.compile()
    whole, status = RaySubset(batch, None, 0), np.zeros(len(batch), np.uint8)
    if visit(find, whole, program.run, status, progress, is_ordered=False):
        # The hits before the one that ends a ray depend on the order.
        counts.fill(0)
        visit(find, whole, program.run, status, progress)
    return counts


def multi_filtered(
    filter_: Filter,
    find: FindHits,
    batch: RayBatch,
    limit: int,
    status: NDArray[np.uint8],
    progress: Progress | None,
) -> tuple[NDArray[np.int64], HitArrays]:
    """Find the nearest `limit` hits of each ray that are kept: splits, and rows; see `Sink`."""
    found_counts = np.zeros(len(batch), np.int64)
    program = filter_.program("multi", found_counts, np.int64(limit))
    program.compile(np.empty(0, np.int64))
    collected = HitAccumulator(len(batch), filter_.triangles.number_type)

    def run(found: HitBatch, pending: PendingRays) -> int:
        counts = np.zeros(len(found), np.int64)
        seen = program.run(found, pending, counts)
        collected.take(_compact(found, pending, counts), pending.delivered > 0)
        return seen

    visit(find, RaySubset(batch, None, 0), run, status, progress)
    return collected.whole()


def _compact(found: HitBatch, pending: PendingRays, counts: NDArray[np.int64]) -> HitBatch:
    """The rows that are kept, for rays of the whole batch.

    The loop moved them to the first of each ray's new rows.
    """
    assert found.splits is not None
    firsts = np.minimum(found.splits[:-1] + pending.delivered, found.splits[1:])
    splits = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=splits[1:])
    kept = HitArrays.empty(int(splits[-1]), found.hits.t.dtype.type)
    copy_rows(0, len(counts), found.hits, firsts, counts, splits[:-1], kept)
    if pending.rays.ids is not None:
        return HitBatch(kept, splits, pending.rays.ids[found.rays], 0)
    first = pending.rays.first
    ids = None if found.ids is None else found.ids + first
    return HitBatch(kept, splits, ids, found.first + first)
