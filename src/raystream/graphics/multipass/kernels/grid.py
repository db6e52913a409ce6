"""The grid's kernels: set up, traverse, intersect (Purcell 2002, section 3.1)."""

from __future__ import annotations

from raystream.graphics.multipass.kernels.base import FOUND, PLACE, TraversalKernels, with_shade
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.machines.records import RayState
from raystream.structures.grid.structure import GridStructure

_RAY = ("origins", "directions")

_KERNELS = with_shade(
    "multipass/grid.wgsl",
    FragmentKernel(
        "set up",
        "set_up",
        state=RayState.STARTING,
        next_states=(RayState.TRAVERSING, RayState.DONE),
        reads=_RAY,
        writes=("state", "found", "place", "span"),
    ),
    FragmentKernel(
        "traverse",
        "traverse",
        state=RayState.TRAVERSING,
        next_states=(
            RayState.TRAVERSING,
            RayState.INTERSECTING,
            RayState.SHADING,
            RayState.DONE,
        ),
        reads=(*_RAY, "wanted", "found", *PLACE),
        writes=PLACE,
    ),
    FragmentKernel(
        "intersect",
        "intersect_cell",
        state=RayState.INTERSECTING,
        next_states=(
            RayState.INTERSECTING,
            RayState.TRAVERSING,
            RayState.SHADING,
            RayState.DONE,
        ),
        reads=(*_RAY, "wanted", "found", *PLACE),
        writes=(*FOUND, "place", "span"),
    ),
)


def kernels(_grid: GridStructure) -> TraversalKernels:
    """The kernels of a grid, of one level or two."""
    return _KERNELS
