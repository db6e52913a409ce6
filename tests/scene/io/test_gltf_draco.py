"""Primitives of glTF that are compressed by Draco."""

from __future__ import annotations

import base64
import copy
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from extras import need
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import gltf_draco
from scene.io import tiny
from scene.io.test_gltf import read
from scene.io.tiny import with_buffer

TEXCOORDS = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5]])
COLORS = np.array([[255, 0, 51]] * 4, np.uint8)


def compressed() -> dict[str, Any]:
    """The tetrahedron with texture coordinates and colours; none of its accessors has data."""
    need("DracoPy")
    import DracoPy

    content = DracoPy.encode(
        tiny.TETRAHEDRON,
        tiny.SIDES,
        quantization_bits=16,
        preserve_order=True,
        tex_coord=TEXCOORDS,
        colors=COLORS,
    )
    kinds = {3: "TEXCOORD_0", 2: "COLOR_0", 0: "POSITION"}  # types of Draco's attributes
    ids = {
        kinds[one["attribute_type"]]: one["unique_id"] for one in DracoPy.decode(content).attributes
    }
    document = with_buffer(tiny.gltf_document(), np.frombuffer(content, np.uint8))
    document["accessors"] = [
        {"componentType": 5126, "count": 4, "type": "VEC3"},
        {"componentType": 5125, "count": 12, "type": "SCALAR"},
        {"componentType": 5126, "count": 4, "type": "VEC2"},
        {"componentType": 5121, "count": 4, "type": "VEC3", "normalized": True},
    ]
    document["meshes"][0]["primitives"] = [
        {
            "attributes": {"POSITION": 0, "TEXCOORD_0": 2, "COLOR_0": 3},
            "indices": 1,
            "extensions": {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": ids}},
        }
    ]
    document["nodes"] = [{"mesh": 0}]
    document["extensionsRequired"] = document["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    return document


def primitive(document: dict[str, Any]) -> Any:
    return document["meshes"][0]["primitives"][0]


def extension(document: dict[str, Any]) -> Any:
    return primitive(document)["extensions"]["KHR_draco_mesh_compression"]


def test_a_compressed_mesh(tmp_path: Path) -> None:
    (mesh,) = read(tmp_path, compressed()).meshes
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)
    np.testing.assert_allclose(mesh.vertices, tiny.TETRAHEDRON, atol=1e-4)
    np.testing.assert_allclose(mesh.texcoords[:, 0], TEXCOORDS[:, 0], atol=1e-3)
    np.testing.assert_allclose(mesh.texcoords[:, 1], 1 - TEXCOORDS[:, 1], atol=1e-3)
    np.testing.assert_allclose(mesh.colors, COLORS / 255, atol=1e-6)


def test_without_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = compressed()
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(FileFormatError, match=r"a\.gltf.*DracoPy: pip install 'raystream\[draco\]"):
        read(tmp_path, document)


def of_bytes(document: dict[str, Any], change: Any) -> dict[str, Any]:
    """The document with other compressed bytes."""
    _, _, payload = document["buffers"][0]["uri"].partition(",")
    content = bytearray(base64.b64decode(payload))
    change(content)
    array = np.frombuffer(bytes(content), np.uint8)
    return with_buffer(document, array)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: extension(d).update(bufferView=1), "bufferViews has no entry 1"),
        (lambda d: extension(d)["attributes"].update(POSITION=99), "no attribute 99"),
        (lambda d: extension(d)["attributes"].update(POSITION="x"), "integer >= 0"),
        (lambda d: d["accessors"][1].update(count=9), "do not fit"),
        (lambda d: d["accessors"][0].update(count=5), "does not fit its accessor"),
        (lambda d: d["accessors"][2].update(componentType=5123), "does not fit its accessor"),
        (lambda d: d["accessors"][0].update(componentType=1), "does not fit its accessor"),
    ],
)
def test_damaged_documents(tmp_path: Path, change: Any, reason: str) -> None:
    document = compressed()
    change(document)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, document)


def cut(content: bytearray) -> None:
    del content[-20:]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (cut, "cannot be decoded"),
        (lambda b: b.__delitem__(slice(5, None)), "no header"),
        (lambda b: b.__setitem__(0, 0), "no header"),
        (lambda b: b.__setitem__(7, 0), "no triangles"),
        (lambda b: b.__setitem__(5, 1), "another version"),
        (lambda b: b.__setitem__(10, 0x80), "with metadata"),
        (lambda b: b.__setitem__(slice(11, 13), b"\xff\xff\xff\xff\x07\0"), "claim 2,147,483,647"),
    ],
)
def test_damaged_data(tmp_path: Path, change: Any, reason: str) -> None:
    document = of_bytes(compressed(), change)
    assert gltf_draco.MAX_TRIANGLES_PER_BYTE < 2**31 / 200
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, document)


def test_changed_bytes_of_the_data(tmp_path: Path) -> None:
    """They end in one clear error, or in some mesh."""
    document, messages = compressed(), []
    random = np.random.default_rng(1)

    def change(content: bytearray) -> None:
        for place in random.integers(0, len(content), 3):
            content[place] = random.integers(256)

    for _ in range(100):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RaystreamWarning)  # indices of no vertices
            try:
                read(tmp_path, of_bytes(copy.deepcopy(document), change))
            except FileFormatError as error:
                messages.append(str(error))
    assert len(messages) > 50
    assert not any("\n" in message for message in messages)
