"""Structures in a GPU's memory, and the kernels that search them."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from raystream.cuda.threads import ThreadQueries, thread_queries
from raystream.jit.cuda import CudaError, DeviceArray, Gpu
from raystream.structures import Structure

__all__ = ["STRUCTURES", "Resident", "kernels_of", "place"]


def _brute() -> ThreadQueries:
    from raystream.structures.brute.traversal import traverse

    return thread_queries(traverse, 8)


def _bvh() -> ThreadQueries:
    from raystream.structures.bvh.traversal import STACK_BYTES, traverse

    return thread_queries(traverse, STACK_BYTES)


def _graph() -> ThreadQueries:
    from raystream.structures.graph.traversal import STACK_BYTES, traverse

    return thread_queries(traverse, STACK_BYTES)


def _grid() -> ThreadQueries:
    from raystream.structures.grid.traversal import STACK_BYTES, traverse

    return thread_queries(traverse, STACK_BYTES)


def _kdtree() -> ThreadQueries:
    from raystream.structures.kdtree.state import STACK_BYTES
    from raystream.structures.kdtree.traversal import traverse

    return thread_queries(traverse, STACK_BYTES)


#: Those that have kernels, and what makes these.
STRUCTURES = {"brute": _brute, "bvh": _bvh, "graph": _graph, "grid": _grid, "kdtree": _kdtree}


@cache
def kernels_of(name: str) -> ThreadQueries:
    """The kernels of a structure.

    Raises
    ------
    CudaError
        If there are none.
    """
    if name not in STRUCTURES:
        known = ", ".join(map(repr, STRUCTURES))
        raise CudaError(f"device 'cuda': has the structures {known}, not {name!r}")
    return STRUCTURES[name]()


class Resident(NamedTuple):
    """A structure in a GPU's memory.

    Attributes
    ----------
    tree : NamedTuple
        As `Structure.arrays`, with addresses on the device.
    arrays : tuple of DeviceArray
        What is there: to be kept as long as the tree is used.
    """

    tree: Any
    arrays: tuple[DeviceArray, ...]


def place(structure: Structure, gpu: Gpu) -> Resident:
    """Copy what a structure's traversal reads to a device.

    Raises
    ------
    CudaError
        If there is no memory for it.
    """
    tree: Any = structure.arrays
    arrays = {
        name: gpu.upload(f"{structure.name}, {name}", array)
        for name, array in structure.memory.items()
        if getattr(tree, name)  # nothing is at address 0
    }
    addresses = {name: one.address for name, one in arrays.items()}
    return Resident(tree._replace(**addresses), tuple(arrays.values()))
