"""Rounds: more and more hits of each ray, until a program ends the ray.

Hits are in a total order (t, then prim_id), so that a ray traced again for more hits has the same
ones first; these are skipped.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import UNLIMITED
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parts
from raystream.kernels.hits import HitBatch, HitVisitor
from raystream.programs.ray_subset import PendingRays, RaySubset

#: Calls a visitor with the hits of a batch: (batch, most hits per ray, whether in order, visitor,
#: status, progress).
FindHits = Callable[[RayBatch, int, bool, HitVisitor, NDArray[np.uint8], Progress | None], None]

#: Runs a program over some of the hits, on any thread; returns the number visited.
RunProgram = Callable[[HitBatch, PendingRays], int]

#: Most rays of a block.
RAYS_PER_BLOCK = 1 << 20

#: Rays of the first block, rounded to whole tiles of an image: it estimates the hits per ray, and
#: how many of them a program sees.
FIRST_RAYS = 1 << 12
TILE_ROWS = 16

#: If rays have no more hits than this, all are found: that takes one search, and the nearest few
#: may take several.
FEW_HITS = 16

#: Likewise if a program sees more than this share of the hits.
SEEN_SHARE = 0.25

#: Each round finds this many times as many hits of a ray as the one before.
GROWTH = 4


class _RoundSize:
    """Rays to trace next, and hits of each to find, from the hits seen so far."""

    def __init__(self) -> None:
        self._rays = self._found = self._seen = 0

    def saw(self, rays: int, found: int, seen: int) -> None:
        """Take in a round that found all hits."""
        self._rays += rays
        self._found += found
        self._seen += seen

    def limit(self) -> int:
        """Hits per ray to find in the first round."""
        if self._found <= FEW_HITS * self._rays or self._seen > SEEN_SHARE * self._found:
            return UNLIMITED
        limit = GROWTH
        while limit * self._rays < 2 * self._seen:
            limit *= GROWTH
        return limit

    def ray_count(self, unit: int, left: int) -> int:
        """Rays to trace next of those that are left: a multiple of the unit, or all."""
        size = FIRST_RAYS if self._rays == 0 else RAYS_PER_BLOCK
        size = max(size // unit, 1) * unit
        return left if size + 2 * FIRST_RAYS >= left else size


def _image_width(shape: tuple[int, ...]) -> int:
    """The width of an image's rays; 0 if blocks need not have whole rows of tiles."""
    width = shape[-1] if len(shape) > 1 else 0
    return width if width * TILE_ROWS <= 8 * FIRST_RAYS else 0


def visit(
    find: FindHits,
    whole: RaySubset,
    run: RunProgram,
    status: NDArray[np.uint8],
    progress: Progress | None = None,
    *,
    delivered: int = 0,
    is_ordered: bool = True,
) -> bool:
    """Run a program over the hits of rays until none is open.

    Parameters
    ----------
    find : callable
    whole : RaySubset
    run : callable
    status : ndarray of shape (N,), uint8
        Status of these rays; written for invalid ones.
    progress : callable, optional
        Called with (rays done, rays).
    delivered : int
        Hits of each ray that the program has seen before.
    is_ordered : bool
        Whether a ray's hits must be in order of t, then prim_id.

    Returns
    -------
    bool
        Whether the program ended a ray.
    """
    sizes, has_ended = _RoundSize(), False
    count, width = len(whole.batch), _image_width(whole.batch.shape)
    size_of = partial(sizes.ray_count, width * TILE_ROWS or 1)
    for rows, report in parts(count, size_of, progress):
        size = rows.stop - rows.start
        # Whole rows of tiles, if they are an image's.
        shape = (size // width, width) if width else (size,)
        rays = whole if size == count else whole.rows(rows, shape)
        limit = sizes.limit()
        if limit == UNLIMITED:
            has_ended |= _visit_all(
                find, PendingRays.of(rays, delivered), run, status[rows], report, is_ordered, sizes
            )
        else:
            has_ended |= _visit_rounds(find, rays, limit, run, status[rows], report, delivered)
    return has_ended


def _visit_all(
    find: FindHits,
    pending: PendingRays,
    run: RunProgram,
    status: NDArray[np.uint8],
    progress: Progress | None,
    is_ordered: bool,
    sizes: _RoundSize,
) -> bool:
    """Find all hits, in one round."""
    figures: list[tuple[int, int]] = []

    def visitor(found: HitBatch) -> None:
        figures.append((found.hit_count, run(found, pending)))

    batch = pending.rays.batch
    find(batch, UNLIMITED, is_ordered, visitor, status, progress)
    found, seen = np.sum(figures, axis=0) if figures else (0, 0)
    sizes.saw(len(batch), int(found), int(seen))
    return not pending.open_rays.all()


def _visit_rounds(
    find: FindHits,
    rays: RaySubset,
    limit: int,
    run: RunProgram,
    status: NDArray[np.uint8],
    progress: Progress | None,
    delivered: int,
) -> bool:
    """Find the nearest few hits, and more for rays that the program did not end."""
    has_ended = False
    while True:
        pending = PendingRays.of(rays, delivered)
        more = _visit_nearest(find, pending, limit, run, status, progress)
        has_ended |= not pending.open_rays.all()
        if len(more) == 0:
            return has_ended
        rays, status, progress = rays.part(more), status[more], None
        delivered, limit = max(delivered, limit), limit * GROWTH


def _visit_nearest(
    find: FindHits,
    pending: PendingRays,
    limit: int,
    run: RunProgram,
    status: NDArray[np.uint8],
    progress: Progress | None,
) -> NDArray[np.int64]:
    """Find the nearest few hits; returns the positions of rays that may have more."""
    is_full = np.zeros(len(pending.rays.batch), np.bool_)

    def visitor(found: HitBatch) -> None:
        assert found.splits is not None
        is_full[found.rays] = np.diff(found.splits) == limit
        run(found, pending)

    find(pending.rays.batch, limit, True, visitor, status, progress)
    return np.flatnonzero(is_full & pending.open_rays)
