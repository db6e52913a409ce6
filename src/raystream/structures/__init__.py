"""Acceleration structures, one folder each, and the registry of their names."""

from __future__ import annotations

import inspect
from typing import Any

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.base import Structure
from raystream.structures.brute import Brute
from raystream.structures.bvh import Bvh
from raystream.structures.graph import Graph
from raystream.structures.grid import Grid
from raystream.structures.kdtree import KdTree

__all__ = ["STRUCTURES", "Structure", "build_structure"]

#: Structures by the name that `Tracer` takes.
STRUCTURES: dict[str, type[Structure]] = {
    cls.name: cls for cls in (Brute, Bvh, Graph, Grid, KdTree)
}


def build_structure(
    name: str, triangles: Triangles, *, progress: Progress | None = None, **options: Any
) -> Structure:
    """Build a structure by name.

    Parameters
    ----------
    name : str
        A key of `STRUCTURES`.
    triangles : Triangles
    progress : callable, optional
        Called with (triangles placed, triangles).
    **options
        Build options of that structure.

    Raises
    ------
    ValueError
        If the name is unknown, or an option's value is out of range.
    TypeError
        If the structure has no such option.
    """
    if name not in list(STRUCTURES):
        known = ", ".join(repr(known) for known in STRUCTURES)
        raise ValueError(f"structure: expected one of {known}, got {name!r}")
    structure = STRUCTURES[name]
    names = list(inspect.signature(structure).parameters)
    own = [option for option in names if option not in ("triangles", "progress")]
    for option in options:
        if option not in own:
            has = f"it has {', '.join(own)}" if own else "it has none"
            raise TypeError(f"{name}: has no option {option!r}; {has}")
    return structure(triangles, progress=progress, **options)
