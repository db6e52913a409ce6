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


def gltf_text(document: dict[str, Any] | None = None) -> bytes:
    return json.dumps(document or gltf_document()).encode()


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
    "a.aff": AFF,
}
