"""Validation of trace chunks, and their form for kernels."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_host_array
from raystream_lab.caches.kernels.trace_access import Trace

#: Kinds or lengths: one value for all references, or one per reference.
Kinds = NDArray[np.uint8] | int

#: Bytes per word; smaller lines make no sense.
MIN_LINE_SIZE = 4

#: Kinds and lengths are uint8.
_MAX = 255


class Chunk(NamedTuple):
    """A chunk of a trace.

    Attributes
    ----------
    trace : Trace
        Addresses of the arrays.
    reference_count : np.uint64
        Number of references.
    arrays : tuple
        The arrays; keep them alive while their addresses are in use.
    """

    trace: Trace
    reference_count: np.uint64
    arrays: tuple[NDArray[np.generic], ...]


def as_count(name: str, value: SupportsIndex, low: int) -> int:
    """Check an integer option.

    Raises
    ------
    TypeError, ValueError
        If it is not an integer, or below `low`.
    """
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: must be an integer, not {value!r}") from None
    if number < low:
        raise ValueError(f"{name}: must be at least {low}, not {number}")
    return number


def as_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Check the names of the kinds of data."""
    names = tuple(kinds)
    if isinstance(kinds, str) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"kinds: must be a sequence of names, not {kinds!r}")
    if not 1 <= len(names) <= _MAX + 1:
        raise ValueError(f"kinds: must be 1 to {_MAX + 1} names, not {len(names)}")
    if len(set(names)) < len(names):
        raise ValueError(f"kinds: names must be unique, not {names!r}")
    return names


def as_chunk(addresses: NDArray[np.uint64], kinds: Kinds, lengths: Kinds, kind_count: int) -> Chunk:
    """Validate a chunk of a trace; see `Cache.access`."""
    begins = as_host_array("addresses", addresses)
    if begins.dtype != np.uint64 or not begins.dtype.isnative:
        raise TypeError(f"addresses: must be uint64, not {begins.dtype}; see ndarray.astype")
    if begins.ndim != 1:
        raise ValueError(f"addresses: must have shape (N,), not {begins.shape}")
    begins = np.ascontiguousarray(begins)
    kinds, kind_step = _each("kinds", kinds, len(begins), 0, kind_count - 1)
    lengths, length_step = _each("lengths", lengths, len(begins), 1, _MAX)
    if len(begins):
        _check_ends(begins, lengths)
    trace = Trace(
        *(np.uint64(number) for number in (begins.ctypes.data, kinds.ctypes.data, kind_step)),
        *(np.uint64(number) for number in (lengths.ctypes.data, length_step)),
    )
    return Chunk(trace, np.uint64(len(begins)), (begins, kinds, lengths))


def _each(
    name: str, values: Kinds, count: int, low: int, high: int
) -> tuple[NDArray[np.uint8], int]:
    """Validate one value for all references, or one each; returns the array and its stride."""
    allowed = f"must be from {low} to {high}"
    array = as_host_array(name, values)
    if array.ndim == 0:
        number = as_count(name, array.item(), low)
        if number > high:
            raise ValueError(f"{name}: {allowed}, not {number}")
        return np.full(1, number, np.uint8), 0
    if array.dtype != np.uint8:
        raise TypeError(f"{name}: must be an integer or uint8, not {array.dtype}")
    if array.shape != (count,):
        raise ValueError(f"{name}: must have shape ({count},) as addresses, not {array.shape}")
    if count and not (low <= array.min() and array.max() <= high):
        raise ValueError(f"{name}: {allowed}, not {array.min()} to {array.max()}")
    return np.ascontiguousarray(array), 1


def _check_ends(begins: NDArray[np.uint64], lengths: NDArray[np.uint8]) -> None:
    """Check that no reference extends beyond the last address."""
    if int(begins.max()) + int(lengths.max()) <= 1 << 64:
        return
    last = begins + (lengths - np.uint8(1)).astype(np.uint64)
    wrong = np.flatnonzero(last < begins)
    if len(wrong):
        at = wrong[0]
        raise ValueError(
            f"addresses: reference {at}, {lengths[at % len(lengths)]} bytes at {begins[at]}, "
            "extends beyond 2**64"
        )
