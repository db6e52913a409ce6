"""SoaLayout: records of a stream in GPU memory as a structure of arrays, for coalesced access.

On the CPU the numbers of a record are adjacent. Here neighbouring threads, which have neighbouring
records, read neighbouring numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.simd import load, store
from raystream.streams.layout import Layout, find_layout

__all__ = ["NAMES", "SoaLayout", "capacity_of"]

#: Columns begin at multiples of this number of records, which aligns their numbers.
_ROUND = 256

#: Names in the source that `SoaLayout` generates.
NAMES: dict[str, Any] = {
    "load": load,
    "store": store,
    "unsigned": np.uint64,
    **{
        name: getattr(np, name)
        for name in (
            *("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
            *("float32", "float64"),
        )
    },
}


def capacity_of(count: int) -> int:
    """Records to allocate for `count` records."""
    return -(-max(count, 1) // _ROUND) * _ROUND


class _Column(NamedTuple):
    """One number of each record: its type, and the bytes that precede it in a record."""

    dtype: np.dtype[Any]
    before: int


class SoaLayout:
    """How records are stored in GPU memory, and the source that reads and writes them.

    Parameters
    ----------
    layout : Layout

    Attributes
    ----------
    byte_count : int
        Bytes per record.

    Raises
    ------
    TypeError
        If it has complex numbers.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self._columns: list[_Column] = []
        before = 0
        for dtype in _dtypes(layout):
            if dtype.kind == "c":
                raise TypeError("device 'cuda': streams cannot be complex; use two real numbers")
            self._columns.append(_Column(dtype, before))
            before += dtype.itemsize
        self.byte_count = before

    @classmethod
    def of(cls, dtype: np.dtype[Any]) -> SoaLayout:
        """The layout of records of a dtype."""
        return cls(find_layout("stream", np.empty(0, dtype), vectors=False))

    def load(self, base: str, capacity: str, i: str, record: str) -> str:
        """The expression for a record.

        Parameters
        ----------
        base, capacity, i : str
            Expressions, uint64: the address of the first column, the allocated records, and the
            index of the record.
        record : str
            Name of the layout's NamedTuple.
        """
        at = _places(base, capacity, i)
        read = iter([_load(one, at(one)) for one in self._columns])
        layout = self.layout
        if layout.dtype.names is None:
            return _tuple(list(read)) if layout.component_count else next(read)
        fields = []
        for name in layout.dtype.names:
            length = _length(layout.dtype[name])
            fields.append(_tuple([next(read) for _ in range(length)]) if length else next(read))
        return f"{record}({', '.join(fields)})"

    def store(self, base: str, capacity: str, i: str, value: str) -> list[str]:
        """The statements that write a record; see `load`."""
        at = _places(base, capacity, i)
        return [
            f"store({at(one)}, {_stored(one)}({part}))"
            for one, part in zip(self._columns, self._parts(value), strict=True)
        ]

    def copy(self, target: str, source: str, capacity: str, i: str) -> list[str]:
        """The statements that copy a record from other columns of this layout."""
        to, from_ = _places(target, capacity, i), _places(source, capacity, i)
        return [f"store({to(one)}, load({_stored(one)}, {from_(one)}))" for one in self._columns]

    def upload(self, gpu: Gpu, name: str, records: NDArray[Any]) -> DeviceArray:
        """Copy records to a device."""
        memory = np.zeros(self.byte_count * capacity_of(len(records)), np.uint8)
        for one, column in zip(self._columns, self._views(memory, len(records)), strict=True):
            column[:] = self._of(records, one)
        return gpu.upload(name, memory)

    def read(self, memory: DeviceArray, records: NDArray[Any]) -> None:
        """Copy records from a device."""
        columns = self._views(memory.host(), len(records))
        for one, column in zip(self._columns, columns, strict=True):
            self._of(records, one)[...] = column

    def empty(self, gpu: Gpu, name: str, count: int) -> DeviceArray:
        """Allocate memory for `count` records."""
        return gpu.empty(name, self.byte_count * capacity_of(count), np.uint8)

    def _parts(self, value: str) -> list[str]:
        """Expressions for the numbers of a record."""
        layout = self.layout
        if layout.component_count:
            return [f"{value}[{k}]" for k in range(layout.component_count)]
        if layout.dtype.names is None:
            return [value]
        parts = []
        for k, name in enumerate(layout.dtype.names):
            length = _length(layout.dtype[name])
            parts += [f"{value}[{k}][{j}]" for j in range(length)] or [f"{value}[{k}]"]
        return parts

    def _views(self, memory: NDArray[np.uint8], count: int) -> list[NDArray[Any]]:
        """Views of the columns of `count` records."""
        capacity, views = capacity_of(count), []
        for dtype, before in self._columns:
            begin = before * capacity
            views.append(memory[begin : begin + dtype.itemsize * count].view(dtype))
        return views

    def _of(self, records: NDArray[Any], one: _Column) -> NDArray[Any]:
        """A view of one number of all records."""
        k, layout = self._columns.index(one), self.layout
        if layout.component_count:
            return records[:, k]
        if layout.dtype.names is None:
            return records
        for name in layout.dtype.names:
            length = _length(layout.dtype[name])
            if k < max(length, 1):
                return records[name][:, k] if length else records[name]
            k -= max(length, 1)
        raise AssertionError("a column is of some field")


def _places(base: str, capacity: str, i: str) -> Callable[[_Column], str]:
    """The address of a record's number in a column, as an expression."""

    def at(one: _Column) -> str:
        column = f"{base} + {capacity} * unsigned({one.before})" if one.before else base
        return f"{column} + {i} * unsigned({one.dtype.itemsize})"

    return at


def _load(one: _Column, at: str) -> str:
    read = f"load({_stored(one)}, {at})"
    return f"({read} != uint8(0))" if one.dtype.kind == "b" else read


def _stored(one: _Column) -> str:
    """Name of the type in memory."""
    return "uint8" if one.dtype.kind == "b" else one.dtype.name


def _dtypes(layout: Layout) -> list[np.dtype[Any]]:
    """Types of a record's numbers."""
    if layout.dtype.names is None:
        return [layout.dtype] * max(1, layout.component_count)
    fields = [layout.dtype[name] for name in layout.dtype.names]
    return [field.base for field in fields for _ in range(max(1, _length(field)))]


def _length(field: np.dtype[Any]) -> int:
    return field.shape[0] if field.shape else 0


def _tuple(parts: Sequence[str]) -> str:
    return f"({', '.join(parts)},)"
