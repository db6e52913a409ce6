"""Buffer views of glTF that are compressed by meshoptimizer."""

from __future__ import annotations

import base64
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from extras import need
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import gltf_file, gltf_meshopt
from scene.io import tiny
from scene.io.test_gltf import read

NORMALS = np.array([[1, 0, 0], [0, 1, 0], [0, 0.6, 0.8], [-0.48, 0.6, -0.64]], np.float32)
NAMES = ("EXT_meshopt_compression", "KHR_meshopt_compression")


def compressed(name: str = NAMES[0]) -> dict[str, Any]:
    """The tetrahedron: positions exponential, normals octahedral, indices of triangles."""
    need("meshopt")
    import meshopt

    four = np.column_stack([NORMALS, np.zeros(4, np.float32)])
    parts = [
        (meshopt.encode_filter_exp(tiny.TETRAHEDRON, 20), "ATTRIBUTES", "EXPONENTIAL"),
        (meshopt.encode_filter_oct(four, 8, 14), "ATTRIBUTES", "OCTAHEDRAL"),
        (tiny.SIDES, "TRIANGLES", "NONE"),
        (np.arange(12, dtype=np.uint32), "INDICES", "NONE"),
    ]
    content, views = b"", []
    for data, mode, filter_ in parts:
        packed = meshopt.encode_gltf_buffer(data, mode)
        size = data.shape[1] if mode == "ATTRIBUTES" else 4
        count = data.nbytes // size
        place = {"buffer": 0, "byteOffset": len(content), "byteLength": len(packed)}
        own = {**place, "byteStride": size, "count": count, "mode": mode, "filter": filter_}
        view = {"buffer": 1, "byteLength": count * size, "extensions": {name: own}}
        views.append(view | ({"byteStride": size} if mode == "ATTRIBUTES" else {}))
        content += packed
    document = tiny.gltf_document()
    uri = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    document["buffers"] = [
        {"byteLength": len(content), "uri": uri},
        {"byteLength": 256, "extensions": {name: {"fallback": True}}},
    ]
    document["bufferViews"] = views
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5122, "count": 4, "type": "VEC3", "normalized": True},
        {"bufferView": 2, "componentType": 5125, "count": 12, "type": "SCALAR"},
        {"bufferView": 3, "componentType": 5125, "count": 12, "type": "SCALAR"},
    ]
    attributes = {"POSITION": 0, "NORMAL": 1}
    document["meshes"] = [{"primitives": [{"attributes": attributes, "indices": 2}]}]
    document["nodes"] = [{"mesh": 0}]
    document["extensionsRequired"] = document["extensionsUsed"] = [name]
    return document


def extension(document: dict[str, Any], view: int = 0) -> Any:
    return document["bufferViews"][view]["extensions"][NAMES[0]]


@pytest.mark.parametrize("name", NAMES)
def test_a_compressed_mesh(tmp_path: Path, name: str) -> None:
    (mesh,) = read(tmp_path, compressed(name)).meshes
    # The codec may turn a triangle, but keeps its side.
    turned = [{tuple(np.roll(face, k)) for k in range(3)} for face in tiny.SIDES.tolist()]
    assert all(tuple(face) in turns for face, turns in zip(mesh.faces, turned, strict=True))
    np.testing.assert_array_equal(mesh.vertices, tiny.TETRAHEDRON)
    np.testing.assert_allclose(mesh.normals, NORMALS, atol=1e-3)


def test_indices_in_sequence(tmp_path: Path) -> None:
    """Three vertices for each triangle: their numbers are not reordered."""
    document = compressed()
    primitive = document["meshes"][0]["primitives"][0]
    document["accessors"][3]["count"] = 3
    primitive["indices"] = 3
    del primitive["attributes"]["NORMAL"]
    (mesh,) = read(tmp_path, document).meshes
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_without_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = compressed()
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(FileFormatError, match=r"meshopt: pip install 'raystream\[meshopt\]'"):
        read(tmp_path, document)


def test_a_plain_copy_needs_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshopt", None)
    document = tiny.gltf_document()
    document["extensionsUsed"] = [NAMES[0]]
    for view in document["bufferViews"]:
        view["extensions"] = {NAMES[0]: {"buffer": 7}}
    assert read(tmp_path, document).triangle_count == 4


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: extension(d).update(mode="POINTS"), "no mode, filter or stride"),
        (lambda d: extension(d).update(mode=7), "no mode, filter or stride"),
        (lambda d: extension(d).update(filter="BLUR"), "no mode, filter or stride"),
        (lambda d: extension(d).update(filter="QUATERNION"), "no mode, filter or stride"),
        (lambda d: extension(d).update(byteStride=6), "no mode, filter or stride"),
        (lambda d: extension(d).update(count=5), "do not fit their buffer view"),
        (lambda d: extension(d).update(count=0), "do not fit their buffer view"),
        (lambda d: extension(d).update(buffer=5), "buffers has no entry 5"),
        (lambda d: extension(d).update(buffer=1), "buffer 1"),
        (lambda d: extension(d).update(byteLength=9999), "exceeds its buffer"),
        (lambda d: extension(d).update(byteLength=3), "cannot be decoded"),
        (lambda d: extension(d, 2).update(byteLength=2), "cannot be decoded"),
        (lambda d: d["bufferViews"][0].pop("extensions"), "buffer view 0 has no data"),
    ],
)
def test_damaged_documents(tmp_path: Path, change: Any, reason: str) -> None:
    document = compressed()
    change(document)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, document)


def test_sizes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    document = compressed()
    count = 1 << 40
    extension(document).update(count=count)
    document["bufferViews"][0]["byteLength"] = 12 * count
    with pytest.raises(FileFormatError, match="over 4,294,967,296 bytes"):
        read(tmp_path, document)
    monkeypatch.setattr(gltf_file, "MAX_DECODED_BYTES", 1 << 60)
    with pytest.raises(FileFormatError, match=r"bytes of meshopt claim 1,099,511,627,776 elements"):
        read(tmp_path, document)


def test_the_bound_is_that_of_the_codec() -> None:
    """The smallest data of the largest block: vertices that are all equal."""
    need("meshopt")
    import meshopt

    equal = np.zeros((65536, 32), np.uint8)
    for version in (0, 1):
        packed = meshopt.encode_vertex_buffer_level(equal, 3, version)
        assert equal.nbytes <= gltf_meshopt.MAX_RATIO * len(packed)


def test_changed_bytes_of_the_data(tmp_path: Path) -> None:
    """They end in one clear error, or in some mesh."""
    random = np.random.default_rng(1)
    plain = compressed()
    head, _, payload = plain["buffers"][0]["uri"].partition(",")
    read_count, messages = 0, []
    for _ in range(300):
        content = bytearray(base64.b64decode(payload))
        for _ in range(random.integers(1, 4)):
            content[random.integers(len(content))] = random.integers(256)
        plain["buffers"][0]["uri"] = f"{head},{base64.b64encode(bytes(content)).decode()}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RaystreamWarning)  # indices of no vertices
            try:
                read(tmp_path, plain)
                read_count += 1
            except FileFormatError as error:
                messages.append(str(error))
    assert read_count
    assert messages
    assert not any("\n" in message for message in messages)
