"""Linking: kernels that call CUDA's own library for kernels."""

from __future__ import annotations

from typing import Any

from raystream.jit.cuda.compiler import Capability

__all__ = ["SET_CONDITION", "link"]

#: A function of that library, which is linked to kernels that call it.
SET_CONDITION = "cudaGraphSetConditional"


def link(code: Any, capability: Capability) -> Any:
    """Link PTX with CUDA's library for kernels; needs no device."""
    from cuda.core import Linker, LinkerOptions, ObjectCode
    from cuda.pathfinder import find_static_lib

    library = ObjectCode.from_library(find_static_lib("cudadevrt"), name="cudadevrt")
    major, minor = capability
    return Linker(code, library, options=LinkerOptions(arch=f"sm_{major}{minor}")).link("cubin")
