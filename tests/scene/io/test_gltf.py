"""glTF, text and binary."""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import quote_from_bytes

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import instances
from raystream.scene.io.gltf import read_gltf
from raystream.scene.lights import DirectionalLight, PointLight
from raystream.scene.scene import Scene
from scene.io import tiny
from scene.io.tiny import with_buffer


def read(tmp_path: Path, document: dict[str, Any]) -> Scene:
    path = tmp_path / "a.gltf"
    path.write_bytes(json.dumps(document).encode())
    return read_gltf(path)


def png() -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (3, 2), (255, 0, 0)).save(stream, "PNG")
    return stream.getvalue()


def test_nodes_move_their_children(tmp_path: Path) -> None:
    (mesh,) = read(tmp_path, tiny.gltf_document()).meshes
    np.testing.assert_allclose(mesh.vertices, tiny.TETRAHEDRON * 2 + [1, 0, 0])
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)
    assert mesh.name == "t"


def test_binary_files_hold_the_same(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(tiny.glb())
    (mesh,) = read_gltf(path).meshes
    np.testing.assert_allclose(mesh.vertices, tiny.TETRAHEDRON * 2 + [1, 0, 0])


def test_mirrored_nodes_keep_their_fronts(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["nodes"][1]["scale"] = [-1, 1, 1]
    (mesh,) = read(tmp_path, document).meshes
    corners = mesh.vertices[mesh.faces]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(1 / 6)
    assert mesh.vertices[:, 0].max() == 1.0


def test_instances_follow_the_order_of_nodes(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["scenes"][0]["nodes"] = [3, 0, 2]
    document["nodes"] += [
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 9, 0, 0, 1]},
        {"mesh": 0, "translation": [-9, 0, 0]},
    ]
    scene = read(tmp_path, document)
    assert [float(mesh.vertices[0, 0]) for mesh in scene.meshes] == [-9, 1, 9]


def test_rotation(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    half = 0.5**0.5
    document["nodes"][1] = {"mesh": 0, "rotation": [0, 0, half, half]}  # x to y
    (mesh,) = read(tmp_path, document).meshes
    np.testing.assert_allclose(mesh.vertices[1], [1, 1, 0], atol=1e-7)


def test_attributes(tmp_path: Path) -> None:
    colors = np.array([[255, 0, 128, 255]] * 4, np.uint8)
    texcoords = np.array([[0.25, 0.0]] * 4, np.float32)
    normals = np.array([[0, 0, 1]] * 4, np.float32)
    document = with_buffer(
        tiny.gltf_document(), tiny.TETRAHEDRON, tiny.SIDES, colors, texcoords, normals
    )
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5121, "count": 4, "type": "VEC4", "normalized": True},
        {"bufferView": 3, "componentType": 5126, "count": 4, "type": "VEC2"},
        {"bufferView": 4, "componentType": 5126, "count": 4, "type": "VEC3"},
    ]
    document["meshes"][0]["primitives"][0]["attributes"] = {
        "POSITION": 0,
        "COLOR_0": 2,
        "TEXCOORD_0": 3,
        "NORMAL": 4,
    }
    document["nodes"][1] = {"mesh": 0, "scale": [1, 1, 4]}
    (mesh,) = read(tmp_path, document).meshes
    assert mesh.colors is not None
    assert mesh.texcoords is not None
    assert mesh.normals is not None
    np.testing.assert_allclose(mesh.colors[0], [1, 0, 128 / 255])
    np.testing.assert_allclose(mesh.texcoords[0], [0.25, 1.0])
    np.testing.assert_allclose(mesh.normals[0], [0, 0, 1])


@pytest.mark.parametrize(
    ("mode", "faces"),
    [(5, [[0, 1, 2], [1, 3, 2]]), (6, [[0, 1, 2], [0, 2, 3]]), (4, [[0, 1, 2]])],
)
def test_strips_and_fans(tmp_path: Path, mode: int, faces: list[list[int]]) -> None:
    document = tiny.gltf_document()
    primitive = document["meshes"][0]["primitives"][0]
    del primitive["indices"]
    primitive["mode"] = mode
    (mesh,) = read(tmp_path, document).meshes
    assert mesh.faces.tolist() == faces


def test_strides_and_sparse_accessors(tmp_path: Path) -> None:
    wide = np.zeros((4, 5), np.float32)
    wide[:, 1:4] = tiny.TETRAHEDRON
    row, value = np.array([3], np.uint8), np.array([[0, 0, 7]], np.float32)
    document = with_buffer(tiny.gltf_document(), wide, tiny.SIDES.astype(np.uint8), row, value)
    document["bufferViews"][0]["byteStride"] = 20
    document["accessors"] = [
        {
            "bufferView": 0,
            "byteOffset": 4,
            "componentType": 5126,
            "count": 4,
            "type": "VEC3",
            "sparse": {
                "count": 1,
                "indices": {"bufferView": 2, "componentType": 5121},
                "values": {"bufferView": 3},
            },
        },
        {"bufferView": 1, "componentType": 5121, "count": 12, "type": "SCALAR"},
    ]
    document["nodes"] = [{"mesh": 0}]
    (mesh,) = read(tmp_path, document).meshes
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 7]]
    np.testing.assert_array_equal(mesh.faces, tiny.SIDES)


def test_materials_and_images(tmp_path: Path) -> None:
    image = base64.b64encode(png()).decode()
    (tmp_path / "My Map.png").write_bytes(png())
    document = tiny.gltf_document()
    document |= {
        "materials": [
            {
                "name": "m",
                "doubleSided": True,
                "alphaMode": "BLEND",
                "emissiveFactor": [1, 0.5, 0],
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
                    "roughnessFactor": 0.7,
                    "metallicFactor": 0.6,
                    "baseColorTexture": {"index": 0},
                },
                "normalTexture": {"index": 1, "scale": 0.25},
                "extensions": {
                    "KHR_materials_emissive_strength": {"emissiveStrength": 4},
                    "KHR_materials_ior": {"ior": 1.3},
                    "KHR_materials_transmission": {"transmissionFactor": 0.5},
                },
            }
        ],
        "textures": [{"source": 0, "sampler": 0}, {"source": 1}],
        "samplers": [{"wrapS": 33071, "wrapT": 33071}],
        "images": [{"uri": f"data:image/png;base64,{image}"}, {"uri": "my%20map.png"}],
    }
    document["meshes"][0]["primitives"][0]["material"] = 0
    scene = read(tmp_path, document)
    material = scene.materials[0]
    assert material.diffuse == (0.1, 0.2, 0.3)
    assert material.emission == (4, 2, 0)
    assert (material.opacity, material.roughness, material.metallic) == (0.4, 0.7, 0.6)
    assert (material.ior, material.transmission) == (1.0, (0.05, 0.1, 0.15))  # a thin pane
    assert material.normal_reflectance == pytest.approx((((1.3 - 1) / (1.3 + 1)) ** 2,) * 3)
    assert material.grazing_reflectance == 1.0
    assert material.double_sided
    assert material.normal_scale == 0.25
    assert material.textures["diffuse"].wrap == "clamp"
    assert material.textures["diffuse"].pixels().shape == (2, 3, 3)
    assert material.textures["normal"].path == tmp_path / "My Map.png"
    assert scene.meshes[0].material_ids.tolist() == [0] * 4


@pytest.mark.parametrize("mode", ["OPAQUE", "MASK", "BLEND", None, "bent"])
def test_alpha(tmp_path: Path, mode: str | None) -> None:
    """The base colour's alpha is the opacity where the mode says that it counts."""
    pixels = np.array([[[9, 9, 9, 0], [9, 9, 9, 255]]], np.uint8)
    Image.fromarray(pixels, "RGBA").save(tmp_path / "a.png")
    surface = {"baseColorFactor": [1, 1, 1, 0.75], "baseColorTexture": {"index": 0}}
    material: dict[str, Any] = {"pbrMetallicRoughness": surface}
    material |= {} if mode is None else {"alphaMode": mode}
    document = tiny.gltf_document()
    document |= {"materials": [material, material | {"alphaCutoff": 0.25}]}
    document |= {"textures": [{"source": 0}], "images": [{"uri": "a.png"}]}
    document["meshes"][0]["primitives"][0]["material"] = 0
    first, second = read(tmp_path, document).materials[:2]
    if mode in ("MASK", "BLEND"):
        assert first.opacity == 0.75
        assert first.textures["opacity"].pixels().tolist() == [[[0], [255]]]
        assert first.textures["opacity"] is second.textures["opacity"]
    else:
        assert first.is_opaque
        assert second.is_opaque
    is_mask = mode == "MASK"
    cutoffs = (first.alpha_cutoff, second.alpha_cutoff)
    assert cutoffs == ((0.5, 0.25) if is_mask else (None, None))


def test_volumes_absorb(tmp_path: Path) -> None:
    def glass(**volume: Any) -> dict[str, Any]:
        through = {"transmissionFactor": volume.pop("through", 1)}
        extensions = {"KHR_materials_transmission": through, "KHR_materials_volume": volume}
        return {"extensions": extensions}

    color = {"attenuationDistance": 2, "attenuationColor": [1, 0.25, 0]}
    document = tiny.gltf_document()
    document["materials"] = [
        glass(**color, thicknessFactor=1),
        glass(**color),  # thin
        glass(**color, thicknessFactor=1, through=0),
        glass(thicknessFactor=1),
        glass(**color | {"attenuationDistance": 0}, thicknessFactor=1),
    ]
    found = [material.absorption for material in read(tmp_path, document).materials]
    np.testing.assert_allclose(np.exp(-2 * np.array(found[0])), [1, 0.25, 0], atol=1e-15)
    assert found[1:5] == [(0, 0, 0)] * 4


def test_missing_and_remote_images_warn_once(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document |= {
        "materials": [
            {
                "normalTexture": {"index": 0},
                "occlusionTexture": {"index": 1},
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}},
            }
        ],
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"uri": "no.png"}, {"uri": "https://example.org/no.png"}],
    }
    with pytest.warns(RaystreamWarning, match=r"a\.gltf: images not found") as caught:
        scene = read(tmp_path, document)
    assert len(caught) == 1
    assert not scene.materials[0].textures


def test_orthographic_cameras_have_the_height_of_the_file(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["scenes"][0]["nodes"] += [2, 3]
    half = 0.5**0.5
    document["nodes"] += [
        {"translation": [1, 2, 3], "rotation": [0, half, 0, half], "scale": [5, 5, 5], "camera": 0},
        {"camera": 1},
    ]
    box = {"xmag": 4, "ymag": 1.5, "znear": 0, "zfar": 10}
    document["cameras"] = [
        {"type": "orthographic", "orthographic": box},
        {"type": "perspective", "perspective": {"yfov": 0.5}},
    ]
    camera = read(tmp_path, document).camera
    assert (camera.projection, camera.height) == ("orthographic", 3.0)
    assert camera.eye == (1, 2, 3)
    assert camera.look_at == pytest.approx((0, 2, 3))  # -z turned by 90 degrees about y
    box["ymag"] = -1.5  # discouraged, and seen upside down by few programs
    assert read(tmp_path, document).camera.height == 3.0
    document["cameras"][0]["type"] = "panoramic"
    assert read(tmp_path, document).camera.projection == "perspective"


@pytest.mark.parametrize("box", [{}, {"ymag": 0}, {"ymag": "high"}, {"ymag": 1.5e308}, 5])
def test_orthographic_cameras_without_a_height(tmp_path: Path, box: Any) -> None:
    document = tiny.gltf_document()
    document["nodes"][0]["camera"] = 0
    document["cameras"] = [{"type": "orthographic", "orthographic": box}]
    with pytest.raises(FileFormatError, match=r"height|ymag|orthographic"):
        read(tmp_path, document)


def test_camera_and_lights(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["scenes"][0]["nodes"] += [2, 3]
    half = 0.5**0.5
    document["nodes"] += [
        {
            "translation": [0, 1, 5],
            "camera": 0,
            "extensions": {"KHR_lights_punctual": {"light": 0}},
        },
        {"rotation": [-half, 0, 0, half], "extensions": {"KHR_lights_punctual": {"light": 1}}},
    ]
    document["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}]
    document["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "point", "intensity": 3, "color": [1, 0.5, 0]},
                {"type": "directional", "intensity": 2},
            ]
        }
    }
    document["extensionsRequired"] = ["KHR_lights_punctual"]
    scene = read(tmp_path, document)
    assert scene.camera.eye == (0, 1, 5)
    assert scene.camera.look_at == pytest.approx((0, 1, 4))
    assert scene.camera.fov == pytest.approx(np.degrees(0.5))
    point, sun = scene.lights
    assert point == PointLight((0, 1, 5), (3, 1.5, 0))
    assert isinstance(sun, DirectionalLight)
    assert sun.direction == pytest.approx((0, -1, 0))
    assert sun.irradiance == (2, 2, 2)


def test_bad_indices_are_counted_over_all_primitives(tmp_path: Path) -> None:
    document = with_buffer(
        tiny.gltf_document(), tiny.TETRAHEDRON, np.array([[0, 1, 2], [1, 2, 9]], np.uint16)
    )
    document["accessors"][1]["count"] = 6
    document["meshes"][0]["primitives"] *= 2
    with pytest.warns(RaystreamWarning, match="dropped: 2 triangles") as caught:
        scene = read(tmp_path, document)
    assert len(caught) == 1
    assert scene.triangle_count == 2


def test_buffers_in_files(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    payload = tiny.TETRAHEDRON.tobytes() + tiny.SIDES.astype(np.uint16).tobytes()
    (tmp_path / "points.bin").write_bytes(payload)
    document["buffers"][0]["uri"] = "points.bin"
    assert read(tmp_path, document).triangle_count == 4
    (tmp_path / "points.bin").write_bytes(payload[:-1])
    with pytest.raises(FileFormatError, match="buffer 0 declares 72 bytes and has 71"):
        read(tmp_path, document)


def test_files_outside_the_folder_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret.bin").write_bytes(b"\0" * 72)
    folder = tmp_path / "model"
    folder.mkdir()
    for uri in (
        "../secret.bin",
        str(tmp_path / "secret.bin"),
        "%2e%2e/secret.bin",
        "file:///etc/passwd",
        "http://example.org/a.bin",
    ):
        document = tiny.gltf_document()
        document["buffers"][0]["uri"] = uri
        with pytest.raises(FileFormatError, match="not found next to it"):
            read(folder, document)


def test_instances_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instances, "MAX_INSTANCED_TRIANGLES", 10)
    document = tiny.gltf_document()
    document["nodes"][0]["children"] = [1, 2, 3]
    document["nodes"] += [{"mesh": 0}, {"mesh": 0}]
    with pytest.raises(FileFormatError, match="add up to more than 10"):
        read(tmp_path, document)


def changed(path: str, value: Any) -> dict[str, Any]:
    """The tiny document with one entry replaced; ``path`` is keys and indices with slashes."""
    document = tiny.gltf_document()
    place: Any = document
    *parents, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in parents:
        place = place[key]
    place[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("asset/version", "1.0", "not supported"),
        ("extensionsRequired", ["ACME_fur"], "ACME_fur"),
        ("nodes/1/children", [0], "occurs twice"),
        ("nodes/0/children", [1, 1], "occurs twice"),
        ("nodes/0/children", [7], "nodes has no entry 7"),
        ("nodes/0/children", [-1], "integer >= 0"),
        ("nodes/0/children", 1, "not a list"),
        ("nodes/0/translation", [1, 2], "list of 3 numbers"),
        ("nodes/0/translation", [1, 2, "x"], "not a number"),
        ("nodes/0/matrix", [1e999] * 16, "not a finite number"),
        ("nodes/1/mesh", 3, "meshes has no entry 3"),
        ("nodes/1/mesh", True, "integer >= 0"),
        ("meshes/0", [], "not an object"),
        ("meshes/0/primitives/0", 5, "an invalid primitive"),
        ("meshes/0/primitives/0/material", 0, "materials has no entry 0"),
        ("meshes/0/primitives/0/indices", 0, "unexpected type"),
        ("accessors/0/count", 5, "exceed buffer view 0"),
        ("accessors/0/count", 10**15, "exceed buffer view 0"),
        ("accessors/0/byteOffset", 4, "exceed buffer view 0"),
        ("accessors/0/componentType", 1, "unexpected type"),
        ("accessors/0/type", ["VEC3"], "unexpected type"),
        ("accessors/1", {"componentType": 5123, "count": 10**12, "type": "SCALAR"}, "no buffer"),
        ("bufferViews/0/byteStride", 4, "stride"),
        ("bufferViews/0/byteLength", 400, "exceeds its buffer"),
        ("bufferViews/0/buffer", 1, "buffers has no entry 1"),
        ("buffers/0/byteLength", 10**14, "truncated"),
        ("buffers/0/uri", "data:;base64,????", "truncated|decoded"),
        ("buffers/0/uri", 5, "not text"),
        ("scene", 4, "scenes has no entry 4"),
    ],
)
def test_damaged_documents(tmp_path: Path, path: str, value: Any, reason: str) -> None:
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, changed(path, value))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"glTF\2\0\0\0", "truncated"),
        (b"glTF" + struct.pack("<II", 1, 20) + b"\0" * 8, "version 1"),
        (tiny.glb()[:-1], "truncated"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 2**31, 0x4E4F534A), "longer than the file"),
        (b"[" * 200_000, "not a glTF file"),
        (b"[]", "not an object"),
        (b"\xff\xfe", "not a glTF file"),
    ],
)
def test_damaged_containers(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=reason):
        read_gltf(path)


def test_buffers_as_programs_write_them(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    payload = tiny.TETRAHEDRON.tobytes() + tiny.SIDES.astype(np.uint16).tobytes()
    (tmp_path / "a%20b.bin").write_bytes(payload)  # named as its uri should not be read
    for uri in ("data:application/octet-stream," + quote_from_bytes(payload), "a%20b.bin"):
        document["buffers"][0]["uri"] = uri
        vertices = read(tmp_path, document).meshes[0].vertices
        np.testing.assert_array_equal(vertices, 2 * tiny.TETRAHEDRON + [1, 0, 0])


def test_extensions_that_are_not_supported_are_named_once(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["extensionsUsed"] = ["KHR_materials_iridescence", "KHR_materials_ior", "ACME_fur", 7]
    names = r'ignored: "ACME_fur", "KHR_materials_iridescence"$'
    with pytest.warns(RaystreamWarning, match=names) as caught:
        assert read(tmp_path, document).triangle_count == 4
    assert len(caught) == 1
    document["extensionsUsed"] = ["KHR_materials_unlit", "EXT_meshopt_compression"]
    document["extensionsRequired"] = ["KHR_materials_unlit"]
    read(tmp_path, document)  # without a warning
    document["extensionsRequired"] += ["ACME_fur"]
    with pytest.raises(FileFormatError, match='needs the extension "ACME_fur"'):
        read(tmp_path, document)


def test_compressed_buffers_without_a_plain_copy(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    extensions = {"EXT_meshopt_compression": {"fallback": True}}
    document["buffers"] = [{"byteLength": 72, "extensions": extensions}]
    with pytest.raises(FileFormatError, match="buffer view 0 has no data"):
        read(tmp_path, document)


def copied_document(count: int = 5) -> tuple[dict[str, Any], np.ndarray]:
    """A tetrahedron with copies by EXT_mesh_gpu_instancing, and their matrices to the node."""
    rng = np.random.default_rng(1)
    shifts = rng.uniform(-9.0, 9.0, (count, 3)).astype(np.float32)
    turns = rng.normal(size=(count, 4))
    turns = np.round(turns / np.linalg.norm(turns, axis=1)[:, None] * 32767).astype(np.int16)
    scales = rng.uniform(-2.0, 2.0, (count, 3)).astype(np.float32)
    arrays = tiny.TETRAHEDRON, tiny.SIDES.astype(np.uint16), shifts, turns, scales
    document = tiny.with_buffer(tiny.gltf_document(), *arrays)
    document["accessors"] += [
        {"bufferView": 2, "componentType": 5126, "count": count, "type": "VEC3"},
        {
            "bufferView": 3,
            "componentType": 5122,
            "count": count,
            "type": "VEC4",
            "normalized": True,
        },
        {"bufferView": 4, "componentType": 5126, "count": count, "type": "VEC3"},
    ]
    attributes = {"TRANSLATION": 2, "ROTATION": 3, "SCALE": 4}
    document["nodes"][1]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    document["extensionsUsed"] = document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    matrices = np.tile(np.eye(4), (count, 1, 1))
    for matrix, shift, turn, scale in zip(matrices, shifts, turns, scales, strict=True):
        x, y, z, w = turn / np.linalg.norm(turn.astype(float))
        # q v q* of the three axes, by the cross products of Rodrigues' formula
        axes = np.eye(3) * scale
        crossed = np.cross([x, y, z], axes) * 2.0
        matrix[:3, :3] = (axes + w * crossed + np.cross([x, y, z], crossed)).T
        matrix[:3, 3] = shift
    return document, matrices


def test_copies_of_the_gpu_extension(tmp_path: Path) -> None:
    document, matrices = copied_document()
    scene = read(tmp_path, document)
    node = np.diag([2.0, 2.0, 2.0, 1.0])
    node[0, 3] = 1.0
    assert len(scene.meshes) == 5
    for mesh, matrix in zip(scene.meshes, node @ matrices, strict=True):
        expected = tiny.TETRAHEDRON @ matrix[:3, :3].T + matrix[:3, 3]
        np.testing.assert_allclose(mesh.vertices, expected, atol=2e-4)
    placed = rs.load(tmp_path / "a.gltf", instances=True)
    assert placed.triangle_count == 4
    np.testing.assert_allclose(placed.placements.transforms, (node @ matrices)[:, :3], atol=2e-4)
    for mesh, copy in zip(placed.flattened().meshes, scene.meshes, strict=True):
        np.testing.assert_array_equal(mesh.faces, copy.faces)
        np.testing.assert_allclose(mesh.vertices, copy.vertices, atol=1e-12)


def test_nodes_that_share_a_mesh_are_instances(tmp_path: Path) -> None:
    document = tiny.gltf_document()
    document["nodes"][0]["children"] += [2, 3]
    document["nodes"] += [{"mesh": 0, "scale": [1, 1, -1]}, {"mesh": 0, "scale": [1, 0, 1]}]
    read(tmp_path, document)
    with pytest.warns(RaystreamWarning, match="1 instances left out"):
        placed = rs.load(tmp_path / "a.gltf", instances=True)
    assert len(placed.meshes) == 1
    assert placed.placements.object_ids.tolist() == [0, 0]
    with pytest.raises(ValueError, match=r"instances: not supported for \.obj files"):
        rs.load(tiny_obj(tmp_path), instances=True)
    with pytest.raises(ValueError, match="instances: only for glTF"):
        rs.load("cornell", instances=True)


def tiny_obj(folder: Path) -> Path:
    path = folder / "x.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return path


def test_deformed_meshes_are_objects_of_their_own(tmp_path: Path) -> None:
    document = tiny.moving_gltf()
    scene = read(tmp_path, document)
    for time in (0.0, 1.0):
        placed = rs.load(tmp_path / "a.gltf", instances=True, time=time)
        posed = scene.at(time) if time else scene
        for mesh, other in zip(placed.flattened().meshes, posed.meshes, strict=True):
            np.testing.assert_allclose(mesh.vertices, other.vertices, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d["accessors"][2].update(count=4), r"have \[4, 5\] copies"),
        (lambda d: d["accessors"][3].update(type="VEC3"), "unexpected type"),
        (lambda d: d["nodes"][1]["extensions"].update(EXT_mesh_gpu_instancing=7), "damaged"),
    ],
)
def test_damaged_copies_are_refused(tmp_path: Path, change, reason) -> None:
    document, _ = copied_document()
    change(document)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, document)
