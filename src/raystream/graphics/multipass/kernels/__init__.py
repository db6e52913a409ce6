"""Each structure's traversal as fragment programs: the kernels of `machines.steps`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.kernels import brute, grid, kdtree
from raystream.graphics.multipass.kernels.base import STREAMS, TraversalKernels
from raystream.structures import Structure

__all__ = ["KERNELS", "STREAMS", "TraversalKernels", "kernels_of"]

#: By the name of the structure.
KERNELS: dict[str, Callable[[Any], TraversalKernels]] = {
    "brute": brute.kernels,
    "grid": grid.kernels,
    "kdtree": kdtree.kernels,
}


def kernels_of(structure: Structure) -> TraversalKernels:
    """A structure's traversal as fragment programs.

    Raises
    ------
    GraphicsError
        If there are none for it.
    """
    if structure.name not in KERNELS:
        known = ", ".join(map(repr, KERNELS))
        raise GraphicsError(
            f"device 'graphics': machine='multipass' runs the structures {known}, "
            f"not {structure.name!r}; take machine='compute'"
        )
    return KERNELS[structure.name](structure)
