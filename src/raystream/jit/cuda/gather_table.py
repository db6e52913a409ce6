"""Gather tables: gather arrays in device memory, as columns at an address."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    models,
    overload,
    overload_attribute,
    register_model,
)

from raystream.jit.cpu import device
from raystream.jit.user_loops import fault

__all__ = ["MAX_DIMENSIONS", "gather_table_at"]

#: Maximum number of dimensions of an index.
MAX_DIMENSIONS = 3


class GatherTableType(types.Type):
    """The type of a table whose records are read by index.

    Parameters
    ----------
    load : numba type
        Of the device function (base, capacity, i) that reads record i.
    dimension_count : int
        Number of dimensions of an index.
    """

    def __init__(self, load: Any, dimension_count: int) -> None:
        self.load, self.dimension_count = load, dimension_count
        super().__init__(f"Table({load}, {dimension_count})")

    @property
    def members(self) -> list[tuple[str, Any]]:
        """Address, capacity in records, and shape."""
        shape = types.UniTuple(types.int64, self.dimension_count)
        return [("base", types.uint64), ("capacity", types.uint64), ("shape", shape)]


@register_model(GatherTableType)
class _TableModel(models.StructModel):
    def __init__(self, manager, table):
        super().__init__(manager, table, table.members)


@intrinsic
def gather_table_at(typing_context: Any, base: Any, capacity: Any, shape: Any, load: Any) -> Any:
    """A table of records at an address, read as ``table[i]`` or ``table[i, j]``.

    Parameters
    ----------
    base, capacity : uint64
    shape : tuple of int64
    load : device function
        ``load(base, capacity, i)`` reads record i, a uint64.
    """
    made = GatherTableType(load, len(shape))

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        packed = cgutils.create_struct_proxy(made)(context, builder)
        for (name, _), value in zip(made.members, arguments, strict=False):
            setattr(packed, name, value)
        return packed._getvalue()

    return made(base, capacity, shape, load), generate


def _member(name: str) -> Any:
    @intrinsic
    def read(typing_context: Any, table: Any) -> Any:
        kind = dict(table.members)[name]

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            packed = cgutils.create_struct_proxy(table)(context, builder, value=arguments[0])
            return getattr(packed, name)

        return kind(table), generate

    return read


@device
def _place(index, length):
    """An index from 0; negative ones count from the end."""
    signed = np.int64(index)
    return np.uint64(signed + length if signed < 0 else signed)


_base, _capacity, _shape_of = map(_member, ("base", "capacity", "shape"))


@overload(operator.getitem)
def _read(table, index):
    if not isinstance(table, GatherTableType):
        return None
    parts = index.types if isinstance(index, types.BaseTuple) else (index,)
    count = table.dimension_count
    if len(parts) != count or not all(isinstance(one, types.Integer) for one in parts):
        raise fault(
            f"a gather array is read at {count} integer(s), one record at a time; the index given "
            f"is {index}"
        )
    load = table.load.dispatcher

    def read_1(table, index):
        return load(_base(table), _capacity(table), _place(index, _shape_of(table)[0]))

    def read_2(table, index):
        shape = _shape_of(table)
        row = _place(index[0], shape[0]) * np.uint64(shape[1]) + _place(index[1], shape[1])
        return load(_base(table), _capacity(table), row)

    def read_3(table, index):
        shape = _shape_of(table)
        row = _place(index[0], shape[0]) * np.uint64(shape[1]) + _place(index[1], shape[1])
        row = row * np.uint64(shape[2]) + _place(index[2], shape[2])
        return load(_base(table), _capacity(table), row)

    return {1: read_1, 2: read_2, 3: read_3}[count]


@overload(len)
def _length(table):
    if isinstance(table, GatherTableType):
        return lambda table: _shape_of(table)[0]
    return None


@overload_attribute(GatherTableType, "shape")
def _shape(table):
    return lambda table: _shape_of(table)
