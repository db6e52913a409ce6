"""Tiles of a matrix of pairs: blocks of rows and columns that are traced at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

#: Most rays of a tile; and of the smallest tile that a memory limit asks for.
MOST_TILE = 1 << 18
LEAST_TILE = 1 << 12

#: Packed bits begin a byte every 8 columns.
_BYTE = 8


class Tile(NamedTuple):
    """A block of pairs.

    Attributes
    ----------
    rows, columns : slice
    begin : int
        Rays of the tiles before it.
    """

    rows: slice
    columns: slice
    begin: int

    @property
    def ray_count(self) -> int:
        """Pairs of the block."""
        return (self.rows.stop - self.rows.start) * (self.columns.stop - self.columns.start)


class Tiles(NamedTuple):
    """A division of N x M pairs, or of the half of them on and above the diagonal.

    Attributes
    ----------
    shape : tuple of two int
    step : tuple of two int
        Rows and columns of a tile; multiples of 8, or the whole length.
    is_half : bool
        Whether tiles below the diagonal are left out.
    """

    shape: tuple[int, int]
    step: tuple[int, int]
    is_half: bool

    @classmethod
    def of(cls, shape: tuple[int, int], is_half: bool, most: int = MOST_TILE) -> Tiles:
        """Divide pairs into tiles of at most this many rays, as square as possible."""
        side = _whole_bytes(int(most**0.5))
        if is_half:
            step = min(side, max(shape[0], 1))
            return cls(shape, (step, step), True)
        columns = min(side, max(shape[1], 1))
        rows = min(_whole_bytes(most // columns), max(shape[0], 1))
        columns = min(_whole_bytes(most // rows), max(shape[1], 1))
        return cls(shape, (rows, columns), False)

    @property
    def ray_count(self) -> int:
        """Rays of all tiles."""
        count = self.shape[0] * self.shape[1]
        if not self.is_half:
            return count
        size, step = self.shape[0], self.step[0]
        diagonal = size // step * step**2 + (size % step) ** 2
        return (count + diagonal) // 2

    def __iter__(self) -> Iterator[Tile]:  # type: ignore[override]
        begin = 0
        for row in range(0, self.shape[0], self.step[0]):
            rows = slice(row, min(row + self.step[0], self.shape[0]))
            for column in range(row if self.is_half else 0, self.shape[1], self.step[1]):
                tile = Tile(rows, slice(column, min(column + self.step[1], self.shape[1])), begin)
                yield tile
                begin += tile.ray_count


def _whole_bytes(count: int) -> int:
    return max(count // _BYTE, 1) * _BYTE
