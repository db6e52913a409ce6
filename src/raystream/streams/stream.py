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
        Shape (N,) for numbers and for records with fields (a structured dtype); shape (N, k) for
        vectors of k components. The values are copied.
    dtype : dtype, optional
        Converts the values.
    name : str, optional
        For errors and counters [default: a kernel's name for it].

    Raises
    ------
    TypeError
        If kernels cannot compute with the dtype.
    ValueError
        If the shape is not supported.

    Notes
    -----
    A kernel's function receives a vector as a tuple of numbers, and a record with fields as a
    named tuple of class `record`. It returns records in the same form.

    A kernel that writes a stream and gathers from it reads only old values: new ones go to a
    second array, and the two are swapped at the end. `array` is then another array than before:
    do not keep it.

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
            For vectors, with their length: ``(np.float32, 3)``.
        name : str, optional
        """
        return cls(np.zeros(count, dtype), name=name)

    @property
    def label(self) -> str:
        """Its name in errors."""
        return "stream" if self.name is None else f"stream {self.name!r}"

    @property
    def array(self) -> NDArray[Any]:
        """The current records; not a copy."""
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
            If a conversion would change the kind of number, such as float to int.
        ValueError
            If the shape differs.
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
        """Fold all records by a function of two.

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

    def shares_memory(self, array: NDArray[Any]) -> bool:
        """Whether an array may overlap this stream's memory."""
        return any(
            own is not None and np.may_share_memory(own, array) for own in (self._front, self._back)
        )

    def new_array(self) -> NDArray[Any]:
        """The second array, written by a kernel that gathers from the first."""
        if self._back is None:
            self._back = np.empty_like(self._front)
        return self._back

    def swap(self) -> None:
        """Swap the first and the second array."""
        assert self._back is not None
        self._front, self._back = self._back, self._front
