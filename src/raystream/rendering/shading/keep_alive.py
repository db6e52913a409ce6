"""Arrays whose addresses are in tables: to be kept alive, and copied to devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class AddressRow(NamedTuple):
    """An array of numbers, some of which are addresses.

    Attributes
    ----------
    numbers : ndarray of shape (N,), float64 or uint64
    places : tuple of int
        Indices of the addresses: uint64, or 0 for None.
    """

    numbers: NDArray[Any]
    places: tuple[int, ...]


def kept_arrays(kept: object) -> Iterator[NDArray[Any] | AddressRow]:
    """Yield all arrays in nested tuples of arrays and None."""
    if isinstance(kept, AddressRow | np.ndarray):
        yield kept
    elif isinstance(kept, tuple):
        for one in kept:
            yield from kept_arrays(one)
    elif kept is not None:
        raise TypeError(f"kept: expected arrays in tuples, got {type(kept).__name__}")
