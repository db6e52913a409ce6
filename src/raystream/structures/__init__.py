"""Acceleration structures, one folder each, and the registry of their names."""

from __future__ import annotations

from typing import Any

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.base import Structure
from raystream.structures.brute import Brute
from raystream.structures.bvh import Bvh
from raystream.structures.grid import Grid
from raystream.structures.kdtree import KdTree

__all__ = ["STRUCTURES", "Structure", "build_structure"]

#: Structures by the name that `Tracer` takes.
STRUCTURES: dict[str, type[Structure]] = {cls.name: cls for cls in (Brute, Bvh, Grid, KdTree)}


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
    return STRUCTURES[name](triangles, progress=progress, **options)
