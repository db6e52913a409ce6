"""Rounds: asking for hits in bounded pieces, until a program has seen what it wants to see.

Hits are in a total order (t, then prim_id), so that a ray which is asked about again for more
hits gives the same ones first: those are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.kernels.queries import UNLIMITED
from raystream.kernels.ray_source import RaySource
from raystream.programs.hits import RaysAt, RowsAt, SceneAt
from raystream.programs.program import Program

__all__ = ["Answer", "AskHits", "Asked", "subset", "visit"]

#: A tracer's query for the nearest hits: (batch, most of a ray, status, progress).
AskHits = Callable[
    [RayBatch, int, NDArray[np.uint8], Progress | None], tuple[NDArray[np.int64], HitArrays]
]

#: Rows that an answer should have at most: 64 MB.
ROWS_PER_BLOCK = 1 << 22

#: Rays that are asked about at a time, at most.
RAYS_PER_BLOCK = 1 << 20

#: Rays of the first block, which shows how many hits they have and how many of these a
#: program sees: about so many, in whole tiles of an image.
FIRST_RAYS = 1 << 12
TILE_ROWS = 16

#: Where rays have no more hits than this, all are asked for: that takes one pass with packets,
#: and the nearest few take two passes without.
FEW_HITS = 16

#: Likewise where a program sees more than this share of the hits.
SEEN_SHARE = 0.25

#: A ray that wants more hits is asked about for so many times as many.
GROWTH = 4


class Asked(NamedTuple):
    """Rays that are asked about.

    Attributes
    ----------
    batch : RayBatch
    ids : ndarray of shape (N,), int64, or None
        Their indices in the whole batch; None if they follow each other there.
    first : int
        Index of the first one.
    """

    batch: RayBatch
    ids: NDArray[np.int64] | None
    first: int

    def part(self, picked: NDArray[np.int64]) -> Asked:
        """Some of the rays, by their position among these."""
        ids = picked + self.first if self.ids is None else self.ids[picked]
        return Asked(subset(self.batch, picked), ids, 0)


class Answer(NamedTuple):
    """The nearest hits of some rays.

    Attributes
    ----------
    asked : Asked
    splits : ndarray of shape (N + 1,), int64, or None
        None if there is one row for each ray, whose prim_id may be -1.
    hits : HitArrays
    delivered : int
        Rows of each ray that were in answers before.
    """

    asked: Asked
    splits: NDArray[np.int64] | None
    hits: HitArrays
    delivered: int

    def run(
        self, program: Program, triangles: Triangles, *more: Any
    ) -> tuple[NDArray[np.bool_], int]:
        """Run a program over the rows; see `Program.run`."""
        batch, ids, first = self.asked
        source, kept = RaySource.of(batch.origins, batch.directions, batch.limits)
        rows = RowsAt.of(self.hits, self.splits, self.delivered)
        rays = RaysAt.of(source, ids, first)
        result = program.run(len(batch), rows, rays, SceneAt.of(triangles), *more)
        del kept  # the loop reads directions by address
        return result


#: Runs a program over an answer; returns which rays are open, and the rows that it saw.
Visitor = Callable[[Answer], tuple[NDArray[np.bool_], int]]


class _Pace:
    """How many rays to ask about, and for how many hits, by what was seen so far."""

    def __init__(self) -> None:
        self._rays = self._found = self._seen = 0

    def saw(self, rays: int, found: int, seen: int) -> None:
        """Take in an answer that had all hits."""
        self._rays += rays
        self._found += found
        self._seen += seen

    def limit(self) -> int:
        """Hits of a ray to ask for at first."""
        if self._found <= FEW_HITS * self._rays or self._seen > SEEN_SHARE * self._found:
            return UNLIMITED
        limit = GROWTH
        while limit * self._rays < 2 * self._seen:
            limit *= GROWTH
        return limit

    def ray_count(self) -> int:
        """Rays to ask about."""
        if self._rays == 0:
            return FIRST_RAYS
        rows = min(self._found / self._rays, float(self.limit()))
        return int(min(RAYS_PER_BLOCK, ROWS_PER_BLOCK / max(rows, 1.0)))


def visit(
    ask: AskHits,
    whole: Asked,
    visitor: Visitor,
    status: NDArray[np.uint8],
    progress: Progress | None = None,
    delivered: int = 0,
) -> None:
    """Give the hits of rays to a program, in order, until none is open.

    Parameters
    ----------
    ask : callable
    whole : Asked
    visitor : callable
    status : ndarray of shape (N,), uint8
        Of these rays; written for invalid ones.
    progress : callable, optional
        Called with (rays done, rays).
    delivered : int
        Hits of each ray that the program has seen before.
    """
    pace = _Pace()
    for rows, asked in _blocks(whole, pace):
        report = _report(progress, rows, len(whole.batch))
        _visit_block(ask, asked, visitor, status[rows], report, delivered, pace)
    if progress:
        progress(len(whole.batch), len(whole.batch))


def _visit_block(
    ask: AskHits,
    asked: Asked,
    visitor: Visitor,
    status: NDArray[np.uint8],
    progress: Progress | None,
    delivered: int,
    pace: _Pace,
) -> None:
    limit = pace.limit()
    while True:
        splits, hits = ask(asked.batch, limit, status, progress)
        open_rays, seen = visitor(Answer(asked, splits, hits, delivered))
        if limit == UNLIMITED:
            pace.saw(len(asked.batch), int(splits[-1]), seen)
            return
        is_full = np.diff(splits) == limit
        more = np.flatnonzero(is_full & open_rays)
        if len(more) == 0:
            return
        asked, status, progress = asked.part(more), status[more], None
        delivered, limit = max(delivered, limit), limit * GROWTH


def _blocks(whole: Asked, pace: _Pace) -> Iterator[tuple[slice, Asked]]:
    """Cut rays into blocks, of whole rows of tiles where they are an image's."""
    batch, ids, _ = whole
    count = len(batch)
    width = batch.shape[-1] if len(batch.shape) > 1 else 0
    is_image = 0 < width * TILE_ROWS <= 8 * FIRST_RAYS
    unit = width * TILE_ROWS if is_image else 1
    begin = 0
    while begin < count:
        size = max(pace.ray_count() // unit, 1) * unit
        end = count if begin + size + FIRST_RAYS // 2 >= count else begin + size
        rows = slice(begin, end)
        if end - begin == count:
            yield rows, whole
        else:
            shape = ((end - begin) // width, width) if is_image else (end - begin,)
            block = _batch(batch, rows, shape)
            yield rows, Asked(block, None if ids is None else ids[rows], whole.first + begin)
        begin = end


def subset(batch: RayBatch, picked: NDArray[np.int64]) -> RayBatch:
    """Some rays of a batch; what serves all rays is not copied."""
    return _batch(batch, picked, (len(picked),))


def _batch(batch: RayBatch, picked: Any, shape: tuple[int, ...]) -> RayBatch:
    vectors = [_vectors(array, picked, shape) for array in (batch.origins, batch.directions)]
    limits = [
        limit.reshape(()) if len(limit) == 1 else limit[picked].reshape(shape)
        for limit in batch.limits
    ]
    return RayBatch(*vectors, *limits)


def _vectors(array: NDArray[Any], picked: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    if array.strides[0] == 0 or len(array) == 1:
        return np.broadcast_to(array[:1].reshape(3), (*shape, 3))
    return array[picked].reshape(*shape, 3)


def _report(progress: Progress | None, rows: slice, total: int) -> Progress | None:
    """The callback of a block, whose query may count in steps of another kind."""
    if progress is None:
        return None
    whole, count = progress, rows.stop - rows.start

    def report(done: int, steps: int) -> object:
        return whole(min(rows.start + done * count // max(steps, 1), total), total)

    return report
