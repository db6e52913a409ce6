"""Gather arrays of fragment programs: in storage buffers, or in textures as the papers had them.

Purcell 2002, section 3.1, kept cells, lists and triangles in textures: an index is divided into a
column and a row, and a texel is read there ("dependent texture fetch"). Shaders are written for
buffers; `in_textures` rewrites their declarations and reads.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import upload
from raystream.graphics.errors import GraphicsError
from raystream.graphics.textures import new_texture

#: Where they are.
MEMORIES = BUFFERS, TEXTURES = "buffers", "textures"

#: Texels in a row.
_WIDTH_BITS = 12
_WIDTH = 1 << _WIDTH_BITS

_DECLARED = re.compile(
    r"^@group\((\d)\) @binding\((\d)\) var<storage, read> (\w+): array<(\w+)>;$", re.MULTILINE
)


class _Texel(NamedTuple):
    """An element's type as a texture: format, words, kind of binding, type and part of a texel."""

    format: str
    words: int
    kind: str
    sampled: str
    part: str


_TEXELS: Mapping[str, _Texel] = MappingProxyType(
    {
        "f32": _Texel("r32float", 1, "float", "f32", ".x"),
        "u32": _Texel("r32uint", 1, "uint", "u32", ".x"),
        "i32": _Texel("r32sint", 1, "sint", "i32", ".x"),
        "vec2u": _Texel("rg32uint", 2, "uint", "u32", ".xy"),
        "vec4u": _Texel("rgba32uint", 4, "uint", "u32", ""),
    }
)


class Gather(NamedTuple):
    """An array on the device.

    Attributes
    ----------
    kind : str
        Of its binding, see `pipelines.Program`.
    resource : object
        For a bind group.
    """

    kind: str
    resource: Any


def in_textures(source: str, group: int | None = None) -> str:
    """A shader whose gather arrays, or those of one bind group, are textures instead of buffers."""

    def is_chosen(match: re.Match[str]) -> bool:
        return group is None or int(match.group(1)) == group

    def declaration(match: re.Match[str]) -> str:
        number, binding, name, element = match.groups()
        if not is_chosen(match):
            return match.group(0)
        texel = _TEXELS[element]
        return (
            f"@group({number}) @binding({binding}) var {name}_texels: "
            f"texture_2d<{texel.sampled}>;\n"
            f"fn {name}_at(index: u32) -> {element} {{\n"
            f"    let place = vec2u(index & {_WIDTH - 1}u, index >> {_WIDTH_BITS}u);\n"
            f"    return textureLoad({name}_texels, place, 0){texel.part};\n"
            f"}}"
        )

    names = [match.group(3) for match in _DECLARED.finditer(source) if is_chosen(match)]
    source = _DECLARED.sub(declaration, source)
    return _with_calls(source, re.compile(rf"\b({'|'.join(names)})\[")) if names else source


def _with_calls(source: str, read: re.Pattern[str]) -> str:
    """Replace ``name[index]`` by ``name_at(u32(index))``, also within an index."""
    parts, at = [], 0
    while match := read.search(source, at):
        depth, end = 1, match.end()
        while depth:
            depth += {"[": 1, "]": -1}.get(source[end], 0)
            end += 1
        index = _with_calls(source[match.end() : end - 1], read)
        parts += [source[at : match.start()], f"{match.group(1)}_at(u32({index}))"]
        at = end
    return "".join([*parts, source[at:]])


def upload_gathers(
    opened: OpenDevice,
    arrays: Iterable[tuple[str, NDArray[Any]]],
    memory: str,
    source: str,
    first: int = 0,
) -> list[Gather]:
    """Copy named arrays to the device.

    Parameters
    ----------
    opened : OpenDevice
    arrays : iterable of (str, ndarray)
        Names, for errors, and arrays.
    memory : {"buffers", "textures"}
    source : str
        The shader that declares them in group 1, with their types; for buffers.
    first : int
        Binding of the first one.

    Raises
    ------
    GraphicsError
        If one is too large for the device.
    """
    if memory == BUFFERS:
        return [Gather("gather", one.binding) for one in upload(opened, arrays)]
    types = {
        int(binding): element
        for group, binding, _, element in _DECLARED.findall(source)
        if group == "1"
    }
    return [
        _upload_texture(opened, name, array, _TEXELS[types.get(first + k, "u32")])
        for k, (name, array) in enumerate(arrays)
    ]


def _upload_texture(opened: OpenDevice, name: str, array: NDArray[Any], texel: _Texel) -> Gather:
    import wgpu

    words = np.ascontiguousarray(array).reshape(-1).view(np.uint32)
    row = _WIDTH * texel.words
    height = max(-(-len(words) // row), 1)
    if height > opened.limits["max-texture-dimension-2d"]:
        raise GraphicsError(
            f"device 'graphics': {name} would take a texture of {_WIDTH:,} x {height:,} texels, "
            f"more than {opened.adapter} allows; use memory='buffers'"
        )
    usage = wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.COPY_DST
    texture = new_texture(opened, name, (_WIDTH, height), texel.format, usage)
    padded = np.zeros(height * row, np.uint32)
    padded[: len(words)] = words
    opened.device.queue.write_texture(
        {"texture": texture},
        padded,
        {"bytes_per_row": 4 * row, "rows_per_image": height},
        (_WIDTH, height, 1),
    )
    return Gather(texel.kind, texture.create_view())
