"""Acceleration structures, one folder each, and the registry of their names.

A folder's ``options.py`` describes the structure to the rest of the package, and registers it. All
of these are imported here and are cheap; builders and traversals are imported on demand.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING, Any

from raystream.structures.registry import (
    STRUCTURES,
    StructureOptions,
    build_structure,
    builder_for,
    form_of,
    names_with,
    options_of,
    register_structure,
    structure_class,
)

if TYPE_CHECKING:
    from raystream.structures.base import Structure

__all__ = [
    "STRUCTURES",
    "Structure",
    "StructureOptions",
    "build_structure",
    "builder_for",
    "form_of",
    "names_with",
    "options_of",
    "register_structure",
    "structure_class",
]

for _found in pkgutil.iter_modules(__path__):
    if _found.ispkg:
        importlib.import_module(f"{__name__}.{_found.name}.options")

# The default first, then by name, in whatever order they were imported.
for _name in sorted(STRUCTURES, key=lambda name: (name != "bvh", name)):
    STRUCTURES[_name] = STRUCTURES.pop(_name)


def __getattr__(name: str) -> Any:
    if name != "Structure":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from raystream.structures.base import Structure

    return Structure
