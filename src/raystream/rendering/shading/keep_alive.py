"""What lies at the addresses of tables: kept as long as they are used, and copied to devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["AddressRow", "kept_arrays"]


class AddressRow(NamedTuple):
    """Numbers of which some are addresses themselves.

    Attributes
    ----------
    numbers : ndarray of shape (N,), float64 or uint64
    places : tuple of int
        Which of them; they are uint64, or 0 for nothing.
    """

    numbers: NDArray[Any]
    places: tuple[int, ...]


def kept_arrays(kept: object) -> Iterator[NDArray[Any] | AddressRow]:
    """All arrays of what a maker of tables gives to be kept: in nested tuples, or None."""
    if isinstance(kept, AddressRow | np.ndarray):
        yield kept
    elif isinstance(kept, tuple):
        for one in kept:
            yield from kept_arrays(one)
    elif kept is not None:
        raise TypeError(f"kept: expected arrays in tuples, got {type(kept).__name__}")
