"""Blocks: contiguous parts of rays of any leading shape."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple


class Block(NamedTuple):
    """Rays that are contiguous in C order and form a box of the leading shape.

    Attributes
    ----------
    begin, end : int
        Range in C order over all rays.
    box : tuple of slice
        One for each axis of the leading shape.
    """

    begin: int
    end: int
    box: tuple[slice, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the box."""
        return tuple(part.stop - part.start for part in self.box)


class Blocks(NamedTuple):
    """A division of a leading shape into blocks.

    Attributes
    ----------
    shape : tuple of int
        The leading shape.
    lengths : tuple of int
        Block lengths along each axis: 1 before the axis that is cut, whole after it. The last
        blocks along the cut axis may be shorter.
    """

    shape: tuple[int, ...]
    lengths: tuple[int, ...]

    @property
    def ray_count(self) -> int:
        """Number of rays in all blocks."""
        return math.prod(self.shape)

    def after(self, ray: int) -> Iterator[Block]:
        """Iterate in order over the blocks that begin at this ray or later."""
        if self.ray_count == 0:
            return
        if not self.shape:  # a single ray
            if ray == 0:
                yield Block(0, 1, ())
            return
        axis = _cut_axis(self.shape, self.lengths)
        behind = math.prod(self.shape[axis + 1 :])
        step, length = self.lengths[axis], self.shape[axis]
        begin = 0
        for place in itertools.product(*map(range, self.shape[:axis])):
            if begin + length * behind <= ray:
                begin += length * behind
                continue
            for first in range(0, length, step):
                last = min(first + step, length)
                end = begin + (last - first) * behind
                if begin >= ray:
                    box = (
                        *(slice(at, at + 1) for at in place),
                        slice(first, last),
                        *(slice(0, whole) for whole in self.shape[axis + 1 :]),
                    )
                    yield Block(begin, end, box)
                begin = end


def _cut_axis(shape: Sequence[int], lengths: Sequence[int]) -> int:
    """Return the axis that is cut into blocks; the first if every axis is whole."""
    axis = len(shape) - 1
    while axis > 0 and lengths[axis] == shape[axis]:
        axis -= 1
    return axis


def divide(shape: Sequence[int], chunk: Sequence[int], limit: int) -> Blocks:
    """Divide a leading shape into blocks that match the chunks of its storage.

    Parameters
    ----------
    shape : sequence of int
    chunk : sequence of int
        Chunk lengths along each axis of `shape`.
    limit : int
        Maximum rays per block. A block may have four times as many if it then covers a whole
        chunk, so that no chunk is decoded twice.

    Returns
    -------
    Blocks
    """
    shape = tuple(shape)
    axis = 0
    while axis < len(shape) - 1 and math.prod(shape[axis + 1 :]) > limit:
        axis += 1
    if not shape:
        return Blocks((), ())
    behind = max(math.prod(shape[axis + 1 :]), 1)
    length = max(shape[axis], 1)
    most = max(limit // behind, 1)
    stored = min(max(chunk[axis], 1), length)
    if stored > most:
        # Otherwise the fewest equal parts of a chunk within the limit.
        is_whole = stored * behind <= 4 * limit
        step = stored if is_whole else -(-stored // -(-stored // most))
    else:
        parts = -(-length // most)
        step = min(-(-length // parts // stored) * stored, most // stored * stored)
    step = min(step, length)
    return Blocks(
        shape, (*(1 for _ in shape[:axis]), step, *(max(n, 1) for n in shape[axis + 1 :]))
    )
