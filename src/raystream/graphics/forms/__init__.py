"""Forms: what shaders get of each structure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.core.triangles import Triangles
from raystream.graphics.errors import GraphicsError
from raystream.graphics.forms import brute, bvh, graph, grid, kdtree
from raystream.graphics.forms.base import Form
from raystream.structures import STRUCTURES, Structure, build_structure

__all__ = ["FORMS", "Form", "build_with_shaders", "form_of"]

#: By the name of the structure.
FORMS: dict[str, Callable[[Any], Form]] = {
    "brute": brute.form,
    "bvh": bvh.form,
    "graph": graph.form,
    "grid": grid.form,
    "kdtree": kdtree.form,
}


def form_of(structure: Structure) -> Form:
    """What shaders get of a structure.

    Raises
    ------
    GraphicsError
        If there are no shaders for it.
    """
    _check_name(structure.name)
    return FORMS[structure.name](structure)


def build_with_shaders(name: str, triangles: Triangles, **options: Any) -> Structure:
    """Build a structure on the CPU; a `machines.devices.DeviceFactory`.

    Raises
    ------
    GraphicsError
        If there are no shaders for it: before it is built.
    """
    if name in STRUCTURES:
        _check_name(name)
    return build_structure(name, triangles, **options)


def _check_name(name: str) -> None:
    if name not in FORMS:
        known = ", ".join(map(repr, FORMS))
        raise GraphicsError(f"device 'graphics': has the structures {known}, not {name!r}")
