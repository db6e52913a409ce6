"""Streams: arrays of records that kernels read or write in order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raystream.streams import reductions
from raystream.streams.condition import Condition
from raystream.streams.layout import Layout, find_layout, native_array

__all__ = ["Stream"]


class Stream:
    """Records of one type, which kernels read or write in order.

    Parameters
    ----------
    values : array_like
        Shape (N,) for records that are numbers, or have fields (a structured dtype); shape
        (N, k) for vectors of k components. The values are copied.
    dtype : dtype, optional
        If the values are to be converted.
    name : str, optional
        For errors and counters. By default a kernel's name for it.

    Raises
    ------
    TypeError
        If kernels cannot compute with the dtype.
    ValueError
        If the shape is another.

    Notes
    -----
    A kernel's function gets a vector as a tuple of numbers, and a record with fields as a
    named tuple; `record` is its class. It returns records in the same form.

    A kernel that writes a stream and gathers from it reads the old values throughout: the new
    ones are written to a second array, and the two change places at the end. `array` is then
    another one than before, so ask for it anew.

    Comparing a stream with a number gives a `Condition`, not an array.

    Examples
    --------
    >>> import numpy as np
    >>> state = Stream(np.array([0, 2, 2], np.int8))
    >>> len(state), state.dtype, (state == 2).count()
    (3, dtype('int8'), 2)
    """

    def __init__(
        self, values: Any, dtype: DTypeLike | None = None, *, name: str | None = None
    ) -> None:
        self.name = name
        array = native_array(self.label, values, dtype)
        if array.ndim not in (1, 2):
            raise ValueError(
                f"{self.label}: expected shape (N,) or, for vectors, (N, k), got {array.shape}"
            )
        self.layout: Layout = find_layout(self.label, array, array.ndim == 2)
        self._front: NDArray[Any] = np.array(array, order="C")
        self._back: NDArray[Any] | None = None

    @classmethod
    def zeros(cls, count: int, dtype: DTypeLike = np.float64, *, name: str | None = None) -> Stream:
        """Make a stream of zeros.

        Parameters
        ----------
        count : int
        dtype : dtype
            For vectors with their length: ``(np.float32, 3)``.
        name : str, optional
        """
        return cls(np.zeros(count, dtype), name=name)

    @property
    def label(self) -> str:
        """What errors call it."""
        return "stream" if self.name is None else f"stream {self.name!r}"

    @property
    def array(self) -> NDArray[Any]:
        """The records as they are now; not a copy."""
        return self._front

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the numbers, or of a record with fields."""
        return self._front.dtype

    @property
    def record(self) -> Any:
        """Named tuple of the fields; None if the records have none."""
        return self.layout.record

    def assign(self, values: Any) -> None:
        """Replace all records.

        Parameters
        ----------
        values : array_like
            Of the stream's shape, or one record for all.

        Raises
        ------
        TypeError
            If a conversion would lose the kind of number, such as float to int.
        ValueError
            If the shape is another.
        """
        try:
            np.copyto(self._front, values, casting="same_kind")
        except (TypeError, ValueError) as error:
            raise type(error)(f"{self.label}: {error}") from error

    def __len__(self) -> int:
        return len(self._front)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self._front, dtype, copy=copy)

    def __repr__(self) -> str:
        kind = f"{self.dtype}"
        if self.layout.component_count:
            kind += f" x {self.layout.component_count}"
        return f"<Stream{'' if self.name is None else f' {self.name!r}'}: {len(self):,} x {kind}>"

    # Comparisons are conditions, so a stream is equal to itself alone where that is asked.
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
        """Smallest number, of each component; NaN if there is one."""
        return reductions.least(self)

    def max(self) -> Any:
        """Largest number, of each component; NaN if there is one."""
        return reductions.greatest(self)

    def count(self) -> Any:
        """How many records are not zero, in each component."""
        return reductions.count_nonzero(self)

    def any(self) -> Any:
        """Whether some record is not zero, in each component."""
        return reductions.count_nonzero(self) > 0

    def all(self) -> Any:
        """Whether no record is zero, in each component."""
        return reductions.count_nonzero(self) == len(self)

    def reduce(self, function: Callable[..., Any], initial: Any = None) -> Any:
        """Fold all records by a function of two.

        Parameters
        ----------
        function : callable
            Takes two records and returns one, in the form that kernels' functions use. It
            should be associative: records are folded in order, but in blocks of
            `reductions.BLOCK`, whose results are then folded in order.
        initial : record, optional
            Comes before the first; the result of an empty stream.

        Returns
        -------
        record
            A NumPy scalar; an array for a vector; a structured scalar for fields. The same
            for every number of threads.

        Raises
        ------
        ValueError
            If the stream is empty and there is no `initial`.
        """
        return reductions.fold(self, function, initial)

    def shares_memory(self, array: NDArray[Any]) -> bool:
        """Whether an array may be part of this stream's."""
        return any(
            own is not None and np.may_share_memory(own, array) for own in (self._front, self._back)
        )

    def new_array(self) -> NDArray[Any]:
        """The second array, for a kernel that reads the first while it writes."""
        if self._back is None:
            self._back = np.empty_like(self._front)
        return self._back

    def swap(self) -> None:
        """Make the second array the first."""
        assert self._back is not None
        self._front, self._back = self._back, self._front
