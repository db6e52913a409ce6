"""Foley's kernels: Initialize, Down, Leaf, Intersect, Continue, Up (Foley 2005, section 3.3)."""

from __future__ import annotations

from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.kernels.base import FOUND, PLACE, TraversalKernels, with_shade
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.machines.records import RayState
from raystream.structures.kdtree.structure import KdTreeStructure

_RAY = ("origins", "directions")

_KERNELS = with_shade(
    "multipass/kdtree.wgsl",
    FragmentKernel(
        "initialize",
        "begin_at_root",
        state=RayState.STARTING,
        next_states=(RayState.TRAVERSING, RayState.AT_LEAF, RayState.DONE),
        reads=_RAY,
        writes=("state", "found", "place", "span"),
    ),
    FragmentKernel(
        "down",
        "descend_rays",
        state=RayState.TRAVERSING,
        next_states=(RayState.TRAVERSING, RayState.AT_LEAF, RayState.DONE),
        reads=(*_RAY, *PLACE),
        writes=PLACE,
    ),
    FragmentKernel(
        "leaf",
        "look_at_leaf",
        state=RayState.AT_LEAF,
        next_states=(RayState.INTERSECTING, RayState.CONTINUING),
        reads=("place",),
        writes=("state", "place"),
    ),
    FragmentKernel(
        "intersect",
        "intersect_leaf",
        state=RayState.INTERSECTING,
        next_states=(
            RayState.INTERSECTING,
            RayState.CONTINUING,
            RayState.SHADING,
            RayState.DONE,
        ),
        reads=(*_RAY, "wanted", "found", *PLACE),
        writes=(*FOUND, "place"),
    ),
    FragmentKernel(
        "continue",
        "continue_rays",
        state=RayState.CONTINUING,
        next_states=(
            RayState.TRAVERSING,
            RayState.AT_LEAF,
            RayState.BACKTRACKING,
            RayState.SHADING,
            RayState.DONE,
        ),
        reads=("wanted", "found", *PLACE),
        writes=PLACE,
    ),
    FragmentKernel(
        "up",
        "backtrack_rays",
        state=RayState.BACKTRACKING,
        next_states=(
            RayState.BACKTRACKING,
            RayState.TRAVERSING,
            RayState.AT_LEAF,
            RayState.DONE,
        ),
        reads=(*_RAY, *PLACE),
        writes=PLACE,
    ),
)


def kernels(kdtree: KdTreeStructure) -> TraversalKernels:
    """The kernels of a kd-tree; stackless traversals only.

    Raises
    ------
    GraphicsError
        If its traversal needs one.
    """
    if kdtree.options.traversal in ("stack", "short-stack"):
        raise GraphicsError(
            "device 'graphics': machine='multipass' has no memory for the stacks of rays; use "
            "traversal='restart' or 'backtrack'"
        )
    return _KERNELS
