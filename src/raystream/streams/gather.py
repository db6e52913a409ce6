"""Gather arrays: read at any index by kernels, never written."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.streams.layout import Layout, find_layout, native_array
from raystream.streams.stream import Stream


class GatherArray:
    """An array that a kernel reads at any index.

    In a kernel's function ``table[i]`` is one record, or ``table[i, j]`` if it has two
    dimensions; ``len(table)`` and ``table.shape`` are those of the records. Indices are not
    checked, except in counted passes; negative ones count from the end.

    Parameters
    ----------
    values : array_like or Stream
        An array is not copied. If a kernel also writes the stream, it reads the old records.
    shape : tuple of int, optional
        Reshapes the records, the last index running fastest.
    vectors : bool
        Whether the last axis of an array holds the components of vectors; not for streams.
    name : str, optional
        Name in counters [default: the kernel's name for it].

    Raises
    ------
    TypeError
        If kernels cannot compute with the dtype.
    ValueError
        If the array has no dimensions, or `shape` has a different number of records.
    """

    def __init__(
        self,
        values: Any,
        shape: tuple[int, ...] | None = None,
        *,
        vectors: bool = False,
        name: str | None = None,
    ) -> None:
        label = "gather array" if name is None else f"gather array {name!r}"
        self.name = name
        self.stream: Stream | None = None
        if isinstance(values, Stream):
            self.stream = values
            self.layout: Layout = values.layout
            array = values.array
            self.name = values.name if name is None else name
        else:
            array = native_array(label, values)
            if array.ndim < 1 + vectors:
                raise ValueError(f"{label}: expected at least {1 + vectors} dimension(s), got 0")
            self.layout = find_layout(label, array, vectors)
        record_shape = array.shape[array.ndim - 1 :] if self.layout.component_count else ()
        found = array.shape[: array.ndim - len(record_shape)]
        self.shape = shape_of_records(label, found, shape)
        self._array_shape = (*self.shape, *record_shape)
        self._array = array

    @property
    def array(self) -> NDArray[Any]:
        """The current records; not a copy if the shape allows it."""
        array = self._array if self.stream is None else self.stream.array
        return np.reshape(array, self._array_shape)


def shape_of_records(
    label: str, found: tuple[int, ...], wanted: tuple[int, ...] | None
) -> tuple[int, ...]:
    """The shape that is wanted for records, or the one found; ValueError if it does not fit."""
    if wanted is None:
        return found
    if math.prod(wanted) != math.prod(found) or min(wanted, default=-1) < 0:
        raise ValueError(f"{label}: {math.prod(found):,} records cannot have shape {wanted}")
    return tuple(map(int, wanted))
