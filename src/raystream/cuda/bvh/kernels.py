"""Choice of a BVH's layout and traversal on the GPU: binary nodes, or the structure's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures import STRUCTURES, Structure, form_of, structure_class

#: What kernels are chosen by; see `traced_as`.
Traced = str | type[Structure]

#: Form of structures that have their own layouts and kernels on the device.
LAYOUTS = "cuda kernels"


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


def has_binary_layout(structure: Traced) -> bool:
    """Whether the device has another layout of a structure, of binary nodes."""
    return isinstance(structure, str) and form_of(structure, LAYOUTS) is not None


def binary_search() -> tuple[Callable[..., Any], int]:
    """The traversal of binary nodes, and its stack size in bytes."""
    from raystream.cuda.bvh import binary, binary_traversal

    return binary_traversal.traverse, binary.STACK_BYTES


def lay_out(structure: Structure, *, is_own: bool = False) -> LaidOut:
    """Convert a structure to the layout that its kernel reads; with `is_own`, leave it as it is."""
    if is_own or not has_binary_layout(traced_as(structure)):
        return LaidOut(structure.arrays, structure.memory)
    from raystream.cuda.bvh.binary import BinaryAddresses, unfold

    bvh: Any = structure
    arrays = unfold(bvh.tree)
    places = [array.ctypes.data if array.size else 0 for array in arrays.values()]
    return LaidOut(BinaryAddresses(*map(np.uint64, places)), arrays)
