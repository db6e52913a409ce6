"""The vector types, and conversions of numbers and vectors to them."""

from __future__ import annotations

from typing import Any, NoReturn

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError
from numba.core.typing.templates import AttributeTemplate, infer_getattr, make_callable_template
from numba.extending import lower_builtin, models, register_model, typeof_impl

#: Numba's and LLVM's types of one lane.
ELEMENTS = {
    "f32": (types.float32, ir.FloatType()),
    "f64": (types.float64, ir.DoubleType()),
    "i32": (types.int32, ir.IntType(32)),
    "i64": (types.int64, ir.IntType(64)),
    "u32": (types.uint32, ir.IntType(32)),
    "mask": (types.boolean, ir.IntType(1)),
}


class VectorType(types.Type):
    """The type of a vector or mask; calling it in a kernel makes one.

    ``f32x8(x)`` broadcasts a number; of a vector with as many lanes it converts each (rounding to
    nearest, towards zero from float to integer; NaN, and numbers outside of the integer's range,
    give undefined lanes; int64 to int32 drops the upper bits).

    Attributes
    ----------
    kind : {"f32", "f64", "i32", "i64", "u32", "mask"}
    lane_count : int
    """

    def __init__(self, kind: str, lane_count: int) -> None:
        self.kind = kind
        self.lane_count = lane_count
        separator = "" if kind == "mask" else "x"
        super().__init__(name=f"{kind}{separator}{lane_count}")

    @property
    def element(self) -> Any:
        """Numba's type of one lane."""
        return ELEMENTS[self.kind][0]

    @property
    def is_float(self) -> bool:
        """Whether lanes are floating-point numbers."""
        return self.kind in ("f32", "f64")


def llvm_type(vector: VectorType) -> ir.VectorType:
    """The LLVM type of a vector."""
    return ir.VectorType(ELEMENTS[vector.kind][1], vector.lane_count)


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: VectorType) -> None:
        super().__init__(manager, vector, llvm_type(vector))
        self._is_bit = vector.kind == "mask" and vector.lane_count == 1

    # LLVM for x86 cannot pass a mask of one lane to a function.

    def get_argument_type(self) -> Any:
        return ir.IntType(1) if self._is_bit else super().get_argument_type()

    def as_argument(self, builder: Any, value: Any) -> Any:
        return builder.bitcast(value, ir.IntType(1)) if self._is_bit else value

    def from_argument(self, builder: Any, value: Any) -> Any:
        return builder.bitcast(value, self.get_value_type()) if self._is_bit else value


#: Vectors of one lane are for CUDA's threads; see `single_lane`.
VECTORS = {
    (kind, lanes): VectorType(kind, lanes) for kind in ELEMENTS for lanes in (2, 4, 8, 16, 1)
}


def vector_type(kind: str, lane_count: int) -> VectorType:
    """The vector type of a kind and width, one object for each."""
    return VECTORS[kind, lane_count]


def mask_of(vector: VectorType) -> VectorType:
    """The mask type with a vector's number of lanes."""
    return VECTORS["mask", vector.lane_count]


f32x4, f32x8, f32x16 = (VECTORS["f32", n] for n in (4, 8, 16))
f64x4, f64x8, f64x16 = (VECTORS["f64", n] for n in (4, 8, 16))
i32x4, i32x8, i32x16 = (VECTORS["i32", n] for n in (4, 8, 16))
i64x4, i64x8, i64x16 = (VECTORS["i64", n] for n in (4, 8, 16))
u32x4, u32x8, u32x16 = (VECTORS["u32", n] for n in (4, 8, 16))
mask4, mask8, mask16 = (VECTORS["mask", n] for n in (4, 8, 16))


def constant(vector: VectorType, values: Any) -> ir.Constant:
    """An LLVM constant vector of one value for all lanes, or of a list."""
    if not isinstance(values, list):
        values = [values] * vector.lane_count
    return ir.Constant(llvm_type(vector), values)


def refuse(function: str, wanted: str, *given: Any) -> NoReturn:
    """Raise a typing error that says what a function takes and what it was given."""
    raise TypingError(f"{function} takes {wanted}, not {', '.join(map(str, given))}")


def broadcast(builder: Any, value: Any, lane_count: int) -> Any:
    """An LLVM value in every lane of a vector."""
    vector = ir.VectorType(value.type, lane_count)
    undefined = ir.Constant(vector, ir.Undefined)
    i32 = ir.IntType(32)
    first = builder.insert_element(undefined, value, ir.Constant(i32, 0))
    lanes = ir.Constant(ir.VectorType(i32, lane_count), [0] * lane_count)
    return builder.shuffle_vector(first, undefined, lanes)


# ---- Using a vector type as a function in a kernel.


class VectorClass(types.Callable, types.Opaque):
    """The type of a vector type's name in a kernel."""

    def __init__(self, vector: VectorType) -> None:
        self.instance_type = vector
        super().__init__(f"class({vector.name})")

    @property
    def key(self) -> Any:
        """Two of these with the same vector type are the same type."""
        return self.instance_type

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """The signature of a call with these arguments."""
        return context.resolve_getattr(self, "__call__").get_call_type(context, args, kws)

    def get_call_signatures(self) -> tuple[tuple[Any, ...], bool]:
        """No signatures are known in advance."""
        return (), True

    def get_impl_key(self, signature: Any) -> Any:
        """The key that constructors are registered with."""
        return self.instance_type


register_model(VectorClass)(models.OpaqueModel)


@typeof_impl.register(VectorType)
def _type_of_vector_type(value: VectorType, context: Any) -> VectorClass:
    return VectorClass(value)


@infer_getattr
class _VectorClassAttributes(AttributeTemplate):
    key = VectorClass

    def resolve___call__(self, vector_class: VectorClass) -> Any:
        target = vector_class.instance_type

        def typer(value: Any) -> Any:
            if isinstance(value, types.Integer | types.Float | types.Boolean):
                return target
            if value == target:
                return target
            if isinstance(value, VectorType) and "mask" not in (value.kind, target.kind):
                if value.lane_count != target.lane_count:
                    refuse(str(target), f"vectors of {target.lane_count} lanes", value)
                return target
            lanes = f"{target.lane_count} lanes"
            if target.kind == "mask":
                refuse(str(target), f"a number or a mask of {lanes}", value)
            refuse(str(target), f"a number or a vector of {lanes} (select takes masks)", value)

        return types.Function(make_callable_template(key=target, typer=typer))


def _convert(builder: Any, value: Any, source: VectorType, target: VectorType) -> Any:
    if source == target:
        return value
    to = llvm_type(target)
    if source.is_float and target.is_float:
        grow = target.kind == "f64"
        return builder.fpext(value, to) if grow else builder.fptrunc(value, to)
    if source.is_float:
        return builder.fptoui(value, to) if target.kind == "u32" else builder.fptosi(value, to)
    if target.is_float:
        return builder.uitofp(value, to) if source.kind == "u32" else builder.sitofp(value, to)
    if source.element.bitwidth == target.element.bitwidth:
        return value
    if target.kind != "i64":
        return builder.trunc(value, to)
    return builder.zext(value, to) if source.kind == "u32" else builder.sext(value, to)


def _make_constructor(target: VectorType) -> None:
    @lower_builtin(target, types.Any)
    def construct(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (source,) = signature.args
        (value,) = arguments
        if isinstance(source, VectorType):
            return _convert(builder, value, source, target)
        return broadcast(
            builder, context.cast(builder, value, source, target.element), target.lane_count
        )


for _vector in VECTORS.values():
    _make_constructor(_vector)
