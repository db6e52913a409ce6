"""MTL: Wavefront's material libraries."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io.files import find_sibling, read_model_bytes
from raystream.scene.io.partial import listed, warn_partial
from raystream.scene.io.text import decoded, plain_text
from raystream.scene.material import Color, Material
from raystream.scene.texture import Affine, Texture, Wrap

#: Illumination models with ray traced reflection (Wavefront's numbering).
MIRROR_MODELS = frozenset({3, 4, 5, 6, 7})

#: Illumination models with ray traced refraction.
GLASS_MODELS = frozenset({4, 6, 7, 9})

_TEXTURE_ROLES = {
    "map_kd": "diffuse",
    "map_ks": "specular",
    "map_ke": "emission",
    "map_d": "opacity",
    "map_bump": "bump",
    "bump": "bump",
    "map_kn": "normal",
    "norm": "normal",
    "map_pr": "roughness",
    "map_pm": "metallic",
}

#: Texture options and their numbers of words; the last two of ``-o -s -t`` are optional.
_OPTION_WORDS = {
    "-blendu": 1,
    "-blendv": 1,
    "-boost": 1,
    "-bm": 1,
    "-cc": 1,
    "-clamp": 1,
    "-imfchan": 1,
    "-mm": 2,
    "-texres": 1,
    "-type": 1,
    "-o": 3,
    "-s": 3,
    "-t": 3,
}

#: Words of each option of a texture.
_Options = Mapping[str, Sequence[str]]

#: Larger numbers of options are clamped: float32 holds them times usual coordinates.
_MOST = 1e30

#: What may be wrong with textures.
_MISSING = "textures not found next to it"
_TURBULENT = "the turbulence (-t) of textures is not supported; they are shown without it"
_UNLIKE = "maps of metal (map_Pm) are shown with the -s, -o and -clamp of their material's map_Pr"


def read_mtl(path: Path) -> dict[str, Material]:
    """Read a material library.

    Colours are linear. The ambient colour is ignored: in practice, `Ka` repeats `Kd`. Models 3
    to 7 reflect with `Ks`. The refracting models 4, 6, 7 and 9 have the transmittance `Tf`,
    and a `d` below 1 is part of their refraction, but ``map_d`` is not. Invalid numbers are
    replaced by defaults. Texture options read are ``-clamp``, ``-s``, ``-o``, and ``-bm`` of bump
    and normal maps.

    A texture is looked up at s u + o, where s and o are the first two numbers of ``-s`` and ``-o``,
    as Blender and three.js read them: a larger ``-s`` repeats the image more often.

    A material with roughness `Pr` or metal `Pm` (or ``map_Pr``, ``map_Pm``), as newer programs
    write them, has these in place of `Ks`, `Ns` and the model, and `Ni` sets its reflectance; also
    read are sheen `Ps`, and the clear coat `Pc` with its roughness `Pcr`. Refracting models ignore
    them.

    Parameters
    ----------
    path : Path
        An ``.mtl`` file.

    Returns
    -------
    dict of str to Material
        By name, in file order; the first of materials with the same name counts.

    Raises
    ------
    FileFormatError
        If the file cannot be read.

    Warns
    -----
    RaystreamWarning
        Once for missing textures, once for turbulence (``-t``), which is not supported, and once
        for maps of roughness and metal whose options differ.
    """
    text = plain_text(read_model_bytes(path))
    materials: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in text.split(b"\n"):
        words = decoded(line).split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        word, rest = words[0].lower(), words[1].strip() if len(words) > 1 else ""
        if word == "newmtl":
            current = {}
            materials.setdefault(_without_comment(rest), current)
        else:
            current[word] = rest
    textures = _Textures(path)
    made = {name: _material(name, entries, textures) for name, entries in materials.items()}
    for reason, names in textures.faults.items():
        warn_partial(path, f"{reason}: {listed(names)}")
    return made


def _material(name: str, entries: dict[str, str], textures: _Textures) -> Material:
    default = Material()
    model = int(_number(entries.get("illum", ""), 2.0))
    specular = _color(entries.get("ks", ""), default.specular)
    filter_color = _color(entries.get("tf", ""), (1.0, 1.0, 1.0))
    opacity = _opacity(entries)
    refracts = model in GLASS_MODELS
    maps: dict[str, Texture] = {}
    scales = {"bump": default.bump_scale, "normal": default.normal_scale}
    for word, role in _TEXTURE_ROLES.items():
        if entries.get(word):
            options, file = _split_options(entries[word])
            texture = textures.find(file, options)
            if texture is not None:
                maps[role] = texture
                if role in scales:
                    scales[role] = _multiplier(options, scales[role])
    pair = maps.pop("roughness", None), maps.pop("metallic", None)
    rough = {} if refracts else _rough(entries, *pair)
    if rough:
        specular, model = default.specular, 0
        maps = {role: texture for role, texture in maps.items() if role != "specular"}
        maps |= _metallic_roughness(*pair, textures)
    return Material(
        name=name,
        diffuse=_color(entries.get("kd", ""), default.diffuse),
        specular=specular,
        shininess=max(0.0, _number(entries.get("ns", ""), default.shininess)),
        reflection=specular if model in MIRROR_MODELS else default.reflection,
        transmission=filter_color if refracts else default.transmission,
        ior=max(0.0, _number(entries.get("ni", ""), default.ior)) or default.ior,
        emission=_color(entries.get("ke", ""), default.emission),
        opacity=1.0 if refracts else opacity,
        textures=maps,
        normal_scale=scales["normal"],
        bump_scale=scales["bump"],
        **rough,
    )


def _rough(entries: dict[str, str], rough: Texture | None, metal: Texture | None) -> dict[str, Any]:
    """The parameters of a material with roughness and metal, or maps of them; empty for others."""
    if rough is None and metal is None and not {"pr", "pm"}.intersection(entries):
        return {}
    index = _number(entries.get("ni", ""), 1.5)
    normal = ((index - 1.0) / (index + 1.0)) ** 2 if index > 1.0 else 0.04
    sheen = _share(entries, "ps", 0.0)
    return {
        "roughness": _share(entries, "pr", 0.5 if rough is None else 1.0),
        "metallic": _share(entries, "pm", 0.0 if metal is None else 1.0),
        "normal_reflectance": (normal, normal, normal),
        "clearcoat": _share(entries, "pc", 0.0),
        "clearcoat_roughness": _share(entries, "pcr", 0.0),
        "sheen_color": (sheen, sheen, sheen),
        "sheen_roughness": 0.5,
    }


def _share(entries: dict[str, str], word: str, default: float) -> float:
    return min(1.0, max(0.0, _number(entries.get(word, ""), default)))


def _metallic_roughness(
    rough: Texture | None, metal: Texture | None, textures: _Textures
) -> dict[str, Texture]:
    """The two maps as one, as in glTF."""
    first = metal if rough is None else rough
    if first is None:
        return {}
    second = first if metal is None else metal
    if (first.wraps, first.transform) != (second.wraps, second.transform):
        textures.add_fault(_UNLIKE, second.name)
    unread = Texture(
        np.zeros((1, 1, 3), np.uint8), name=first.name, wrap=first.wrap, transform=first.transform
    )
    return {"metallic_roughness": unread.changed(partial(_joined, rough, metal))}


def _joined(rough: Texture | None, metal: Texture | None, _: NDArray[Any]) -> NDArray[np.uint8]:
    """Roughness in green and metal in blue, of maps whose red counts; 255 without a map.

    A map of another size is enlarged or reduced to that of the first by nearest texels. Where the
    map of metal cannot be read, there is no metal.
    """
    maps = [_red_of(rough), _red_of(metal)]
    height, width = next((one.shape for one in maps if one is not None), (1, 1))
    joined = np.full((height, width, 3), 255, np.uint8)
    if metal is not None:
        joined[:, :, 2] = 0
    for channel, one in enumerate(maps, 1):
        if one is not None:
            row = np.arange(height) * one.shape[0] // height
            column = np.arange(width) * one.shape[1] // width
            joined[:, :, channel] = one[row[:, None], column]
    return joined


def _red_of(texture: Texture | None) -> NDArray[np.uint8] | None:
    """The red of a map; None without one, and, with a warning, if it cannot be read."""
    if texture is None:
        return None
    try:
        return texture.pixels()[:, :, 0]
    except FileFormatError as error:
        warnings.warn(f"texture left out: {error}", RaystreamWarning, stacklevel=2)
        return None


def _opacity(entries: dict[str, str]) -> float:
    """Read ``d``, else 1 - ``Tr``."""
    if "d" in entries:
        return min(1.0, max(0.0, _number(entries["d"].replace("-halo", ""), 1.0)))
    return 1.0 - min(1.0, max(0.0, _number(entries.get("tr", ""), 0.0)))


def _without_comment(text: str) -> str:
    return text.partition(" #")[0].strip()


def _number(text: str, default: float) -> float:
    """Read the first word as a finite number."""
    try:
        value = float(text.split()[0])
    except (IndexError, ValueError):
        return default
    return value if math.isfinite(value) else default


def _color(text: str, default: Color) -> Color:
    """Read three numbers, or one for all three; ``spectral`` and ``xyz`` are not supported."""
    words = _without_comment(text).split()[:3]
    try:
        values = [float(word) for word in words]
    except ValueError:
        return default
    if len(values) == 1:
        values *= 3
    if len(values) != 3 or not all(math.isfinite(v) and v >= 0.0 for v in values):
        return default
    return values[0], values[1], values[2]


class _Textures:
    """Makes the textures of a library, one per file, wrap and transform.

    Attributes
    ----------
    faults : dict of str to list of str
        Files of textures by what is wrong with them.
    """

    def __init__(self, path: Path) -> None:
        self.faults: dict[str, list[str]] = {}
        self._path = path
        self._made: dict[tuple[str, Wrap, Affine | None], Texture | None] = {}

    def find(self, name: str, options: _Options) -> Texture | None:
        """The texture of a statement, by its file and options; None if there is no such file."""
        wrap: Wrap = "clamp" if [*map(str.lower, options.get("-clamp", []))] == ["on"] else "repeat"
        transform = _transform(options)
        key = (name, wrap, transform)
        if key not in self._made:
            found = find_sibling(self._path, name)
            self._made[key] = Texture(found, wrap=wrap, transform=transform) if found else None
        if self._made[key] is None:
            self.add_fault(_MISSING, name)
        elif any(_numbers(options.get("-t", []))):
            self.add_fault(_TURBULENT, name)
        return self._made[key]

    def add_fault(self, fault: str, name: str) -> None:
        """Note what is wrong with a texture, once."""
        names = self.faults.setdefault(fault, [])
        if name not in names:
            names.append(name)


def _transform(options: _Options) -> Affine | None:
    """`Texture.transform` of ``-s`` and ``-o``; None if they move nothing."""
    across, up = _pair(options.get("-s", []), 1.0)
    right, higher = _pair(options.get("-o", []), 0.0)
    transform = (across, 0.0, right, 0.0, up, higher)
    return None if transform == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0) else transform


def _pair(words: Sequence[str], default: float) -> tuple[float, float]:
    """The numbers along u and v; the default for what is missing or not finite."""
    across, up, *_ = (*_numbers(words), default, default)
    return _bounded(across, default), _bounded(up, default)


def _bounded(value: float, default: float) -> float:
    """A number that float32 holds, and its products with coordinates, too."""
    return min(max(-_MOST, value), _MOST) if math.isfinite(value) else default


def _multiplier(options: _Options, default: float) -> float:
    """Read ``-bm``, a bump map's multiplier."""
    first, *_ = (*_numbers(options.get("-bm", [])), default)
    return _bounded(first, default)


def _split_options(statement: str) -> tuple[_Options, str]:
    """Split a texture statement into the words of each option, and the file's name."""
    rest = _without_comment(statement)
    options: dict[str, Sequence[str]] = {}
    while rest.startswith("-"):
        words = rest.split()
        option = words[0].lower()
        if option not in _OPTION_WORDS:
            break
        skip = 1 + _OPTION_WORDS[option]
        if option in ("-o", "-s", "-t"):
            skip = 1 + len(_numbers(words[1:4]))
        options[option] = words[1:skip]
        parts = rest.split(None, skip)
        rest = parts[skip] if len(parts) > skip else ""
    return options, rest


def _numbers(words: Sequence[str]) -> list[float]:
    """The numbers before the first word that is not a number."""
    numbers: list[float] = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            break
    return numbers
