"""A structure's traversal as fragment programs."""

from __future__ import annotations

from typing import NamedTuple

from raystream.graphics.streams.kernel import FragmentKernel
from raystream.machines.records import RayState

__all__ = ["FOUND", "PLACE", "STREAMS", "TraversalKernels", "with_shade"]

#: What kernels write, in the order of their targets: see fragment/targets.wgsl.
STREAMS = ("state", "found", "place", "span")

#: Where a ray is, and what it has found. Kernels that count or keep hits write the count to
#: "state", which all write anyway.
PLACE = ("state", "place", "span")
FOUND = ("state", "found")

_SHADE = FragmentKernel(
    "shade",
    "shade",
    state=RayState.SHADING,
    next_states=(RayState.DONE,),
    reads=("wanted", *FOUND),
    writes=("state",),
)


class TraversalKernels(NamedTuple):
    """A structure's traversal as kernels.

    Attributes
    ----------
    shader : str
        The file with their functions.
    kernels : tuple of FragmentKernel
        With the names, the states and the order of `machines.steps`: the one that begins comes
        first, and shading last.
    """

    shader: str
    kernels: tuple[FragmentKernel, ...]


def with_shade(shader: str, *kernels: FragmentKernel) -> TraversalKernels:
    """The kernels of a traversal, and the one that hands hits over."""
    return TraversalKernels(shader, (*kernels, _SHADE))
