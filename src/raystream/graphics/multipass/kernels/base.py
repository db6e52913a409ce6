"""A structure's traversal as fragment programs."""

from __future__ import annotations

from typing import NamedTuple

from raystream.graphics.streams.kernel import FragmentKernel
from raystream.machines.records import RayState

#: Streams that kernels write, in the order of their render targets: see fragment/targets.wgsl.
STREAMS = ("state", "found", "place", "span")

#: Streams of a ray's traversal state, and of its hits; the number of hits is in "state".
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
        With the names, states and order of `machines.steps`: set-up first, shading last.
    """

    shader: str
    kernels: tuple[FragmentKernel, ...]


def with_shade(shader: str, *kernels: FragmentKernel) -> TraversalKernels:
    """The kernels of a traversal, and shading."""
    return TraversalKernels(shader, (*kernels, _SHADE))
