"""Tiny models, written by hand: one small valid file for each format."""

from __future__ import annotations

import base64
import json
import struct
from typing import Any

import numpy as np

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint32)

OBJ = b"""mtllib a.mtl
o first
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 1
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/2/1 4/1/1
f -4//-1 -3//-1 -2//-1
o second
f 1 2 3
"""

MTL = b"newmtl red\nKd 1 0 0\nmap_Kd -bm 0.5 red.png\nillum 5\nKs .5 .5 .5\n"

PLY_HEADER = """ply
format {encoding} 1.0
comment tiny
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
"""

OFF = b"OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"

STL_TEXT = b"""solid tiny
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1e0 0
 endloop
endfacet
endsolid tiny
"""

AFF = b"""# a lamp, a triangle, a moving mesh
b 0.1 0.2 0.3
v
from 0 0 5
at 0 0 0
up 0 1 0
angle 30
hither 0.1
resolution 8 6
am 1 1 1
l 1 2 3 0.5 0.5 0.5
fm 0.2 0.2 0.2 0.4 0.4 0.4 0.1 0.1 0.1 20 0.5 1.5
p 4 0 0 0 1 0 0 1 1 0 0 1 0
x thing {
 xs 2 2 2 0 0 1 90 1 0 0 {
  m
  vertices 3 0 0 0 1 0 0 0 1 0
  normals 1 0 0 1
  texturecoords 3 t.ppm 0 0 1 0 0 1
  triangles 1 0 1 2 0 0 0 0 1 2
 }
}
s 5 0 0 1
c 0 0 0 1 0 1 0 0
a 0 1 10
k thing { transl 4 -1 0 0 0 0 0 0 0 0 0 0 0 0 0 1 10 0 0 0 0 0 2 10 0 0 0 0 0
 visible 1 5 0 }
"""


def ply_text() -> bytes:
    rows = [" ".join(map(str, row)) for row in TETRAHEDRON.tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in SIDES.tolist()]
    return PLY_HEADER.format(encoding="ascii").encode() + "\n".join(rows).encode() + b"\n"


def ply_binary(order: str = "<") -> bytes:
    name = "binary_little_endian" if order == "<" else "binary_big_endian"
    faces = b"".join(struct.pack(f"{order}B3i", 3, *map(int, side)) for side in SIDES)
    return (
        PLY_HEADER.format(encoding=name).encode()
        + TETRAHEDRON.astype(f"{order}f4").tobytes()
        + faces
    )


def stl_binary() -> bytes:
    facets = b"".join(
        struct.pack("<12fH", 0, 0, 0, *TETRAHEDRON[side].ravel().tolist(), 0) for side in SIDES
    )
    return b"solid but binary".ljust(80, b"\0") + struct.pack("<I", len(SIDES)) + facets


def gltf_document() -> dict[str, Any]:
    """A tetrahedron with a node above it; its buffer is a data URI."""
    payload = TETRAHEDRON.tobytes() + SIDES.astype(np.uint16).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(payload).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"translation": [1, 0, 0], "children": [1]}, {"mesh": 0, "scale": [2, 2, 2]}],
        "meshes": [{"name": "t", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "buffers": [{"byteLength": 72, "uri": uri}],
    }


def with_buffer(document: dict[str, Any], *arrays: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Put arrays into the first buffer, a view for each."""
    payload = b""
    document["bufferViews"] = []
    for array in arrays:
        content = array.tobytes()
        view = {"buffer": 0, "byteOffset": len(payload), "byteLength": len(content)}
        document["bufferViews"].append(view)
        payload += content + b"\0" * (-len(content) % 4)
    uri = "data:;base64," + base64.b64encode(payload).decode()
    document["buffers"] = [{"byteLength": len(payload), "uri": uri}]
    return document


#: Component types and shapes of accessors.
_COMPONENTS = {"u1": 5121, "u2": 5123, "u4": 5125, "f4": 5126}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def with_accessor(document: dict[str, Any], array: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Add a buffer with an array, and an accessor of it."""
    uri = "data:;base64," + base64.b64encode(array.tobytes()).decode()
    view = {"buffer": len(document["buffers"]), "byteLength": array.nbytes}
    width = 1 if array.ndim == 1 else array.shape[1]
    accessor = {
        "bufferView": len(document["bufferViews"]),
        "componentType": _COMPONENTS[array.dtype.str[1:]],
        "count": len(array),
        "type": _SHAPES[width],
    }
    return document | {
        "buffers": [*document["buffers"], {"byteLength": array.nbytes, "uri": uri}],
        "bufferViews": [*document["bufferViews"], view],
        "accessors": [*document["accessors"], accessor],
    }


def gltf_of(meshes: list[Any], nodes: list[dict[str, Any]]) -> dict[str, Any]:
    """A document of nodes, of which the first is the root, and of meshes.

    A mesh is a list of primitives, or a name and such a list. A primitive has arrays by attribute,
    and its other members, such as the material; targets are lists of arrays by attribute.
    """
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        **{key: [] for key in ("meshes", "accessors", "bufferViews", "buffers")},
    }

    def stored(arrays: dict[str, Any]) -> dict[str, int]:
        nonlocal document
        found = {}
        for name, array in arrays.items():
            found[name] = len(document["accessors"])
            document = with_accessor(document, array)
        return found

    made = []
    for mesh in meshes:
        name, primitives = mesh if isinstance(mesh, tuple) else (None, mesh)
        entry: dict[str, Any] = (
            {"primitives": []} if name is None else {"name": name, "primitives": []}
        )
        for primitive in primitives:
            arrays = {key: value for key, value in primitive.items() if key.isupper()}
            others = {key: value for key, value in primitive.items() if not key.isupper()}
            if "targets" in others:
                others["targets"] = [stored(target) for target in others["targets"]]
            entry["primitives"].append({"attributes": stored(arrays), **others})
        made.append(entry)
    return document | {"meshes": made}


def moving_gltf() -> dict[str, Any]:
    """A tetrahedron with a skin, a morph target, a keyed joint, a spot and a material."""
    joints, weights = np.array([[0, 1, 0, 0]] * 4, np.uint8), np.full((4, 4), 0.25, np.float32)
    times, turns = np.array([0, 2], np.float32), np.eye(4, dtype=np.float32)[[3, 2]]
    document = with_buffer(
        gltf_document(),
        TETRAHEDRON,
        SIDES,
        joints,
        weights,
        times,
        turns,
        TETRAHEDRON[:, :2].copy(),
    )
    layouts = [
        (0, 5126, 4, "VEC3"),
        (1, 5125, 12, "SCALAR"),
        (2, 5121, 4, "VEC4"),
        (3, 5126, 4, "VEC4"),
        (4, 5126, 2, "SCALAR"),
        (5, 5126, 2, "VEC4"),
        (6, 5126, 4, "VEC2"),
    ]
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3, "TEXCOORD_1": 6}
    transform = {"texCoord": 1, "scale": [2, 3], "rotation": 0.5}
    use = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    light = {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}}
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": use},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}},
    }
    primitive = {
        "attributes": attributes,
        "indices": 1,
        "targets": [{"POSITION": 0}],
        "material": 0,
    }
    return document | {
        "accessors": [
            {"bufferView": view, "componentType": kind, "count": count, "type": shape}
            for view, kind, count, shape in layouts
        ],
        "nodes": [
            {"mesh": 0, "skin": 0},
            {},
            {"extensions": {"KHR_lights_punctual": {"light": 0}}},
        ],
        "scenes": [{"nodes": [0, 1, 2]}],
        "meshes": [{"primitives": [primitive], "weights": [0.5]}],
        "skins": [{"joints": [1, 2]}],
        "materials": [material],
        "textures": [{"source": 0}],
        "images": [{"uri": "data:,"}],
        "extensions": {"KHR_lights_punctual": {"lights": [light]}},
        "animations": [
            {
                "channels": [
                    {"sampler": 0, "target": {"node": 1, "path": "rotation"}},
                    {"sampler": 1, "target": {"node": 0, "path": "weights"}},
                ],
                "samplers": [{"input": 4, "output": 5}, {"input": 4, "output": 4}],
            }
        ],
    }


def gltf_text(document: dict[str, Any] | None = None) -> bytes:
    return json.dumps(document or gltf_document()).encode()


def glb_of(document: dict[str, Any]) -> bytes:
    """A document in a GLB file, its buffers as they are."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text


def glb(document: dict[str, Any] | None = None) -> bytes:
    document = document or gltf_document()
    payload = TETRAHEDRON.tobytes() + SIDES.astype(np.uint16).tobytes()
    document["buffers"] = [{"byteLength": len(payload)}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(payload), 0x004E4942) + payload
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


#: Suffix and content of a valid file of every format.
ALL = {
    "text.ply": ply_text(),
    "little.ply": ply_binary("<"),
    "big.ply": ply_binary(">"),
    "text.stl": STL_TEXT,
    "binary.stl": stl_binary(),
    "a.off": OFF,
    "a.obj": OBJ,
    "a.gltf": gltf_text(),
    "a.glb": glb(),
    "moving.gltf": gltf_text(moving_gltf()),
    "a.aff": AFF,
}
