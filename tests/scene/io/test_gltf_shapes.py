"""Skins and morph targets of glTF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import gltf_file
from scene.io import tiny
from scene.io.test_gltf import read
from scene.io.tiny import with_buffer

POINTS = tiny.TETRAHEDRON
NORMALS = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0], [0, 0, 1]], np.float32)
JOINTS = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 9, 9]], np.uint8)
WEIGHTS = np.array([[1, 1, 0, 0], [4, 0, 0, 0], [0, 0, 0, 0], [0.25, 0.75, 0, 0]], np.float32)
BENT = np.array([[0, 0, 0], [0, 0, 2], [0, 0, 0], [1, 0, 0]], np.float32)
LIFTED = np.array([[0, 1, 0]] * 4, np.float32)
TIMES = np.array([0, 2], np.float32)
TURNS = np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.float32)  # by 180 degrees about z
SHARES = np.array([0, 0.5, 1, -1], np.float32)  # two targets at two times

#: Inverses of where the joints are when the mesh is bound: at (0, 0, 0) and at (1, 0, 0).
INVERSES = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
INVERSES[1, 0, 3] = -1


def document() -> dict[str, Any]:
    """Node 0 holds the mesh, nodes 1 and 2 are joints; the mesh has no targets and no skin yet."""
    made = with_buffer(
        tiny.gltf_document(),
        *(POINTS, tiny.SIDES, NORMALS, JOINTS, WEIGHTS, BENT, LIFTED, TIMES, TURNS, SHARES),
        INVERSES.transpose(0, 2, 1).copy(),
    )
    layouts = [
        (5126, 4, "VEC3"),
        (5125, 12, "SCALAR"),
        (5126, 4, "VEC3"),
        (5121, 4, "VEC4"),
        (5126, 4, "VEC4"),
        (5126, 4, "VEC3"),
        (5126, 4, "VEC3"),
        (5126, 2, "SCALAR"),
        (5126, 2, "VEC4"),
        (5126, 4, "SCALAR"),
        (5126, 2, "MAT4"),
    ]
    made["accessors"] = [
        {"bufferView": k, "componentType": kind, "count": count, "type": shape}
        for k, (kind, count, shape) in enumerate(layouts)
    ]
    made["meshes"][0]["primitives"][0]["attributes"] = {"POSITION": 0, "NORMAL": 2}
    made["nodes"] = [
        {"mesh": 0, "translation": [0, 0, 5]},
        {"translation": [0, 2, 0]},
        {"translation": [1, 0, 3], "scale": [2, 2, 2]},
    ]
    made["scenes"][0]["nodes"] = [0, 1, 2]
    return made


def with_skin() -> dict[str, Any]:
    made = document()
    attributes = made["meshes"][0]["primitives"][0]["attributes"]
    attributes |= {"JOINTS_0": 3, "WEIGHTS_0": 4}
    made["skins"] = [{"joints": [1, 2], "inverseBindMatrices": 10}]
    made["nodes"][0]["skin"] = 0
    return made


def with_targets() -> dict[str, Any]:
    made = document()
    primitive = made["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": 5, "NORMAL": 6}, {"POSITION": 6}]
    return made


def animated(made: dict[str, Any], node: int, path: str, output: int) -> dict[str, Any]:
    channel = {"sampler": 0, "target": {"node": node, "path": path}}
    made["animations"] = [{"channels": [channel], "samplers": [{"input": 7, "output": output}]}]
    return made


def of_joints(*matrices: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Where the specification puts the vertices: the weighted mean of joint times inverse bind."""
    moved = [matrix @ inverse for matrix, inverse in zip(matrices, INVERSES, strict=True)]
    shares = [[0.5, 0.5], [0, 1], [1, 0], [0.75, 0.25]]  # of joints 0 and 1, with a sum of 1
    found = []
    for point, (first, second) in zip(POINTS, shares, strict=True):
        found.append(((first * moved[0] + second * moved[1]) @ [*point, 1])[:3])
    return np.array(found)


def placed(translation: list[float], size: float = 1.0) -> np.ndarray[Any, Any]:
    matrix = np.diag([size, size, size, 1.0])
    matrix[:3, 3] = translation
    return matrix


SECOND = placed([1, 0, 3], 2)


def test_a_skin_at_rest(tmp_path: Path) -> None:
    """The mesh's own node does not move it, and weights are normalised."""
    (mesh,) = read(tmp_path, with_skin()).meshes
    expected = of_joints(placed([0, 2, 0]), SECOND)
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)
    np.testing.assert_allclose(mesh.normals, NORMALS, atol=1e-6)


def test_a_skin_follows_its_joints(tmp_path: Path) -> None:
    scene = read(tmp_path, animated(with_skin(), 1, "rotation", 8))
    for time in (0.0, 0.5, 1.5, 2.0):
        c, s = np.cos(time * np.pi / 2), np.sin(time * np.pi / 2)
        turn = placed([0, 2, 0])
        turn[:2, :2] = [[c, -s], [s, c]]
        mesh = scene.at(time).meshes[0]
        np.testing.assert_allclose(mesh.vertices, of_joints(turn, SECOND), atol=1e-6)
        np.testing.assert_allclose(mesh.normals[2], [c, s, 0], atol=1e-6)  # of the first joint
        assert mesh.faces is scene.meshes[0].faces
    assert scene.at(3.0).meshes[0] is scene.at(4.0).meshes[0]


def test_without_inverse_bind_matrices(tmp_path: Path) -> None:
    made = with_skin()
    del made["skins"][0]["inverseBindMatrices"]
    (mesh,) = read(tmp_path, made).meshes
    np.testing.assert_allclose(mesh.vertices[1], 2 * POINTS[1] + [1, 0, 3], atol=1e-6)


def test_weights_as_normalised_integers(tmp_path: Path) -> None:
    made = with_skin()
    shares = np.array([[128, 127, 0, 0], [0, 255, 0, 0], [255, 0, 0, 0], [51, 204, 0, 0]], np.uint8)
    arrays = [POINTS, tiny.SIDES, NORMALS, np.array([[0, 1, 0, 0]] * 4, np.uint16), shares]
    made = with_buffer(made, *arrays)
    del made["skins"][0]["inverseBindMatrices"]
    made["accessors"][3]["componentType"] = 5123
    made["accessors"][4] |= {"componentType": 5121, "normalized": True}
    (mesh,) = read(tmp_path, made).meshes
    first, second = POINTS + [0, 2, 0], 2 * POINTS + [1, 0, 3]
    share = shares[:, 1:2] / 255
    np.testing.assert_allclose(mesh.vertices, (1 - share) * first + share * second, atol=1e-6)


def test_morph_targets_at_rest(tmp_path: Path) -> None:
    made = with_targets()
    (mesh,) = read(tmp_path, made).meshes
    np.testing.assert_array_equal(mesh.vertices, POINTS + [0, 0, 5])
    made["meshes"][0]["weights"] = [0.5, 2]
    (mesh,) = read(tmp_path, made).meshes
    expected = POINTS + 0.5 * BENT + 2 * LIFTED + [0, 0, 5]
    np.testing.assert_allclose(mesh.vertices, expected)
    bent = NORMALS + 0.5 * LIFTED
    expected = bent / np.linalg.norm(bent, axis=1)[:, None]
    np.testing.assert_allclose(mesh.normals, expected, atol=1e-6)
    made["nodes"][0]["weights"] = [0, 1]  # the node's before the mesh's
    (mesh,) = read(tmp_path, made).meshes
    np.testing.assert_allclose(mesh.vertices, POINTS + LIFTED + [0, 0, 5])


def test_animated_weights(tmp_path: Path) -> None:
    scene = read(tmp_path, animated(with_targets(), 0, "weights", 9))
    np.testing.assert_array_equal(scene.meshes[0].vertices, POINTS + [0, 0, 5])
    for time in (0.0, 1.0, 2.0):
        first, second = time / 2, 0.5 - 1.5 * time / 2
        (mesh,) = scene.at(time).meshes
        expected = POINTS + first * BENT + second * LIFTED + [0, 0, 5]
        np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)
        assert mesh.faces is scene.meshes[0].faces


def test_cubic_weights(tmp_path: Path) -> None:
    """Of two targets at one key: tangents, values, tangents."""
    made = animated(with_targets(), 0, "weights", 9)
    made["animations"][0]["samplers"][0]["interpolation"] = "CUBICSPLINE"
    keys = np.array([9, 9, 0.25, 3, 9, 9, 9, 9, 0.25, 3, 9, 9], np.float32)
    arrays = [POINTS, tiny.SIDES, NORMALS, JOINTS, WEIGHTS, BENT, LIFTED, TIMES, TURNS, keys]
    made = with_buffer(made, *arrays)
    made["accessors"][9]["count"] = 12
    del made["accessors"][10]
    (mesh,) = read(tmp_path, made).at(2.0).meshes
    np.testing.assert_allclose(mesh.vertices, POINTS + 0.25 * BENT + 3 * LIFTED + [0, 0, 5])


def test_a_skin_over_morph_targets(tmp_path: Path) -> None:
    made = with_skin()
    primitive = made["meshes"][0]["primitives"][0]
    primitive["targets"] = [{"POSITION": 6}]
    made["meshes"][0]["weights"] = [3]
    (mesh,) = read(tmp_path, made).meshes
    lifted = of_joints(placed([0, 2, 0]), SECOND)
    lifted[:, 1] += 3 * np.array([1.5, 2, 1, 1.25])  # the mean of 1 and of the second's 2
    np.testing.assert_allclose(mesh.vertices, lifted, atol=1e-6)


def test_joints_outside_the_scene(tmp_path: Path) -> None:
    made = with_skin()
    made["scenes"][0]["nodes"] = [0, 1]
    with pytest.warns(RaystreamWarning, match="1 skinned meshes left in their bind pose"):
        (mesh,) = read(tmp_path, made).meshes
    np.testing.assert_array_equal(mesh.vertices, POINTS)


def attributes(made: dict[str, Any]) -> Any:
    return made["meshes"][0]["primitives"][0]["attributes"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d["skins"][0].update(joints=[]), "no joints"),
        (lambda d: d["skins"][0].update(joints=[1, 9]), "nodes has no entry 9"),
        (lambda d: d["skins"][0].update(joints=[1]), "a joint beyond 1"),
        (lambda d: d["skins"][0].update(joints=[0, 1, 2]), "2 matrices for 3 joints"),
        (lambda d: d["skins"][0].update(joints=7), "not a list"),
        (lambda d: d["skins"][0].update(inverseBindMatrices=0), "unexpected type"),
        (lambda d: d["nodes"][0].update(skin=1), "skins has no entry 1"),
        (lambda d: attributes(d).update(JOINTS_0=4), "joints are not unsigned"),
        (lambda d: attributes(d).update(WEIGHTS_0=0), "unexpected type"),
        (lambda d: d["accessors"][3].update(count=3), "JOINTS_0 has 3 rows for 4"),
    ],
)
def test_damaged_skins(tmp_path: Path, change: Any, reason: str) -> None:
    made = with_skin()
    change(made)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, made)


def targets(made: dict[str, Any]) -> Any:
    return made["meshes"][0]["primitives"][0]["targets"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d["nodes"][0].update(weights=[1]), "1 weights for 2 morph targets"),
        (lambda d: d["nodes"][0].update(weights=[1, "x"]), "not a number"),
        (lambda d: targets(d).__setitem__(1, 3), "not an object"),
        (lambda d: targets(d)[0].update(POSITION=4), "unexpected type"),
        (lambda d: d["accessors"][5].update(count=3), "3 rows for 4"),
        (lambda d: d["accessors"][9].update(count=3), "2 times and 1 values"),
        (
            lambda d: d["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}}),
            "differ in their morph targets",
        ),
    ],
)
def test_damaged_morph_targets(tmp_path: Path, change: Any, reason: str) -> None:
    made = animated(with_targets(), 0, "weights", 9)
    change(made)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, made)


def test_deformations_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf_file, "MAX_DEFORMATION_NUMBERS", 30)
    for made in (with_skin(), with_targets()):
        with pytest.raises(FileFormatError, match="more than 30 numbers"):
            read(tmp_path, made)
