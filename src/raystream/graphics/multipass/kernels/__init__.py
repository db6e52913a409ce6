"""Each structure's traversal as fragment programs: the kernels of `machines.steps`."""

from __future__ import annotations

from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.kernels.base import STREAMS, TraversalKernels
from raystream.structures import Structure, form_of, names_with

__all__ = ["STREAMS", "TraversalKernels", "kernels_of"]


def kernels_of(structure: Structure) -> TraversalKernels:
    """A structure's traversal as fragment programs.

    Raises
    ------
    GraphicsError
        If it is not supported.
    """
    make = form_of(structure.name, "graphics multipass")
    if make is None:
        known = ", ".join(map(repr, names_with("graphics multipass")))
        raise GraphicsError(
            f"device 'graphics': machine='multipass' supports the structures {known}, "
            f"not {structure.name!r}; use machine='compute'"
        )
    return make(structure)
