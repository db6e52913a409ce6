"""Choice of a BVH's layout and traversal on the GPU, by the name of its ``kernel``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures import STRUCTURES, Structure, form_of, structure_class

__all__ = [
    "AUTO",
    "KERNELS",
    "LAYOUTS",
    "LaidOut",
    "Traced",
    "kernel_of",
    "lay_out",
    "search_of",
    "traced_as",
]

#: What kernels are chosen by; see `traced_as`.
Traced = str | type[Structure]

#: Form of structures that have their own layouts and kernels on the device.
LAYOUTS = "cuda kernels"

#: The kernel of ``kernel="auto"``. Speeds have not been measured on a GPU. This one reads the
#: fewest bytes, in a third of the binary kernel's steps, and has the smallest stack: counts are in
#: docs/decisions/0022-bvh-on-cuda.rst.
AUTO = "compressed"

#: Values of the option ``kernel``.
KERNELS = ("auto", "compressed", "binary", "packet", "wide")


class LaidOut(NamedTuple):
    """The input of a traversal, in host memory.

    Attributes
    ----------
    tree : NamedTuple
        Addresses; 0 for empty arrays.
    arrays : mapping of str to ndarray
        The arrays at these addresses.
    """

    tree: Any
    arrays: Mapping[str, NDArray[Any]]


def traced_as(structure: Structure) -> Traced:
    """The name of a structure; its class, if another one is registered by that name.

    Structures of instances, of spheres and height fields, and in float64 are called as those of
    their triangles are, and have kernels of their own: those of the CPU's functions.
    """
    name = structure.name
    if name in STRUCTURES and not isinstance(structure, structure_class(name)):
        return type(structure)
    return name


def kernel_of(structure: Traced, kernel: str) -> str | None:
    """The kernel that traces a structure; None if it has only one.

    Raises
    ------
    TypeError
        If a kernel is given for a structure other than a BVH.
    ValueError
        If the name is unknown, or the kernel is not for the scene's kind.
    """
    if not isinstance(structure, str):
        if kernel not in ("auto", "wide"):
            raise ValueError(
                f"kernel: {kernel!r} on device 'cuda' traces triangles in float32, without "
                "instances; expected 'auto' for this scene"
            )
        return None
    if form_of(structure, LAYOUTS) is None:
        if kernel != "auto":
            raise TypeError(f"{structure}: has no option 'kernel' on device 'cuda'; only 'bvh' has")
        return None
    if kernel not in KERNELS:
        known = ", ".join(map(repr, KERNELS))
        raise ValueError(f"kernel: expected one of {known} on device 'cuda', got {kernel!r}")
    return AUTO if kernel == "auto" else kernel


def search_of(kernel: str) -> tuple[Callable[..., Any], int]:
    """The traversal of a kernel from `kernel_of`, and its stack size in bytes."""
    if kernel == "compressed":
        from raystream.cuda.bvh import compressed, compressed_traversal

        return compressed_traversal.traverse, compressed.STACK_BYTES
    if kernel == "binary":
        from raystream.cuda.bvh import binary, binary_traversal

        return binary_traversal.traverse, binary.STACK_BYTES
    if kernel == "packet":
        from raystream.cuda.bvh import binary, packet_traversal

        return packet_traversal.traverse, binary.STACK_BYTES
    from raystream.structures.bvh import traversal

    return traversal.traverse, traversal.STACK_BYTES


def lay_out(structure: Structure, kernel: str = "auto") -> LaidOut:
    """Convert a structure to the layout that its kernel reads.

    Raises
    ------
    TypeError, ValueError
        See `kernel_of`.
    """
    chosen = kernel_of(traced_as(structure), kernel)
    if chosen is None or chosen == "wide":
        return LaidOut(structure.arrays, structure.memory)
    kind, arrays = _make(chosen, structure)
    places = [array.ctypes.data if array.size else 0 for array in arrays.values()]
    return LaidOut(kind(*map(np.uint64, places)), arrays)


def _make(kernel: str, bvh: Any) -> tuple[Callable[..., Any], Mapping[str, NDArray[Any]]]:
    if kernel == "compressed":
        from raystream.cuda.bvh.compressed import compress

        return compress(bvh.tree)
    # "binary", and "packet", which has the same layout.
    from raystream.cuda.bvh.binary import unfold

    return unfold(bvh.tree)
