"""Each structure as shaders read it."""

from __future__ import annotations

from typing import Any

from raystream.core.choices import DeviceOptions
from raystream.core.triangles import Triangles
from raystream.graphics.errors import GraphicsError
from raystream.graphics.structures.base import ShaderStructure
from raystream.jit.threads import Progress
from raystream.structures import Structure, StructureOptions, form_of, names_with
from raystream.tracer.devices import build_on_cpu

__all__ = ["ShaderStructure", "build_with_shaders", "shader_structure_of"]


def shader_structure_of(structure: Structure) -> ShaderStructure:
    """A structure as shaders read it.

    Raises
    ------
    GraphicsError
        If there are no shaders for it.
    """
    _check_name(structure.name)
    placed: Any = structure
    if placed.triangles.instances is not None:
        # Here, not above: few scenes have instances.
        from raystream.graphics.structures.instances import instanced_structure

        return instanced_structure(placed)
    return form_of(structure.name, "graphics")(structure)


def build_with_shaders(
    structure: StructureOptions,
    triangles: Triangles,
    *,
    progress: Progress | None = None,
    device: DeviceOptions | None = None,
) -> Structure:
    """Build a structure on the CPU; a `tracer.devices.DeviceFactory`.

    Raises
    ------
    GraphicsError
        If there are no shaders for it; nothing is built then.
    """
    _check_name(structure.name)
    return build_on_cpu(structure, triangles, progress=progress, device=device)


def _check_name(name: str) -> None:
    known = names_with("graphics")
    if name not in known:
        listed = ", ".join(map(repr, known))
        raise GraphicsError(f"device 'graphics': supports the structures {listed}, not {name!r}")
