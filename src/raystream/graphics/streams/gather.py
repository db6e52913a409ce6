"""Gather arrays on the graphics device: textures that kernels read at any index."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.streams.stream import Stream
from raystream.streams.gather import shape_of_records
from raystream.streams.layout import native_array
from raystream.streams.record_stream import RecordStream


class GatherArray:
    """An array that a kernel reads at any index.

    A kernel's source calls it as a function of i32 indices: ``table(i)`` is one record, or
    ``table(i, j)`` if it has two dimensions. ``table_shape[0]`` is its length as an i32, and
    ``table_shape[1]`` that of the next dimension. Negative indices count from the end. Other
    indices out of range are checked in counted passes only; otherwise, they read some record, or
    0.

    Parameters
    ----------
    values : array_like or Stream
        An array, of float32, int32 or uint32, is copied when a kernel takes it. If a kernel also
        writes the stream, it reads the old records.
    shape : tuple of int, optional
        Reshapes the records, the last index running fastest.
    vectors : bool
        Whether the last axis of an array holds the components of vectors; not for streams.
    name : str, optional
        Name in counters [default: the kernel's name for it].

    Raises
    ------
    TypeError
        If the values are a stream of another device, or not an array.
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
        self._label = "gather array" if name is None else f"gather array {name!r}"
        self.name = name
        self._stream: Stream | None = None
        self._records: NDArray[Any] | None = None
        if isinstance(values, Stream):
            self._stream = values
            self.name = values.name if name is None else name
            found: tuple[int, ...] = (len(values),)
        elif isinstance(values, RecordStream):
            raise TypeError(
                f"{self._label}: is a stream of another device; use raystream.graphics.streams"
            )
        else:
            array = native_array(self._label, values)
            if array.ndim < 1 + vectors:
                raise ValueError(
                    f"{self._label}: expected at least {1 + vectors} dimension(s), got {array.ndim}"
                )
            found = array.shape[: array.ndim - vectors]
            self._records = array.reshape(-1, array.shape[-1]) if vectors else array.reshape(-1)
        self.shape = shape_of_records(self._label, found, shape)

    def stream(self, opened: OpenDevice) -> Stream:
        """The stream that it reads; of an array, a copy on the device."""
        is_elsewhere = self._stream is not None and self._stream.opened is not opened
        if self._records is not None and (self._stream is None or is_elsewhere):
            self._stream = Stream(self._records, name=self.name, adapter=opened)
        assert self._stream is not None
        return self._stream
