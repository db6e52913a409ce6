"""Streams: arrays of records that kernels read or write in order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raystream.streams.condition import Condition
from raystream.streams.record_stream import RecordStream, label_of, native_records


class Stream(RecordStream):
    """Records of one type, which kernels read or write in order.

    Parameters
    ----------
    values : array_like
        Shape (N,) for numbers and for records with fields (a structured dtype); shape (N, k) for
        vectors of k components. The values are copied.
    dtype : dtype, optional
        Converts the values.
    name : str, optional
        Name in errors and counters [default: a kernel's name for it].

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
        array = native_records(label_of(name), values, dtype)
        super().__init__(array, name)
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
    def array(self) -> NDArray[Any]:
        """The current records; not a copy."""
        return self._front

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


def as_condition(where: Any, count: int) -> Condition | None:
    """The argument `where` as a condition.

    Parameters
    ----------
    where : Condition, Stream, array_like or None
        Streams and arrays of bool.
    count : int
        Records that it must have.
    """
    if where is None:
        return None
    if not isinstance(where, Condition):
        stream = where if isinstance(where, Stream) else Stream(where, name="where")
        if stream.layout.shape != "bool":
            raise TypeError(
                "where: expected a comparison such as (state == 2), or booleans, got "
                f"dtype {stream.dtype}"
            )
        where = Condition(stream, "!=", False)
    if len(where.stream) != count:
        raise ValueError(
            f"where: {where.stream.label} has {len(where.stream):,} records, but the kernel's "
            f"streams have {count:,}"
        )
    return where
