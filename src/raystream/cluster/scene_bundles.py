"""Scenes in bundles: meshes, materials, textures, lights and background, for rendering."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.rendering.environment import texels_of
from raystream.scene.geometry import Geometry
from raystream.scene.instancing import InstancedGeometry
from raystream.scene.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    SpotLight,
)
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.primitive_geometry import PrimitiveGeometry
from raystream.scene.scene import Scene
from raystream.scene.texture import Texture
from raystream.structures.saved_stores import (
    arrays_of,
    instances_of,
    objects_of,
    part_of,
    primitives_of,
)

_ATTRIBUTES = ("vertices", "faces", "normals", "colors", "texcoords", "material_ids")

#: The names in `Store.saved_arrays` that are of instances, and of height fields and spheres.
_GEOMETRY = re.compile(r"object_ids|transforms|worlds|masks|(object\d+\.)?(field|spheres)")

_LIGHTS: dict[str, type[Light]] = {
    "point": PointLight,
    "spot": SpotLight,
    "directional": DirectionalLight,
    "environment": EnvironmentLight,
}

Arrays = dict[str, NDArray[Any]]


def pack_scene(scene: Scene) -> tuple[dict[str, Any], Arrays]:
    """Pack everything that an image of a scene depends on, except triangles and camera.

    Textures and environment maps are sent as texels, so that workers do not need their files.
    Animations are not sent: see `animations`.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    header : dict
    arrays : dict of str to ndarray
    """
    arrays: Arrays = {}
    for index, mesh in enumerate(scene.meshes):
        for name in _ATTRIBUTES:
            array = getattr(mesh, name)
            if array is not None:
                arrays[f"mesh {index} {name}"] = array
    textures = _textures_of(scene.materials)
    header = {
        "meshes": [[mesh.name, mesh.mask] for mesh in scene.meshes],
        "materials": [_material_fields(material, textures) for material in scene.materials],
        "textures": [_pack_texture(texture, i, arrays) for i, texture in enumerate(textures)],
        "lights": [_pack_light(light, i, arrays) for i, light in enumerate(scene.lights)],
        "background": [float(c) for c in scene.background],
        "up": scene.up.tolist(),
        "name": scene.name,
    }
    geometry: Any = scene.geometry
    if geometry.instances is not None:
        held = geometry.objects
        header["objects"] = [[len(one.meshes), one.has_primitives] for one in held]
    if geometry.instances is not None or geometry.has_primitives:
        header["has_primitives"] = geometry.has_primitives
        own = arrays_of(scene.triangles).items()
        arrays |= {f"geometry.{name}": one for name, one in own if _GEOMETRY.match(name)}
    return header, arrays


def unpack_scene(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Scene:
    """Restore the scene packed by `pack_scene`, without camera and animation."""
    meshes = []
    for index, (name, mask) in enumerate(header["meshes"]):
        found = {key: arrays.get(f"mesh {index} {key}") for key in _ATTRIBUTES}
        vertices, faces = found.pop("vertices"), found.pop("faces")
        assert vertices is not None
        assert faces is not None
        meshes.append(Mesh(vertices, faces, name=name, mask=mask, **found))  # type: ignore[arg-type]
    textures = [_unpack_texture(fields, i, arrays) for i, fields in enumerate(header["textures"])]
    scene = Scene(
        meshes,
        materials=[_material(fields, textures) for fields in header["materials"]],
        lights=[_unpack_light(fields, i, arrays) for i, fields in enumerate(header["lights"])],
        up=header["up"],
        background=tuple(header["background"]),
        name=header["name"],
    )
    own = part_of(arrays, "geometry")
    if "objects" in header:
        rest, held = iter(meshes), objects_of(own)
        objects = [
            _geometry(list(itertools.islice(rest, count)), has_primitives, held.get(k, {}))
            for k, (count, has_primitives) in enumerate(header["objects"])
        ]
        return scene.with_geometry(InstancedGeometry(objects, instances_of(own)))
    if header.get("has_primitives"):
        return scene.with_geometry(_geometry(meshes, True, own))
    return scene


def _geometry(
    meshes: Sequence[Mesh], has_primitives: bool, arrays: Mapping[str, NDArray[Any]]
) -> Geometry:
    """The geometry of meshes, and of the height fields and spheres in arrays."""
    return PrimitiveGeometry(meshes, *primitives_of(arrays)) if has_primitives else Geometry(meshes)


def _textures_of(materials: Sequence[Material]) -> list[Texture]:
    """List each texture once, even if materials share it."""
    found: dict[int, Texture] = {}
    for material in materials:
        for texture in material.textures.values():
            found.setdefault(id(texture), texture)
    return list(found.values())


def _material_fields(material: Material, textures: Sequence[Texture]) -> dict[str, Any]:
    fields = {f.name: getattr(material, f.name) for f in dataclasses.fields(material)}
    refs = {id(texture): i for i, texture in enumerate(textures)}
    fields["textures"] = {role: refs[id(texture)] for role, texture in fields["textures"].items()}
    return fields


def _material(fields: Mapping[str, Any], textures: Sequence[Texture]) -> Material:
    roles = {role: textures[i] for role, i in fields["textures"].items()}
    plain: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in fields.items()
        if name != "textures"
    }
    return Material(**plain, textures=roles)


def _pack_texture(texture: Texture, index: int, arrays: Arrays) -> dict[str, Any]:
    # An unreadable texture is sent without texels, and is missing from the image as usual.
    with contextlib.suppress(FileFormatError):
        arrays[f"texture {index}"] = texture.pixels()
    return {"name": texture.name, "wrap": texture.wrap, "transform": texture.transform}


def _unpack_texture(
    fields: Mapping[str, Any], index: int, arrays: Mapping[str, NDArray[Any]]
) -> Texture:
    return Texture(arrays.get(f"texture {index}", b""), **fields)


def _pack_light(light: Light, index: int, arrays: Arrays) -> dict[str, Any]:
    kind = next(name for name, kind in _LIGHTS.items() if type(light) is kind)
    fields = {f.name: getattr(light, f.name) for f in dataclasses.fields(light)}
    if fields.pop("image", None) is not None:
        assert isinstance(light, EnvironmentLight)
        arrays[f"light {index}"] = texels_of(light)
    return {"kind": kind, **fields}


def _unpack_light(
    fields: Mapping[str, Any], index: int, arrays: Mapping[str, NDArray[Any]]
) -> Light:
    plain = dict(fields)
    kind = _LIGHTS[plain.pop("kind")]
    image = arrays.get(f"light {index}")
    if image is not None:
        plain["image"] = image
    return kind(**plain)
