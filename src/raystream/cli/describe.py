"""Figures about a scene and its structure, as printed by ``raystream info --json``."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.cli.load import triangle_figures
from raystream.kernels.solids import solids_of

if TYPE_CHECKING:
    from raystream.cli.load import Stopwatch
    from raystream.scene.mesh import Mesh
    from raystream.scene.scene import Scene
    from raystream.tracer import Tracer

#: Optional vertex attributes of a mesh.
ATTRIBUTES = ("normals", "colors", "texcoords")


def describe(source: str, tracer: Tracer, watch: Stopwatch) -> dict[str, Any]:
    """Collect the figures printed by ``--json``.

    Returns
    -------
    dict
        ``scene``, ``name``: as requested; as in the file.
        ``triangles``; with instances also ``instances`` and ``instanced_triangles``, those of
        all instances. ``degenerate_triangles``, ``nonfinite_triangles``, ``vertices``.
        ``bounds``: ``low`` and ``high`` of the triangles that can be hit; null if there are none.
        ``camera``: the fields of `Camera`. ``background``.
        ``meshes``: ``name``, ``triangles``, ``vertices``, ``attributes`` of each, and without
        instances ``is_closed``. ``is_closed``: whether all of them together are.
        ``materials``: ``name``, ``triangles``, colours, ``textures`` of each.
        ``lights``: ``type`` and parameters of each; area lights come last.
        ``memory``: bytes of the ``scene`` (its meshes), the ``triangles`` shared by
        structures, and the ``structure``.
        ``structure``: ``name``, ``seconds``, ``quality``. ``seconds``: ``load``, ``build``.
    """
    scene, structure = tracer.scene, tracer.structure
    triangles = structure.triangles
    low, high = triangles.world_bounds.tolist()
    camera = scene.camera
    return {
        "scene": source,
        "name": scene.name,
        **triangle_figures(scene),
        "degenerate_triangles": triangles.degenerate_count,
        "nonfinite_triangles": triangles.nonfinite_count,
        "vertices": sum(len(mesh.vertices) for mesh in scene.meshes),
        "bounds": {"low": low, "high": high} if low != high else None,
        "camera": {
            "eye": list(camera.eye),
            "look_at": list(camera.look_at),
            "up": list(camera.up),
            "fov": camera.fov,
            "projection": camera.projection,
            "height": camera.height,
            "aperture": camera.aperture,
            "focus": camera.focus,
        },
        "background": list(scene.background),
        **_describe_meshes(tracer),
        "materials": _describe_materials(scene),
        "lights": _describe_lights(scene),
        "memory": {
            "scene": sum(_mesh_byte_count(mesh) for mesh in scene.meshes),
            "triangles": triangles.byte_count,
            "structure": structure.report.byte_count,
        },
        "structure": {
            "name": structure.name,
            "seconds": round(structure.report.seconds, 6),
            "quality": structure.quality(),
        },
        "seconds": watch.rounded(),
    }


def _mesh_byte_count(mesh: Mesh) -> int:
    arrays = (mesh.vertices, mesh.faces, mesh.material_ids, *_attributes(mesh).values())
    faces = 0 if mesh.face_ids is None else mesh.face_ids.nbytes
    return faces + sum(array.nbytes for array in arrays)


def _attributes(mesh: Mesh) -> dict[str, np.ndarray]:
    found = {name: getattr(mesh, name) for name in ATTRIBUTES}
    return {name: array for name, array in found.items() if array is not None}


def _describe_meshes(tracer: Tracer) -> dict[str, Any]:
    described: list[dict[str, Any]] = [
        {
            "name": mesh.name,
            "triangles": len(mesh.faces),
            "vertices": len(mesh.vertices),
            "attributes": list(_attributes(mesh)),
        }
        for mesh in tracer.scene.meshes
    ]
    triangles: Any = tracer.structure.triangles  # or what stands for them
    if triangles.has_primitives or triangles.instances is not None:
        return {"meshes": described}
    solids = solids_of(triangles)
    for mesh, is_closed in zip(described, solids.is_closed | solids.is_empty, strict=True):
        mesh["is_closed"] = bool(is_closed)
    return {"meshes": described, "is_closed": solids.is_closed_together}


def _describe_materials(scene: Scene) -> list[dict[str, Any]]:
    counts = np.zeros(len(scene.materials), np.int64)
    for mesh in scene.meshes:
        counts += np.bincount(mesh.material_ids, minlength=len(counts))
    described = []
    for material, count in zip(scene.materials, counts.tolist(), strict=True):
        figures: dict[str, Any] = {"name": material.name, "triangles": count}
        for field in dataclasses.fields(material):
            value = getattr(material, field.name)
            figures[field.name] = list(value) if isinstance(value, tuple) else value
        figures["textures"] = {role: image.name for role, image in material.textures.items()}
        described.append(figures)
    return described


def _describe_lights(scene: Scene) -> list[dict[str, Any]]:
    described: list[dict[str, Any]] = []
    for light in scene.lights:
        kind = type(light).__name__.removesuffix("Light").lower()
        described.append({"type": kind, **dataclasses.asdict(light)})
    described += [
        {
            "type": "area",
            "mesh_id": light.mesh_id,
            "triangles": len(light.prim_ids),
            "radiance": list(light.radiance),
        }
        for light in scene.area_lights
    ]
    return described
