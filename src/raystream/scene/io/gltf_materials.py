"""glTF materials: metallic-roughness parameters, and extensions of them."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_texcoords import Texcoords, shared_texcoords
from raystream.scene.io.gltf_textures import TextureReader
from raystream.scene.material import Color, Material

#: Larger numbers are clamped: float32 holds squares of at most about 1e38.
_MOST = 1e30

#: Lower bound of attenuation colours: black would absorb infinitely.
_LEAST = 1e-30

_BLACK = 0.0, 0.0, 0.0

#: An index of refraction that bends no ray visibly.
_NEARLY_1 = 1.0001


def read_materials(file: GltfFile) -> tuple[list[Material], list[Texcoords]]:
    """Read all materials, followed by the default one for primitives without a material.

    The base colour becomes `diffuse`, regardless of the metallic factor. Also read are
    `roughness`, `metallic` and of ``KHR_materials_`` `emissive_strength`, `ior`, `specular`,
    `transmission`, `volume`, `clearcoat`, `sheen` and `unlit`. The base colour's alpha is the
    opacity, unless ``alphaMode`` is ``OPAQUE``; ``MASK`` sets the cutoff. Factors multiply the
    textures of the same role. The `scale` of a normal map is read; occlusion is not, as no
    renderer uses it.

    Parameters
    ----------
    file : GltfFile
        The document.

    Returns
    -------
    materials : list of Material
    texcoords : list of Texcoords
        Of the meshes with each material.

    Raises
    ------
    FileFormatError
        If an entry has the wrong type or refers to a missing one.

    Warns
    -----
    RaystreamWarning
        Once for missing images, and once for textures that are not supported.
    """
    reader = TextureReader(file)
    count = len(file.entries(file.root, "materials"))
    found = [_material(file, file.entry("materials", i), reader) for i in range(count)]
    reader.report()
    found.append((Material(), shared_texcoords({})))
    return [material for material, _ in found], [texcoords for _, texcoords in found]


def uses_alpha(entry: Node) -> bool:
    """Whether the alpha of a material, and of its textures and vertices, counts."""
    return entry.get("alphaMode", "OPAQUE") in ("MASK", "BLEND")


def _material(file: GltfFile, entry: Node, reader: TextureReader) -> tuple[Material, Texcoords]:
    surface = file.child(entry, "pbrMetallicRoughness")
    red, green, blue, alpha = file.numbers(surface, "baseColorFactor", (1.0, 1.0, 1.0, 1.0))
    base = _positive((red, green, blue))
    is_solid, is_mask = not uses_alpha(entry), entry.get("alphaMode") == "MASK"
    fields: dict[str, Any] = {
        "name": str(entry.get("name", "")),
        "opacity": 1.0 if is_solid else _share(alpha),
        "double_sided": entry.get("doubleSided", False) is True,
        "alpha_cutoff": max(0.0, file.number(entry, "alphaCutoff", 0.5)) if is_mask else None,
    }
    color = file.child(surface, "baseColorTexture")
    role = "diffuse"
    if file.extension(entry, "KHR_materials_unlit") is not None:
        role = "emission"
        textures, texcoords = reader.textures({role: color})
        fields |= {"diffuse": _BLACK, "emission": base}
    else:
        coat = file.extension(entry, "KHR_materials_clearcoat") or {}
        sheen = file.extension(entry, "KHR_materials_sheen") or {}
        textures, texcoords = reader.textures(
            {
                role: color,
                "metallic_roughness": file.child(surface, "metallicRoughnessTexture"),
                "normal": file.child(entry, "normalTexture"),
                "emission": file.child(entry, "emissiveTexture"),
                "specular": _child(file, entry, "specular", "specularColorTexture"),
                "clearcoat": file.child(coat, "clearcoatTexture"),
                "clearcoat_roughness": file.child(coat, "clearcoatRoughnessTexture"),
                "clearcoat_normal": file.child(coat, "clearcoatNormalTexture"),
                "sheen_color": file.child(sheen, "sheenColorTexture"),
                "sheen_roughness": file.child(sheen, "sheenRoughnessTexture"),
                "transmission": _child(file, entry, "transmission", "transmissionTexture"),
                "reflectance": _child(file, entry, "specular", "specularTexture"),
            }
        )
        for name in {"sheen_roughness", "reflectance"}.intersection(textures):
            textures[name] = reader.alpha(textures[name])
        has_map = "transmission" in textures
        fields |= {"diffuse": base, **_lit(file, entry, surface, base, has_map)}
        fields |= _layers(file, coat, sheen)
        if has_map and fields["ior"] != 1.0:
            if "reflectance" in textures:
                reader.leave_out("for the specular factor of solids with a transmission map")
            rest = partial(_rest_of, _through(file, entry))
            textures["reflectance"] = textures["transmission"].changed(rest)
    if color and role in textures and not is_solid:
        textures["opacity"] = reader.alpha(textures[role])
    return Material(textures=textures, **fields), texcoords


def _lit(file: GltfFile, entry: Node, surface: Node, base: Color, has_map: bool) -> dict[str, Any]:
    """The parameters of a material that reflects, transmits and emits light.

    `has_map` is whether there is a map of transmission.
    """
    glow = file.extension(entry, "KHR_materials_emissive_strength") or {}
    strength = max(0.0, file.number(glow, "emissiveStrength", 1.0))
    emission = _positive(file.numbers(entry, "emissiveFactor", _BLACK))
    refraction = file.extension(entry, "KHR_materials_ior") or {}
    ior = max(0.0, file.number(refraction, "ior", 1.5))
    through = _through(file, entry)
    volume = file.extension(entry, "KHR_materials_volume") or {}
    is_thick = through > 0.0 and file.number(volume, "thicknessFactor", 0.0) > 0.0
    # The surface of a solid reflects by its index of refraction, as far as it transmits light; that
    # of a pane as without transmission, and no ray is bent.
    share = 1.0 - through if is_thick and not has_map else 1.0
    gloss = file.extension(entry, "KHR_materials_specular") or {}
    grazing = share * _share(file.number(gloss, "specularFactor", 1.0))
    tint = _positive(file.numbers(gloss, "specularColorFactor", (1.0, 1.0, 1.0)))
    normal = ((ior - 1.0) / (ior + 1.0)) ** 2
    red, green, blue = (grazing * min(1.0, normal * part) for part in tint)
    return {
        "transmission": (through * base[0], through * base[1], through * base[2]),
        # An index of exactly 1 is a pane's, which scatters light if it is rough.
        "ior": (ior if ior != 1.0 else _NEARLY_1) if is_thick else 1.0,
        "emission": (emission[0] * strength, emission[1] * strength, emission[2] * strength),
        "roughness": file.number(surface, "roughnessFactor", 1.0),
        "metallic": file.number(surface, "metallicFactor", 1.0),
        "normal_reflectance": (red, green, blue),
        "grazing_reflectance": grazing,
        "normal_scale": _scale(file, file.child(entry, "normalTexture")),
        "absorption": _absorption(file, volume) if is_thick else _BLACK,
    }


def _through(file: GltfFile, entry: Node) -> float:
    """The factor of transmission."""
    glass = file.extension(entry, "KHR_materials_transmission") or {}
    return _share(file.number(glass, "transmissionFactor", 0.0))


def _rest_of(through: float, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """What a map of transmission, times a factor, leaves to be reflected."""
    rest = 255.0 - through * pixels[:, :, :1].astype(np.float64)
    return np.floor(rest + 0.5).astype(np.uint8)


def _layers(file: GltfFile, coat: Node, sheen: Node) -> dict[str, Any]:
    """The parameters of a clear coat and of sheen."""
    return {
        "clearcoat": _share(file.number(coat, "clearcoatFactor", 0.0)),
        "clearcoat_roughness": _share(file.number(coat, "clearcoatRoughnessFactor", 0.0)),
        "clearcoat_normal_scale": _scale(file, file.child(coat, "clearcoatNormalTexture")),
        "sheen_color": tuple(map(_share, file.numbers(sheen, "sheenColorFactor", _BLACK))),
        "sheen_roughness": _share(file.number(sheen, "sheenRoughnessFactor", 0.0)),
    }


def _scale(file: GltfFile, normals: Node) -> float:
    """The scale of a normal map."""
    return min(max(-_MOST, file.number(normals, "scale", 1.0)), _MOST)


def _share(value: float) -> float:
    return min(1.0, max(0.0, value))


def _child(file: GltfFile, entry: Node, name: str, key: str) -> Node:
    """An object of a material's extension; empty if there is none."""
    return file.child(file.extension(entry, f"KHR_materials_{name}") or {}, key)


def _absorption(file: GltfFile, volume: Node) -> Color:
    """``KHR_materials_volume``: white light is attenuated to `color` over `distance`."""
    distance = file.number(volume, "attenuationDistance", 0.0)  # absent: infinite
    if not distance > 0.0:
        return _BLACK
    color = file.numbers(volume, "attenuationColor", (1.0, 1.0, 1.0))
    left = (min(max(_LEAST, part), 1.0) for part in color)
    return _positive(tuple(-math.log(part) / distance for part in left))


def _positive(values: tuple[float, ...]) -> Color:
    red, green, blue = (min(max(0.0, value), _MOST) for value in values)
    return red, green, blue
