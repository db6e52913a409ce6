"""Animations and cameras of glTF files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream as rs
from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.scene.io import gltf_animation
from scene.io import tiny
from scene.io.test_gltf import read
from scene.io.tiny import with_buffer

HALF = 0.5**0.5
TIMES = np.array([0.5, 1.5, 2.5], np.float32)
PLACES = np.array([[1, 0, 0], [3, 0, 0], [3, 8, 0]], np.float32)
TURNS = np.array([[0, 0, 0, 1], [0, 0, HALF, HALF], [0, 0, 1, 0]], np.float32)  # 0, 90, 180
SIZES = np.array([[1, 1, 1], [2, 2, 2], [4, 4, 4]], np.float32)


def animated(*channels: tuple[int, str, int], **sampler: Any) -> dict[str, Any]:
    """The tetrahedron: (node, path, accessor of the values) of each channel."""
    document = with_buffer(
        tiny.gltf_document(), tiny.TETRAHEDRON, tiny.SIDES, TIMES, PLACES, TURNS, SIZES
    )
    vectors = {"componentType": 5126, "count": 3, "type": "VEC3"}
    document["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": 12, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5126, "count": 3, "type": "SCALAR"},
        {"bufferView": 3, **vectors},
        {"bufferView": 4, **vectors, "type": "VEC4"},
        {"bufferView": 5, **vectors},
    ]
    document["animations"] = [
        {
            "channels": [
                {"sampler": i, "target": {"node": node, "path": path}}
                for i, (node, path, _) in enumerate(channels)
            ],
            "samplers": [{"input": 2, "output": values, **sampler} for *_, values in channels],
        }
    ]
    return document


ALL = ((0, "translation", 3), (0, "rotation", 4), (1, "scale", 5))


def test_nodes_move_as_the_keys_say(tmp_path: Path) -> None:
    """In closed form: the parent turns and moves, the child grows; scale is in the rest pose 2."""
    scene = read(tmp_path, animated(*ALL))
    assert scene.animation is not None
    assert scene.animation.times == (0.0, 2.5)
    np.testing.assert_allclose(scene.meshes[0].vertices, tiny.TETRAHEDRON * 2 + [1, 0, 0])
    for time in (0.0, 0.5, 0.75, 1.5, 2.0, 9.0):
        s = min(max(time - 0.5, 0.0), 2.0)
        place = [1 + 2 * min(s, 1), 8 * max(s - 1, 0), 0]
        size = 1 + s if s < 1 else 2 * s
        c, d = np.cos(s * np.pi / 2), np.sin(s * np.pi / 2)
        turn = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]])
        expected = size * tiny.TETRAHEDRON @ turn.T + place
        (mesh,) = scene.at(time).meshes
        np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)
        assert mesh.faces is scene.meshes[0].faces


def test_steps_and_splines(tmp_path: Path) -> None:
    scene = read(tmp_path, animated((0, "translation", 3), interpolation="STEP"))
    assert scene.at(1.4).meshes[0].vertices[0].tolist() == [1, 0, 0]
    assert scene.at(1.6).meshes[0].vertices[0].tolist() == [3, 0, 0]
    document = animated((0, "translation", 3), interpolation="CUBICSPLINE")
    document["accessors"][2]["count"] = 1  # one key: tangent, value, tangent
    assert read(tmp_path, document).at(9.0).meshes[0].vertices[0].tolist() == [3, 0, 0]


def test_time_of_load(tmp_path: Path) -> None:
    read(tmp_path, animated(*ALL))
    path = tmp_path / "a.gltf"
    scene = rs.load(path, time=1.5)
    np.testing.assert_allclose(scene.meshes[0].vertices[0], [3, 0, 0], atol=1e-6)
    path.write_bytes(tiny.gltf_text())
    with pytest.raises(ValueError, match=r"a\.gltf is not animated"):
        rs.load(path, time=1.5)


def test_cameras_have_names_and_move(tmp_path: Path) -> None:
    document = animated((0, "translation", 3))
    document["nodes"] += [
        {"camera": 0, "name": "door"},
        {"camera": 1, "name": "door", "translation": [0, 0, 5]},
        {"camera": 2, "translation": [0, 7, 0]},
    ]
    document["nodes"][0]["children"].append(3)
    document["scenes"][0]["nodes"] += [2, 4]
    document["cameras"] = [
        {"type": "perspective", "perspective": {"yfov": 0.5}},
        {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1.5}},
        {"type": "perspective", "perspective": {"yfov": 0.7}, "name": "above"},
    ]
    scene = read(tmp_path, document)
    assert list(scene.cameras) == ["door", "door 2", "above"]  # in the order of the tree
    assert scene.cameras["door"].projection == "orthographic"
    assert scene.camera.eye == (1, 0, 5)
    assert scene.camera_at(1.0).eye == (2, 0, 5)
    assert scene.camera_track.times == (0.0, 2.5)
    assert scene.at(1.0).camera.height == 3.0
    scene = scene.replace(camera="above")
    assert scene.camera_track is None
    assert scene.at(1.0).camera.eye == (0, 7, 0)


def changed(change: Any) -> dict[str, Any]:
    document = animated(*ALL)
    change(document, document["animations"][0])
    return document


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d, a: a["channels"][0].update(sampler=3), "sampler 3 does not exist"),
        (lambda d, a: a["channels"][0]["target"].update(node=9), "no entry 9"),
        (lambda d, a: a["samplers"][0].update(interpolation="EASE"), "interpolation .*EASE"),
        (lambda d, a: a["samplers"][0].update(output=4), "unexpected type"),
        (lambda d, a: a["samplers"][0].update(interpolation="CUBICSPLINE"), "3 times and 3 values"),
        (lambda d, a: d["accessors"][3].update(count=2), "3 times and 2 values"),
        (lambda d, a: d["accessors"][3].update(count=10**6), "exceed buffer view"),
        (lambda d, a: a["samplers"][0].update(input=1), "decrease"),
        (lambda d, a: a.update(channels=[7]), "channel is not an object"),
        (lambda d, a: d["animations"].append(7), "animation is not an object"),
    ],
)
def test_damaged_animations_are_refused(tmp_path: Path, change: Any, reason: str) -> None:
    if "decrease" in reason:
        document = animated(*ALL)
        document = with_buffer(
            document, tiny.TETRAHEDRON, tiny.SIDES, TIMES[::-1].copy(), PLACES, TURNS, SIZES
        )
    else:
        document = changed(change)
    with pytest.raises(FileFormatError, match=reason):
        read(tmp_path, document)


def test_keys_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    broken = PLACES * np.float32(np.nan)
    document = with_buffer(
        animated(*ALL), tiny.TETRAHEDRON, tiny.SIDES, TIMES, broken, TURNS, SIZES
    )
    with pytest.raises(FileFormatError, match="keys that are not finite"):
        read(tmp_path, document)


def test_keys_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf_animation, "MAX_KEY_NUMBERS", 20)
    with pytest.raises(FileFormatError, match="more than 20 numbers"):
        read(tmp_path, animated(*ALL))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d, a: d["animations"].append(a), "skipped 1 of 2 animations"),
        (lambda d, a: a["channels"][0]["target"].update(path="weights"), "morph targets"),
        (lambda d, a: a["channels"][0]["target"].pop("node"), "unsupported properties"),
        (lambda d, a: d["nodes"][0].update(matrix=np.eye(4).ravel().tolist()), "with a matrix"),
    ],
)
def test_what_does_not_move_is_said(tmp_path: Path, change: Any, reason: str) -> None:
    with pytest.warns(RaystreamWarning, match=reason) as caught:
        scene = read(tmp_path, changed(change))
    assert len(caught) == 1
    assert scene.animation is not None
