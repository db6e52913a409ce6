"""Brute force's kernels: set up, intersect (Foley 2005, section 3)."""

from __future__ import annotations

from raystream.graphics.multipass.kernels.base import FOUND, TraversalKernels, with_shade
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.machines.records import RayState
from raystream.structures.brute.structure import BruteStructure

_RAY = ("origins", "directions")

_KERNELS = with_shade(
    "multipass/brute.wgsl",
    FragmentKernel(
        "set up",
        "set_up",
        state=RayState.STARTING,
        next_states=(RayState.INTERSECTING, RayState.DONE),
        reads=_RAY,
        writes=(*FOUND, "place"),
    ),
    FragmentKernel(
        "intersect",
        "intersect_next",
        state=RayState.INTERSECTING,
        next_states=(RayState.INTERSECTING, RayState.SHADING, RayState.DONE),
        reads=(*_RAY, "wanted", *FOUND, "place"),
        writes=(*FOUND, "place"),
    ),
)


def kernels(_brute: BruteStructure) -> TraversalKernels:
    """The kernels of brute force."""
    return _KERNELS
