"""Gather arrays: arrays that users' functions read by index in compiled loops."""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    models,
    overload,
    overload_attribute,
    register_model,
)

from raystream.jit.user_loops import fault

__all__ = ["counted_gather", "plain_gather"]


class GatherType(types.Type):
    """The type of an array whose records are read by index.

    Parameters
    ----------
    array : numba type
    load : numba type
        Of the device function (array, index) that reads a record.
    index_count : int
        Number of dimensions of an index.
    inside : numba type, optional
        Of the device function (array, index) that checks bounds. If given, reads are counted
        and indices checked.
    slot : int
        Index of the array's counter.
    name : str
        For errors.
    """

    def __init__(self, array, load, index_count, inside=None, slot=0, name=""):
        self.array, self.load, self.index_count = array, load, index_count
        self.inside, self.slot, self.label = inside, slot, name
        super().__init__(f"GatherArray({array}, {load}, {index_count}, {inside}, {slot}, {name!r})")

    @property
    def members(self):
        counts = types.Array(types.int64, 1, "C")
        return [("array", self.array), *([("counts", counts)] if self.inside else [])]


@register_model(GatherType)
class _GatherModel(models.StructModel):
    def __init__(self, manager, gather):
        super().__init__(manager, gather, gather.members)


@cache
def plain_gather(index_count: int) -> Callable[..., Any]:
    """Make a function (array, load) that gives a gather array, without checks."""

    @intrinsic
    def gather(typing_context, array, load):
        made = GatherType(array, load, index_count)

        def generate(context, builder, signature, arguments):
            return _pack(context, builder, made, array=arguments[0])

        return made(array, load), generate

    return gather


@cache
def counted_gather(index_count: int, slot: int, name: str) -> Callable[..., Any]:
    """Make a function (array, load, inside, counts) that gives a checked gather array.

    Reads are counted in ``counts[slot]``; an index out of range raises IndexError.
    """

    @intrinsic
    def gather(typing_context, array, load, inside, counts):
        made = GatherType(array, load, index_count, inside, slot, name)

        def generate(context, builder, signature, arguments):
            return _pack(context, builder, made, array=arguments[0], counts=arguments[3])

        return made(array, load, inside, counts), generate

    return gather


def _pack(context, builder, made, **values):
    """Store the arrays without owners: the loop's arguments keep them alive."""
    packed = cgutils.create_struct_proxy(made)(context, builder)
    for name, kind in made.members:
        array = context.make_array(kind)(context, builder, values[name])
        for owner in ("meminfo", "parent"):
            setattr(array, owner, cgutils.get_null_value(getattr(array, owner).type))
        setattr(packed, name, array._getvalue())
    return packed._getvalue()


def _member(name: str) -> Callable[[Any], Any]:
    @intrinsic
    def read(typing_context, gather):
        kind = dict(gather.members)[name]

        def generate(context, builder, signature, arguments):
            packed = cgutils.create_struct_proxy(gather)(context, builder, value=arguments[0])
            return getattr(packed, name)

        return kind(gather), generate

    return read


_array_of = _member("array")
_counts_of = _member("counts")


@overload(operator.getitem)
def _read(gather, index):
    if not isinstance(gather, GatherType):
        return None
    parts = index.types if isinstance(index, types.BaseTuple) else (index,)
    if len(parts) != gather.index_count or not all(isinstance(p, types.Integer) for p in parts):
        raise fault(
            f"a gather array is read at {gather.index_count} integer(s), one record at a time; "
            f"the index given is {index}"
        )
    load = gather.load.dispatcher
    if gather.inside is None:
        return lambda gather, index: load(_array_of(gather), index)
    return _counted_read(load, gather.inside.dispatcher, gather.slot, gather.label)


def _counted_read(load: Any, inside: Any, slot: int, name: str) -> Callable[..., Any]:
    message = f"gather array {name!r}: index out of range"

    def read(gather, index):
        array = _array_of(gather)
        if not inside(array, index):
            raise IndexError(message)
        _counts_of(gather)[slot] += 1
        return load(array, index)

    return read


@overload(len)
def _length(gather):
    if isinstance(gather, GatherType):
        return lambda gather: _array_of(gather).shape[0]
    return None


@overload_attribute(GatherType, "shape")
def _shape(gather):
    count = gather.index_count
    return lambda gather: _array_of(gather).shape[:count]
