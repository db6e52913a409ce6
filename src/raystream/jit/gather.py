"""Arrays that loops read by index, and what they accept as the result of a user's function."""

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

from raystream.jit.loops import fault

__all__ = ["accept", "counted_gather", "plain_gather"]

#: A dtype's name, or a tuple of such: a vector, the fields of a record, several records.
Shape = str | tuple[Any, ...]


@cache
def accept(shape: Shape, place: str) -> Callable[[Any], Any]:
    """Make a function that takes the result of a user's function, which is not None.

    At compile time it checks that the result fits, as NumPy would for an assignment with
    casting "same_kind", except that any integer goes into any other.

    Parameters
    ----------
    shape : str or tuple
        What the result must be.
    place : str
        Where it goes, for the error.
    """

    @intrinsic
    def accepted(typing_context, result):
        given = result.type if isinstance(result, types.Optional) else result
        if given == types.none:
            raise fault(f"it never returns a record for {place}, only None")
        _check(given, shape, place)

        def generate(context, builder, signature, arguments):
            if isinstance(result, types.Optional):
                return context.cast(builder, arguments[0], result, given)
            return arguments[0]

        return given(result), generate

    return accepted


def _check(given: Any, shape: Shape, place: str) -> None:
    if isinstance(shape, tuple):
        if not isinstance(given, types.BaseTuple):
            raise fault(f"it returns {given}, and {place} takes a tuple of {len(shape)}")
        if len(given) != len(shape):
            raise fault(
                f"it returns a tuple of {len(given)}, and {place} takes a tuple of {len(shape)}"
            )
        for part, expected in zip(given.types, shape, strict=True):
            _check(part, expected, place)
        return
    if not _fits(given, shape):
        raise fault(f"it returns {given}, and {place} takes {shape}")


def _fits(given: Any, dtype: str) -> bool:
    """Whether a value may be stored as this dtype."""
    if isinstance(given, types.Boolean):
        return True
    kinds: tuple[Any, ...] = ()
    if dtype.startswith(("int", "uint")):
        kinds = (types.Integer,)
    elif dtype.startswith("float"):
        kinds = (types.Integer, types.Float)
    elif dtype.startswith("complex"):
        kinds = (types.Number,)
    return isinstance(given, kinds)


class GatherType(types.Type):
    """An array whose records are read by index.

    Parameters
    ----------
    array : numba type
    load : numba type
        Of the device function (array, index) that gives a record.
    index_count : int
        Dimensions that an index has.
    inside : numba type, optional
        Of the device function (array, index) that says whether there is such a record. If
        given, reads are counted and indices checked.
    slot : int
        Where in the counts.
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
    """Make a function (array, load) that gives what a user's function indexes."""

    @intrinsic
    def gather(typing_context, array, load):
        made = GatherType(array, load, index_count)

        def generate(context, builder, signature, arguments):
            return _pack(context, builder, made, array=arguments[0])

        return made(array, load), generate

    return gather


@cache
def counted_gather(index_count: int, slot: int, name: str) -> Callable[..., Any]:
    """Make a function (array, load, inside, counts); it counts reads in ``counts[slot]``.

    An index out of range raises IndexError.
    """

    @intrinsic
    def gather(typing_context, array, load, inside, counts):
        made = GatherType(array, load, index_count, inside, slot, name)

        def generate(context, builder, signature, arguments):
            return _pack(context, builder, made, array=arguments[0], counts=arguments[3])

        return made(array, load, inside, counts), generate

    return gather


def _pack(context, builder, made, **values):
    """Borrow the arrays, which the loop's arguments keep alive: reads count no references."""
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
