"""Forms: what shaders get of each structure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.graphics.errors import GraphicsError
from raystream.graphics.forms import brute, bvh, graph, grid, kdtree
from raystream.graphics.forms.base import Form
from raystream.structures import Structure

__all__ = ["FORMS", "Form", "form_of"]

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
    if structure.name not in FORMS:
        known = ", ".join(map(repr, FORMS))
        raise GraphicsError(
            f"device 'graphics': has the structures {known}, not {structure.name!r}"
        )
    return FORMS[structure.name](structure)
