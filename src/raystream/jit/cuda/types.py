"""Vector types for CUDA's compiler, which has its own table of what Python objects are."""

from __future__ import annotations

from functools import cache
from typing import Any

from raystream.jit.simd.types import VectorClass, VectorType

__all__ = ["register_types"]


@cache
def register_types() -> None:
    """Tell Numba's CUDA compiler what a vector type is; once."""
    from numba.cuda.typing.typeof import typeof_impl

    @typeof_impl.register(VectorType)
    def type_of(value: VectorType, context: Any) -> VectorClass:
        return VectorClass(value)
