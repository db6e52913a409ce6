"""Single machine operations that Python has no word for."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic

__all__ = ["stay_out_of_line"]


@intrinsic
def stay_out_of_line(typing_context: Any) -> Any:
    """As the first statement of a function: LLVM must call it and never copy it into a caller.

    For long functions that are rarely needed in loops: copies of them cost compile time, and
    registers of the loop.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate
