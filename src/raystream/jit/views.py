"""Typed views: records in memory, read and written by field names.

In a module::

    Slot = view([("inv", "f4", 3), ("t_min", "f4"), ("planes", "f4", (6, 8))])

In a kernel::

    slot = Slot(address)  # a record at an address
    slot = Slot(address, row)  # a record of an array of them
    x, y, z = slot.inv  # three numbers: a tuple
    slot.t_min = x  # one number
    low = slot.planes[axis]  # a row of eight numbers: f32x8

The shape of a field decides its type. Without a shape, or with (1,), it is a number, or the view of
a nested record. With one dimension it is a vector, if `jit.simd` has one of this length, else a
tuple. With more dimensions it is an array of those, indexed by uint64 in all dimensions but the
last; shape (4, 1) is four numbers by index.

A view is only a pointer: nothing is checked, and it keeps no memory alive. It is a pointer rather
than an integer so that LLVM knows that fields of one record do not overlap: the BVH's interleaved
kernel has 3,365 instructions where loads and stores at computed addresses had 3,409 (AVX-512), and
compiles in 2.6 s rather than 3.0.
"""

from __future__ import annotations

import hashlib
import operator
from collections.abc import Callable
from math import prod
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core.typing.templates import (
    AbstractTemplate,
    AttributeTemplate,
    infer_getattr,
    infer_global,
    signature,
)
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
)

from raystream.jit.simd.nvvm import is_cuda
from raystream.jit.simd.types import VECTORS, VectorType, llvm_type, refuse

_I64 = ir.IntType(64)
_BYTE_POINTER = ir.IntType(8).as_pointer()

#: Vector kinds by the NumPy typestr of a lane.
_LANES = {"<f4": "f32", "<f8": "f64", "<i4": "i32", "<i8": "i64", "<u4": "u32"}


class ViewType(types.Type):
    """The type of a record at an address. Its name is a digest of its fields."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.record = dtype
        assert dtype.fields is not None
        fields = [(name, str(field[0]), field[1]) for name, field in dtype.fields.items()]
        digest = hashlib.sha256(f"{fields} {dtype.itemsize}".encode()).hexdigest()
        super().__init__(f"View({digest[:16]})")


class RowsType(types.Type):
    """The type of a field with several dimensions."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        assert dtype.subdtype is not None
        self.base, self.shape = dtype.subdtype
        super().__init__(f"Rows({self.base.str}, {self.shape})")

    @property
    def row(self) -> types.Type:
        """The type of one row."""
        return _field_type(np.dtype((self.base, self.shape[-1:])))


@register_model(ViewType)
@register_model(RowsType)
class _PointerModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Any) -> None:
        super().__init__(manager, type_, _BYTE_POINTER)


def view(fields: Any) -> Callable[..., Any]:
    """Make the constructor of a view for kernels: ``(address)`` or ``(address, row)``.

    Parameters
    ----------
    fields : dtype_like
        Names, types and shapes. Each field must be aligned to the size of its numbers, and the
        record's size be a multiple of each of these: fill gaps with fields.

    Raises
    ------
    ValueError
        If a field is not aligned, or has rows of records.
    """
    made = ViewType(np.dtype(fields))
    size = made.record.itemsize
    assert made.record.fields is not None
    for name, (field, offset, *_) in made.record.fields.items():
        if offset % field.base.alignment or size % field.base.alignment:
            raise ValueError(f"field {name!r}: not aligned to {field.base.alignment} bytes")
        if field.shape and field.base.fields:
            raise ValueError(f"field {name!r}: rows of records are not supported; use a view")

    @intrinsic
    def view_at(typing_context: Any, address: Any, row: Any = 0) -> Any:
        """View a record at an address, or of an array at an address."""
        index = types.uint64 if isinstance(row, int) else row  # an int: the default
        if address != types.uint64 or index != types.uint64:
            refuse("a view", "a uint64 as address, and one as row", address, row)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            at = builder.add(arguments[0], builder.mul(arguments[1], _I64(size)))
            return builder.inttoptr(at, _BYTE_POINTER)

        return made(address, index), generate

    return view_at


@intrinsic
def address_of(typing_context: Any, one: Any) -> Any:
    """The address of a view or of rows."""
    if not isinstance(one, ViewType | RowsType):
        refuse("address_of", "a view, or rows of one", one)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ptrtoint(arguments[0], _I64)

    return types.uint64(one), generate


def _field_type(dtype: np.dtype[Any]) -> Any:
    """The type of a field in kernels."""
    base, shape = dtype.subdtype or (dtype, ())
    if len(shape) > 1:
        return RowsType(dtype)
    number = ViewType(base) if base.fields else from_dtype(base)
    if shape in ((), (1,)):
        return number
    return VECTORS.get((_LANES.get(base.str, ""), shape[0])) or types.UniTuple(number, shape[0])


def _offset(builder: Any, pointer: Any, byte_count: Any) -> Any:
    # Not "inbounds", which would promise that neither pointer is null; see `memory.pointer_to`.
    return builder.gep(pointer, [byte_count])


def _pointer_to(context: Any, builder: Any, pointer: Any, type_: Any) -> tuple[Any, int]:
    """A typed pointer, and the alignment of one number of the type."""
    if not is_cuda(builder):
        set.add(builder.function.attributes, "null_pointer_is_valid")
    if isinstance(type_, VectorType):
        return builder.bitcast(pointer, llvm_type(type_).as_pointer()), type_.element.bitwidth // 8
    value = context.get_data_type(type_)
    return builder.bitcast(pointer, value.as_pointer()), max(type_.bitwidth // 8, 1)


def _load(context: Any, builder: Any, type_: Any, pointer: Any) -> Any:
    if isinstance(type_, ViewType | RowsType):
        return pointer
    if isinstance(type_, types.UniTuple):
        step = type_.dtype.bitwidth // 8
        places = [_offset(builder, pointer, _I64(k * step)) for k in range(len(type_))]
        parts = [_load(context, builder, type_.dtype, place) for place in places]
        return context.make_tuple(builder, type_, parts)
    typed, alignment = _pointer_to(context, builder, pointer, type_)
    value = builder.load(typed)
    value.align = alignment
    return value


def _store(context: Any, builder: Any, type_: Any, pointer: Any, value: Any) -> None:
    if isinstance(type_, ViewType | RowsType):
        refuse("assignment to a view", "numbers, vectors or tuples of numbers", type_)
    if isinstance(type_, types.UniTuple):
        step = type_.dtype.bitwidth // 8
        for k in range(len(type_)):
            part = builder.extract_value(value, k)
            _store(context, builder, type_.dtype, _offset(builder, pointer, _I64(k * step)), part)
        return
    typed, alignment = _pointer_to(context, builder, pointer, type_)
    builder.store(value, typed).align = alignment


@infer_getattr
class _Fields(AttributeTemplate):
    key = ViewType

    def generic_resolve(self, one: ViewType, name: str) -> Any:
        field = one.record.fields.get(name)  # type: ignore[union-attr]
        return None if field is None else _field_type(field[0])


@lower_getattr_generic(ViewType)
def _get_field(context: Any, builder: Any, one: Any, pointer: Any, name: str) -> Any:
    dtype, offset, *_ = one.record.fields[name]
    return _load(context, builder, _field_type(dtype), _offset(builder, pointer, _I64(offset)))


@lower_setattr_generic(ViewType)
def _set_field(context: Any, builder: Any, call: Any, arguments: Any, name: str) -> None:
    dtype, offset, *_ = call.args[0].record.fields[name]
    field = _field_type(dtype)
    value = context.cast(builder, arguments[1], call.args[1], field)
    _store(context, builder, field, _offset(builder, arguments[0], _I64(offset)), value)


def _are_indices(rows: Any, index: Any) -> bool:
    indices = tuple(index) if isinstance(index, types.BaseTuple) else (index,)
    return len(indices) == len(rows.shape) - 1 and all(one == types.uint64 for one in indices)


@infer_global(operator.getitem)
class _GetRow(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        if isinstance(arguments[0], RowsType) and _are_indices(*arguments):
            return signature(arguments[0].row, *arguments)
        return None


@infer_global(operator.setitem)
class _SetRow(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        if isinstance(arguments[0], RowsType) and _are_indices(*arguments[:2]):
            return signature(types.none, *arguments[:2], arguments[0].row)
        return None


def _row_pointer(builder: Any, call: Any, arguments: Any) -> Any:
    rows, index = call.args[:2]
    numbers = [arguments[1]]
    if isinstance(index, types.BaseTuple):
        numbers = [builder.extract_value(arguments[1], k) for k in range(len(index))]
    pointer = arguments[0]
    for k, number in enumerate(numbers, 1):
        step = prod(rows.shape[k:]) * rows.base.itemsize
        pointer = _offset(builder, pointer, builder.mul(number, _I64(step)))
    return pointer


@lower_builtin(operator.getitem, RowsType, types.Any)
def _get_row(context: Any, builder: Any, call: Any, arguments: Any) -> Any:
    return _load(context, builder, call.return_type, _row_pointer(builder, call, arguments))


@lower_builtin(operator.setitem, RowsType, types.Any, types.Any)
def _set_row(context: Any, builder: Any, call: Any, arguments: Any) -> None:
    pointer = _row_pointer(builder, call, arguments)
    _store(context, builder, call.args[2], pointer, arguments[2])
