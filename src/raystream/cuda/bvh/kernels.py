"""Choice of a BVH's layout and traversal on the GPU: binary nodes, or the structure's own."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures import STRUCTURES, Structure, form_of, structure_class

#: What kernels are chosen by; see `traced_as`.
Traced = str | type[Structure]

#: Form of structures that have their own layouts and kernels on the device: a module with
#: ``lay_out(structure)``, a `LaidOut`, and for that layout the structure's ``traverse`` and
#: ``stack_bytes``; those of `_MODULES` also its ``point_search``.
LAYOUTS = "cuda kernels"

#: These modules for structures that are not known by a name of their own.
_MODULES = {
    "InstancedBvh": "raystream.cuda.bvh.instances",
    "PrimitiveBvh": "raystream.cuda.bvh.primitives",
    "Float64Bvh": "raystream.cuda.bvh.float64",
}


class LaidOut(NamedTuple):
    """The input of a traversal, in host memory.

    Attributes
    ----------
    tree : NamedTuple
        As `Structure.view`. Addresses; 0 for empty arrays.
    arrays : mapping of str to ndarray
        The arrays at these addresses.
    nested : callable
        Makes the copies of `Structure.nested.arrays`.
    """

    tree: Any
    arrays: Mapping[str, NDArray[Any]]
    nested: Callable[[], Sequence[NDArray[Any]]]


def traced_as(structure: Structure) -> Traced:
    """The name of a structure; its class, if another one is registered by that name.

    Structures of instances, of spheres and height fields, and in float64 are called as those of
    their triangles are, and have kernels of their own.
    """
    name = structure.name
    if name in STRUCTURES and not isinstance(structure, structure_class(name)):
        return type(structure)
    return name


def layout_of(made: Traced) -> Any:
    """The module of a structure's layout of binary nodes; None if its own layout is traced."""
    if isinstance(made, str):
        return form_of(made, LAYOUTS)
    place = _MODULES.get(made.__name__)
    return importlib.import_module(place) if place else None


def lay_out(structure: Structure, *, is_own: bool = False) -> LaidOut:
    """Convert a structure to the layout that its kernel reads; with `is_own`, leave it as it is."""
    layout = None if is_own else layout_of(traced_as(structure))
    if layout is None:
        return with_arrays(structure, {})
    return layout.lay_out(structure)


def with_arrays(structure: Structure, arrays: Mapping[str, NDArray[Any]]) -> LaidOut:
    """A structure with other arrays in place of some of its own."""
    held = structure.view
    places = {
        name: np.uint64(one.ctypes.data if one.size else 0)
        for name, one in arrays.items()
        if name in held._fields
    }
    every = {**structure.arrays, **arrays}
    return LaidOut(held._replace(**places), every, lambda: structure.nested.arrays)
