"""LineCounts: how often references found their lines in a cache."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from raystream.lab.caches.kernels.trace_access import COLUMNS

__all__ = ["LineCounts", "by_kind", "new_counts"]


@dataclass(frozen=True)
class LineCounts:
    """How often references found their lines in a cache.

    Attributes
    ----------
    references : int
        Entries of the trace.
    accesses : int
        Lines that they touched: a reference across the border of two lines touches both.
    misses : int
        Accesses to lines that were not in the cache, the first ones included.
    bytes_asked : int
        Lengths of the references, added up: what is read from memory without a cache.
    line_size : int
        Bytes of a line.
    """

    references: int
    accesses: int
    misses: int
    bytes_asked: int
    line_size: int

    @property
    def hits(self) -> int:
        """Accesses to lines that were in the cache."""
        return self.accesses - self.misses

    @property
    def hit_rate(self) -> float:
        """Share of the accesses that hit; nan without any."""
        return self.hits / self.accesses if self.accesses else float("nan")

    @property
    def bytes_fetched(self) -> int:
        """What the cache reads from memory: a line for each miss."""
        return self.misses * self.line_size

    @property
    def traffic(self) -> float:
        """Bytes read with the cache, relative to those without; nan without any.

        Purcell 2002, Fig. 9. It can exceed 1: a miss reads a whole line.
        """
        return self.bytes_fetched / self.bytes_asked if self.bytes_asked else float("nan")

    def __add__(self, other: LineCounts) -> LineCounts:
        if self.line_size != other.line_size:
            raise ValueError(
                f"counts of lines of {self.line_size} and of {other.line_size} bytes do not add up"
            )
        return LineCounts(
            self.references + other.references,
            self.accesses + other.accesses,
            self.misses + other.misses,
            self.bytes_asked + other.bytes_asked,
            self.line_size,
        )


def new_counts(kind_count: int) -> NDArray[np.uint64]:
    """Counts of zero, a row of `COLUMNS` for each kind."""
    return np.zeros((kind_count, len(COLUMNS)), np.uint64)


def by_kind(
    kinds: Sequence[str], rows: NDArray[np.uint64], misses: NDArray[np.uint64], line_size: int
) -> MappingProxyType[str, LineCounts]:
    """Name the rows of counts of shape (K, 4), with misses of shape (K,)."""
    named = {}
    for name, row, missed in zip(kinds, rows.tolist(), misses.tolist(), strict=True):
        columns = dict(zip(COLUMNS, row, strict=True))
        named[name] = LineCounts(
            columns["references"], columns["accesses"], missed, columns["byte_count"], line_size
        )
    return MappingProxyType(named)
