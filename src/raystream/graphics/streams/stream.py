"""Streams on the graphics device: records in textures, which kernels draw to and read."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from raystream.graphics.adapters import OpenDevice, open_device
from raystream.graphics.error_scope import guarded
from raystream.graphics.errors import GraphicsError
from raystream.graphics.textures import Texture
from raystream.streams.record_stream import RecordStream, label_of, native_records

#: Widths are at least this, so that rows can be copied without padding.
_MIN_WIDTH = 64

_KINDS = {"float32": "float", "int32": "sint", "uint32": "uint"}

#: Channels of a texture, by components of a record: no format has three.
_CHANNELS = {1: "r", 2: "rg", 3: "rgba", 4: "rgba"}


class Stream(RecordStream):
    """Records of one type in a texture, which kernels read or write in order.

    Parameters
    ----------
    values : array_like
        Shape (N,) for numbers, (N, 2), (N, 3) or (N, 4) for vectors: float32, int32 or uint32.
        The values are copied to the device.
    dtype : dtype, optional
        Converts the values.
    name : str, optional
        Name in errors and counters [default: a kernel's name for it].
    adapter : str or OpenDevice, optional
        A part of an adapter's name [default: as for ``Tracer(device="graphics")``].

    Raises
    ------
    GraphicsError
        If there is no adapter, or the records do not fit in a texture.
    TypeError
        If shaders cannot compute with the dtype.
    ValueError
        If the shape is not supported.

    Notes
    -----
    A record is a texel: record i lies in column ``i % width`` and row ``i // width``, where the
    width is a power of two. A kernel that writes a stream and reads it draws to a second texture,
    and the two are swapped at the end.

    Comparing a stream with a number gives a `Condition`, not an array.

    Examples
    --------
    >>> import numpy as np
    >>> from raystream.graphics.streams import Stream
    >>> state = Stream(np.array([0, 2, 2], np.int32))  # doctest: +SKIP
    >>> len(state), state.dtype, (state == 2).count()  # doctest: +SKIP
    (3, dtype('int32'), 2)
    """

    def __init__(
        self,
        values: Any,
        dtype: DTypeLike | None = None,
        *,
        name: str | None = None,
        adapter: str | OpenDevice | None = None,
    ) -> None:
        label = label_of(name)
        array = native_records(label, values, dtype)
        super().__init__(array, name)
        if self.dtype.name not in _KINDS:
            raise TypeError(
                f"{label}: shaders do not compute with dtype {self.dtype}; use float32, int32 or "
                "uint32"
            )
        if array.ndim == 2 and not 2 <= array.shape[1] <= 4:
            raise ValueError(
                f"{label}: expected shape (N,) or, for vectors, (N, 2) to (N, 4), got {array.shape}"
            )
        self.opened: OpenDevice = (
            adapter if isinstance(adapter, OpenDevice) else open_device(adapter)
        )
        width = max(_MIN_WIDTH, 1 << max(math.isqrt(max(len(self) - 1, 0)), 1).bit_length())
        width = min(width, 1 << (self.opened.limits["max-texture-dimension-2d"].bit_length() - 1))
        self.size: tuple[int, int] = (width, max(1, -(-len(self) // width)))
        channels = _CHANNELS[self.component_count]
        self.format: str = f"{channels}32{_KINDS[self.dtype.name]}"
        self._shape = array.shape
        with guarded(self.opened):
            self._front = Texture(self.opened, label, self.size, self.format)
        self._back: Texture | None = None
        self._copy: NDArray[Any] | None = None
        self._write(array)

    @classmethod
    def zeros(
        cls,
        count: int,
        dtype: DTypeLike = np.float32,
        *,
        name: str | None = None,
        adapter: str | None = None,
    ) -> Stream:
        """Make a stream of zeros.

        Parameters
        ----------
        count : int
        dtype : dtype
            For vectors, with their length: ``(np.float32, 3)``.
        name, adapter : str, optional
        """
        return cls(np.zeros(count, dtype), name=name, adapter=adapter)

    @property
    def component_count(self) -> int:
        """Numbers of a record: 1 to 4."""
        return self.layout.component_count or 1

    @property
    def array(self) -> NDArray[Any]:
        """A copy of the current records, which cannot be written: use `assign`.

        Waits for the device, unless the records are those that were read last.

        Raises
        ------
        GraphicsError
            If the device fails.
        """
        if self._copy is None:
            with guarded(self.opened):
                texels = self._front.read()
            records = texels.reshape(-1, texels.shape[2])[: len(self), : self.component_count]
            self._copy = np.ascontiguousarray(records).reshape(self._shape)
            self._copy.flags.writeable = False
        return self._copy

    def assign(self, values: Any) -> None:
        """Replace all records.

        Parameters
        ----------
        values : array_like
            Of the stream's shape, or one record for all.

        Raises
        ------
        GraphicsError
            If the device fails.
        TypeError
            If a conversion would change the kind of number, such as float to int.
        ValueError
            If the shape differs.
        """
        records = np.empty(self._shape, self.dtype)
        try:
            np.copyto(records, values, casting="same_kind")
        except (TypeError, ValueError) as error:
            raise type(error)(f"{self.label}: {error}") from error
        self._write(records)

    @property
    def texture(self) -> Texture:
        """The texture with the current records."""
        return self._front

    def target(self, *, is_read: bool) -> Texture:
        """The texture that a kernel draws to: the second one, if it reads this stream."""
        self._copy = None
        if not is_read:
            return self._front
        if self._back is None:
            self._back = Texture(self.opened, self.label, self.size, self.format)
        return self._back

    def swap(self) -> None:
        """Swap the first and the second texture."""
        assert self._back is not None
        self._copy = None
        self._front, self._back = self._back, self._front

    def _write(self, records: NDArray[Any]) -> None:
        self._copy = None
        width, height = self.size
        channels, components = len(self.format.partition("32")[0]), self.component_count
        texels = np.zeros((height * width, channels), self.dtype)
        texels[: len(self), :components] = records.reshape(len(self), components)
        with guarded(self.opened):
            self._front.write(texels.reshape(height, width, channels))


def check_device(label: str, stream: Stream, opened: OpenDevice) -> None:
    """Raise GraphicsError if a stream is on another device."""
    if stream.opened is not opened:
        raise GraphicsError(
            f"{label}: is on {stream.opened.adapter}, but the kernel's other streams are on "
            "another adapter, or on this one opened at another time; make all of them again"
        )
