"""Counts of a cache's accesses and misses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from raystream_lab.caches.kernels.trace_access import COLUMNS


@dataclass(frozen=True)
class LineCounts:
    """Accesses and misses of a cache.

    Attributes
    ----------
    references : int
        Entries of the trace.
    accesses : int
        Lines touched: a reference across a line boundary touches both lines.
    misses : int
        Accesses to lines that were not in the cache, including first accesses.
    bytes_requested : int
        Sum of the reference lengths: the bytes read from memory without a cache.
    line_size : int
        Bytes per line.
    """

    references: int
    accesses: int
    misses: int
    bytes_requested: int
    line_size: int

    @property
    def hits(self) -> int:
        """Number of accesses that hit."""
        return self.accesses - self.misses

    @property
    def hit_rate(self) -> float:
        """Share of accesses that hit; nan without accesses."""
        return self.hits / self.accesses if self.accesses else float("nan")

    @property
    def bytes_fetched(self) -> int:
        """Bytes read from memory: one line per miss."""
        return self.misses * self.line_size

    @property
    def traffic(self) -> float:
        """Bytes read with the cache relative to those without; nan without accesses.

        Purcell 2002, Fig. 9. It can exceed 1: a miss reads a whole line.
        """
        return self.bytes_fetched / self.bytes_requested if self.bytes_requested else float("nan")

    def __add__(self, other: LineCounts) -> LineCounts:
        if self.line_size != other.line_size:
            raise ValueError(
                f"cannot add counts of lines of {self.line_size} and {other.line_size} bytes"
            )
        return LineCounts(
            self.references + other.references,
            self.accesses + other.accesses,
            self.misses + other.misses,
            self.bytes_requested + other.bytes_requested,
            self.line_size,
        )


def new_counts(kind_count: int) -> NDArray[np.uint64]:
    """Zero counts, a row of `COLUMNS` per kind."""
    return np.zeros((kind_count, len(COLUMNS)), np.uint64)


def by_kind(
    kinds: Sequence[str], rows: NDArray[np.uint64], misses: NDArray[np.uint64], line_size: int
) -> MappingProxyType[str, LineCounts]:
    """Make `LineCounts` by kind from rows of shape (K, 4) and misses of shape (K,)."""
    named = {}
    for name, row, missed in zip(kinds, rows.tolist(), misses.tolist(), strict=True):
        columns = dict(zip(COLUMNS, row, strict=True))
        named[name] = LineCounts(
            columns["references"], columns["accesses"], missed, columns["byte_count"], line_size
        )
    return MappingProxyType(named)
