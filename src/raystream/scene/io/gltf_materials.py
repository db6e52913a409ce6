"""glTF materials: metallic-roughness parameters, textures and images."""

from __future__ import annotations

import math

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import shown
from raystream.scene.material import Color, Material
from raystream.scene.texture import Texture

__all__ = ["read_materials", "texcoord_set"]

_CLAMP_TO_EDGE = 33071
_REPEAT = 10497

#: Larger numbers are clamped: float32 holds squares of at most about 1e38.
_MOST = 1e30

#: Lower bound of attenuation colours: black would absorb infinitely.
_LEAST = 1e-30


def read_materials(file: GltfFile) -> list[Material]:
    """Read all materials, followed by the default one for primitives without a material.

    The base colour becomes `diffuse`, regardless of the metallic factor. Also read are
    `roughness`, `metallic` and of ``KHR_materials_`` `emissive_strength`, `ior`,
    `transmission` and, for thick transmissive materials, the attenuation of `volume`. The
    base colour's alpha is the opacity, unless ``alphaMode`` is ``OPAQUE``; ``MASK`` sets the
    cutoff. Factors multiply the textures of the same role. The `scale` of a normal map is
    read; the strength of occlusion is not, as no renderer uses it.

    Parameters
    ----------
    file : GltfFile
        The document.

    Returns
    -------
    list of Material

    Raises
    ------
    FileFormatError
        If an entry has the wrong type or refers to a missing one.

    Warns
    -----
    RaystreamWarning
        Once, for missing images.
    """
    reader = _TextureReader(file)
    count = len(file.entries(file.root, "materials"))
    materials = [_material(file, file.entry("materials", i), reader) for i in range(count)]
    if reader.missing:
        warn_partial(file.path, f"images not found: {', '.join(reader.missing[:5])}")
    return [*materials, Material()]


def texcoord_set(file: GltfFile, material: int | None) -> int:
    """Return the set of texture coordinates that a material's base colour uses."""
    if material is None:
        return 0
    surface = file.child(file.entry("materials", material), "pbrMetallicRoughness")
    return file.integer(file.child(surface, "baseColorTexture"), "texCoord", 0)


def _material(file: GltfFile, entry: Node, reader: _TextureReader) -> Material:
    surface = file.child(entry, "pbrMetallicRoughness")
    red, green, blue, alpha = file.numbers(surface, "baseColorFactor", (1.0, 1.0, 1.0, 1.0))
    base = _positive((red, green, blue))
    glow = file.extension(entry, "KHR_materials_emissive_strength") or {}
    strength = max(0.0, file.number(glow, "emissiveStrength", 1.0))
    emission = _positive(file.numbers(entry, "emissiveFactor", (0.0, 0.0, 0.0)))
    refraction = file.extension(entry, "KHR_materials_ior") or {}
    glass = file.extension(entry, "KHR_materials_transmission") or {}
    through = min(1.0, max(0.0, file.number(glass, "transmissionFactor", 0.0)))
    mode = entry.get("alphaMode", "OPAQUE")
    is_solid, is_mask = mode not in ("MASK", "BLEND"), mode == "MASK"
    roles = {
        "diffuse": file.child(surface, "baseColorTexture"),
        "metallic_roughness": file.child(surface, "metallicRoughnessTexture"),
        "normal": file.child(entry, "normalTexture"),
        "occlusion": file.child(entry, "occlusionTexture"),
        "emission": file.child(entry, "emissiveTexture"),
    }
    found = {role: reader.texture(use) for role, use in roles.items() if use}
    textures = {role: texture for role, texture in found.items() if texture is not None}
    if "diffuse" in textures and not is_solid:
        textures["opacity"] = reader.alpha(textures["diffuse"])
    return Material(
        name=str(entry.get("name", "")),
        diffuse=base,
        transmission=(through * base[0], through * base[1], through * base[2]),
        ior=max(0.0, file.number(refraction, "ior", 1.5)),
        emission=(emission[0] * strength, emission[1] * strength, emission[2] * strength),
        opacity=1.0 if is_solid else min(1.0, max(0.0, alpha)),
        roughness=file.number(surface, "roughnessFactor", 1.0),
        metallic=file.number(surface, "metallicFactor", 1.0),
        double_sided=entry.get("doubleSided", False) is True,
        textures=textures,
        normal_scale=min(max(-_MOST, file.number(roles["normal"], "scale", 1.0)), _MOST),
        alpha_cutoff=max(0.0, file.number(entry, "alphaCutoff", 0.5)) if is_mask else None,
        absorption=_absorption(file, entry) if through > 0.0 else (0.0, 0.0, 0.0),
    )


def _absorption(file: GltfFile, entry: Node) -> Color:
    """``KHR_materials_volume``: white light is attenuated to `color` over `distance`."""
    volume = file.extension(entry, "KHR_materials_volume") or {}
    distance = file.number(volume, "attenuationDistance", 0.0)  # absent: infinite
    if not (distance > 0.0 and file.number(volume, "thicknessFactor", 0.0) > 0.0):
        return 0.0, 0.0, 0.0
    color = file.numbers(volume, "attenuationColor", (1.0, 1.0, 1.0))
    left = (min(max(_LEAST, part), 1.0) for part in color)
    return _positive(tuple(-math.log(part) / distance for part in left))


def _positive(values: tuple[float, ...]) -> Color:
    red, green, blue = (min(max(0.0, value), _MOST) for value in values)
    return red, green, blue


class _TextureReader:
    """Makes textures, one per image and wrap mode."""

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self.missing: list[str] = []
        self._made: dict[tuple[int, bool], Texture | None] = {}
        self._alphas: dict[int, Texture] = {}

    def texture(self, use: Node) -> Texture | None:
        """Make the texture of a material's ``...Texture`` entry."""
        file = self.file
        entry = file.entry("textures", file.integer(use, "index"))
        webp = file.extension(entry, "EXT_texture_webp")
        image = file.index(entry, "source")
        image = file.index(webp, "source") if webp else image
        if image is None:
            return None
        sampler = file.index(entry, "sampler")
        wraps = {} if sampler is None else file.entry("samplers", sampler)
        clamp = all(
            file.integer(wraps, key, _REPEAT) == _CLAMP_TO_EDGE for key in ("wrapS", "wrapT")
        )
        key = (image, clamp)
        if key not in self._made:
            self._made[key] = self._image(image, clamp)
        return self._made[key]

    def alpha(self, texture: Texture) -> Texture:
        """Return the alpha channel of a texture; cached."""
        if id(texture) not in self._alphas:
            self._alphas[id(texture)] = texture.alpha()
        return self._alphas[id(texture)]

    def _image(self, index: int, clamp: bool) -> Texture | None:
        file = self.file
        entry = file.entry("images", index)
        name = str(entry.get("name", "")) or f"image {index}"
        view = file.index(entry, "bufferView")
        if view is not None:
            return Texture(
                bytes(file.view(view)[0]), name=name, wrap="clamp" if clamp else "repeat"
            )
        uri = file.uri(entry)
        if uri.startswith("data:"):
            return Texture(file.decoded(uri), name=name, wrap="clamp" if clamp else "repeat")
        found = file.sibling(uri)
        if found is None:
            self.missing.append(shown(uri.encode()))
            return None
        return Texture(found, wrap="clamp" if clamp else "repeat")
