"""RecordStream: what the streams of all devices have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raystream.streams import reductions
from raystream.streams.condition import Condition
from raystream.streams.layout import Layout, find_layout, native_array


class RecordStream(ABC):
    """Records of one type: their names, comparisons and reductions.

    Parameters
    ----------
    array : ndarray
        Shape (N,), or (N, k) for vectors of k components; see `native_records`.
    name : str or None

    Attributes
    ----------
    name : str or None
    layout : Layout
    """

    def __init__(self, array: NDArray[Any], name: str | None) -> None:
        self.name = name
        self._count = len(array)
        self.layout: Layout = find_layout(self.label, array, array.ndim == 2)

    @property
    @abstractmethod
    def array(self) -> NDArray[Any]:
        """The current records."""

    @property
    def label(self) -> str:
        """Its name in errors."""
        return label_of(self.name)

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the numbers, or of a record with fields."""
        return self.layout.dtype

    @property
    def record(self) -> Any:
        """Named tuple of the fields; None if the records have none."""
        return self.layout.record

    def __len__(self) -> int:
        return self._count

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.array, dtype, copy=copy)

    def __repr__(self) -> str:
        kind = f"{self.dtype}"
        if self.layout.component_count:
            kind += f" x {self.layout.component_count}"
        return f"<Stream{'' if self.name is None else f' {self.name!r}'}: {len(self):,} x {kind}>"

    # Comparisons make conditions; streams are hashed by identity.
    __hash__ = object.__hash__

    def __eq__(self, value: object) -> Condition:  # type: ignore[override]
        return Condition(self, "==", value)

    def __ne__(self, value: object) -> Condition:  # type: ignore[override]
        return Condition(self, "!=", value)

    def __lt__(self, value: Any) -> Condition:
        return Condition(self, "<", value)

    def __le__(self, value: Any) -> Condition:
        return Condition(self, "<=", value)

    def __gt__(self, value: Any) -> Condition:
        return Condition(self, ">", value)

    def __ge__(self, value: Any) -> Condition:
        return Condition(self, ">=", value)

    def sum(self) -> Any:
        """Sum of all records, in float64, complex128 or 64-bit integers; by component."""
        return reductions.add_up(self)

    def min(self) -> Any:
        """Smallest number, by component; NaN if there is one."""
        return reductions.least(self)

    def max(self) -> Any:
        """Largest number, by component; NaN if there is one."""
        return reductions.greatest(self)

    def count(self) -> Any:
        """Number of nonzero records, by component."""
        return reductions.count_nonzero(self)

    def any(self) -> Any:
        """Whether any record is nonzero, by component."""
        return reductions.count_nonzero(self) > 0

    def all(self) -> Any:
        """Whether all records are nonzero, by component."""
        return reductions.count_nonzero(self) == len(self)

    def reduce(self, function: Callable[..., Any], initial: Any = None) -> Any:
        """Fold all records with a function of two records.

        Parameters
        ----------
        function : callable
            Takes two records and returns one, in the form of kernels' functions. It should be
            associative: records are folded in order in blocks of `reductions.BLOCK`, and then the
            blocks' results.
        initial : record, optional
            Precedes the first record; the result of an empty stream.

        Returns
        -------
        record
            A NumPy scalar; an array for a vector; a structured scalar for fields. The same for
            any number of threads.

        Raises
        ------
        ValueError
            If the stream is empty and there is no `initial`.
        """
        return reductions.fold(self, function, initial)


def label_of(name: str | None) -> str:
    """A stream's name in errors."""
    return "stream" if name is None else f"stream {name!r}"


def native_records(label: str, values: Any, dtype: DTypeLike | None) -> NDArray[Any]:
    """View values as an array of records: shape (N,), or (N, k) for vectors.

    Raises
    ------
    TypeError
        If they cannot be read as an array.
    ValueError
        If the shape is not supported.
    """
    array = native_array(label, values, dtype)
    if array.ndim not in (1, 2):
        raise ValueError(f"{label}: expected shape (N,) or, for vectors, (N, k), got {array.shape}")
    return array
