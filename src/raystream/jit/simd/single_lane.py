"""Single-lane copies of functions of vectors: the CPU's source for a thread of a GPU.

A thread is a lane already: with 16 lanes each, threads would do 16 times the work in 16 times the
registers. So a function and its callees are compiled again, with vectors of one lane where the
source says 16. Lanes do not depend on each other, so the bits are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.copies import Copies
from raystream.jit.simd.types import VECTORS, VectorType, refuse

#: Width of the vectors that become single lanes.
_WIDE = 16


@intrinsic
def lane_count(typing_context: Any, x: Any) -> Any:
    """Number of lanes of a vector, int64: for loops over lanes."""
    if not isinstance(x, VectorType):
        refuse("lane_count", "a vector", x)
    count = ir.Constant(ir.IntType(64), x.lane_count)
    return types.int64(x), lambda context, builder, signature, arguments: count


def single_lane(
    function: Callable[..., Any],
    instead: Mapping[Callable[..., Any], Callable[..., Any]] | None = None,
) -> Callable[..., Any]:
    """Copy a device function, with vectors of one lane instead of 16.

    Parameters
    ----------
    function : compiled function
        By `jit.cpu.device` or `device_call`, in a module of raystream. Callees with global names
        are copied, too; attributes of modules are not.
    instead : mapping, optional
        Replacements of callees, such as those that write to 16 places.

    Returns
    -------
    compiled function
        The function itself, if nothing changes.

    Raises
    ------
    TypeError
        If it is not compiled, or is a closure.
    """
    return Copies("of_one_lane", instead or {}, _narrow).of(function)


def _narrow(value: Any) -> Any:
    is_wide = isinstance(value, VectorType) and value.lane_count == _WIDE
    return VECTORS[value.kind, 1] if is_wide else value
