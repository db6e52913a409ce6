"""Names of parts, and that each part of a file is one mesh: OBJ groups, glTF nodes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from meshes import cube
from raystream.core.errors import RaystreamWarning
from raystream.scene.io import obj
from raystream.scene.io.part_names import MAX_LENGTH, number_repeats
from raystream.scene.scene import Scene
from scene.io import tiny

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
FACE = "f 1 2 3"
VERTICES, FACES = cube()
VERTICES = VERTICES.astype(np.float32)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ([], []),
        ([""], [""]),
        (["wheel"], ["wheel"]),
        (["wheel", "hull", "wheel", "wheel"], ["wheel", "hull", "wheel_2", "wheel_3"]),
        (["wheel", "wheel", "wheel_2"], ["wheel", "wheel_3", "wheel_2"]),
        (["", "", "part"], ["part", "part_2", "part_3"]),
        (["", "hull"], ["part", "hull"]),
    ],
)
def test_repeated_names_get_numbers(names: list[str], expected: list[str]) -> None:
    assert number_repeats(names) == expected


@given(st.lists(st.sampled_from(["", "a", "a_2", "a_2_2", "a_3", "part", "part_2"])))
def test_names_differ_and_the_first_of_each_stays(names: list[str]) -> None:
    found = number_repeats(names)
    assert len(set(found)) == len(found) == len(names)
    for name in set(names) - {""}:
        assert found[names.index(name)] == name or (name == "part" and "" in names)


def read_obj(folder: Path, *lines: str, square: str = SQUARE) -> Scene:
    path = folder / "a.obj"
    path.write_text(square + "\n".join(lines) + "\n")
    return rs.load(path)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["g hull", FACE, "g engine", FACE], [("hull", 1), ("engine", 1)]),
        (["g hull", FACE, "g engine", FACE, "g hull", FACE], [("hull", 2), ("engine", 1)]),
        (
            ["g hull", FACE, "g engine", FACE, "g hull", FACE, "o tank", FACE],
            [("hull", 2), ("engine", 1), ("tank", 1)],
        ),
        (
            ["o truck", FACE, "g hull", FACE, "g engine", FACE],
            [("truck", 1), ("truck/hull", 1), ("truck/engine", 1)],
        ),
        (["o hull", "g hull", FACE], [("hull", 1)]),
        (["o wheel", FACE, "o wheel", FACE], [("wheel", 1), ("wheel_2", 1)]),
        (["o a", "g x", FACE, "o b", FACE], [("a/x", 1), ("b", 1)]),
        (["o a", "g x", FACE, "o b", "g x", FACE], [("a/x", 1), ("b/x", 1)]),
        (["g left  wheel", FACE], [("left wheel", 1)]),
        ([FACE, "g hull", FACE], [("part", 1), ("hull", 1)]),
        (["g hull", FACE, "g", FACE], [("hull", 1), ("part", 1)]),
        (["g", FACE], [("", 1)]),
        (["g default", "g hull", FACE, "g none"], [("hull", 1)]),
        (["g hull", "usemtl a", FACE, "usemtl b", FACE], [("hull", 2)]),
    ],
)
def test_objects_and_groups_are_meshes(
    tmp_path: Path, lines: list[str], expected: list[tuple[str, int]]
) -> None:
    scene = read_obj(tmp_path, *lines)
    assert [(mesh.name, mesh.triangle_count) for mesh in scene.meshes] == expected


def test_a_group_goes_on_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Triangles, materials and attributes of a group that is opened again come after its first."""
    square = SQUARE + "vt 0 0\nvt 1 0\nvn 0 0 1\nvn 0 0 -1\n"
    lines = ["g hull", "usemtl red", "f 1/1/1 2/1/1 3/1/1", "g engine", "usemtl blue"]
    lines += ["f 2/2/2 3/2/2 4/2/2", "g hull", "f 3/2/1 4/2/1 1/2/1", "usemtl red", "f 4 1 2"]
    scene = read_obj(tmp_path, *lines, square=square)
    hull, engine = scene.meshes
    assert hull.vertices[hull.faces][:, 0].tolist() == [[0, 0, 0], [1, 1, 0], [0, 1, 0]]
    names = [[scene.materials[k].name for k in mesh.material_ids] for mesh in scene.meshes]
    assert names == [["red", "blue", "red"], ["blue"]]
    assert engine.texcoords[engine.faces].tolist() == [[[1, 0]] * 3]
    assert hull.normals[hull.faces][:2].tolist() == [[[0, 0, 1]] * 3] * 2
    assert len(engine.vertices) == 3  # only its own


def test_files_of_objects_keep_their_order(tmp_path: Path) -> None:
    scene = read_obj(tmp_path, "o a", "f 1 2 3", "o b", "f 2 3 4", "o a", "f 3 4 1")
    corners = np.concatenate([mesh.vertices[mesh.faces][:, 0] for mesh in scene.meshes])
    assert corners.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert [mesh.name for mesh in scene.meshes] == ["a", "b", "a_2"]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["g a", FACE, "g b", FACE, "g c", FACE], [("", 3)]),
        (["o a", FACE, "o b", FACE, "o c", FACE], [("", 3)]),
        (["o a", "g x", FACE, "g y", FACE, "o b", FACE], [("a", 2), ("b", 1)]),
    ],
)
def test_too_many_parts_are_joined_with_a_warning(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    lines: list[str],
    expected: list[tuple[str, int]],
) -> None:
    monkeypatch.setattr(obj, "MAX_PARTS", 2)
    joined = f"its 3 objects and groups are more than 2, and became {len(expected)} meshes"
    with pytest.warns(RaystreamWarning, match=joined) as caught:
        scene = read_obj(tmp_path, *lines)
    assert len(caught) == 1
    assert [(mesh.name, mesh.triangle_count) for mesh in scene.meshes] == expected


def half(first: int, stop: int, material: int, **attributes: Any) -> dict[str, Any]:
    """A primitive with some triangles of a cube."""
    corners = VERTICES[FACES[first:stop]].reshape(-1, 3)
    return {"POSITION": corners, "material": material, **attributes}


def two_halves(**attributes: Any) -> list[dict[str, Any]]:
    return [half(0, 6, 0), half(6, 12, 1, **attributes)]


def document(nodes: list[dict[str, Any]], *meshes: Any, **more: Any) -> dict[str, Any]:
    """The first node is the root; each mesh is a list of primitives, or a name and a list."""
    materials = [{"name": "red"}, {"name": "blue", "doubleSided": True}]
    return tiny.gltf_of(list(meshes), nodes) | {"materials": materials} | more


def read_gltf(folder: Path, made: dict[str, Any], **options: Any) -> Scene:
    path = folder / "a.gltf"
    path.write_text(json.dumps(made))
    return rs.load(path, **options)


def names_of(scene: Scene) -> list[str]:
    return [mesh.name for mesh in scene.meshes]


def test_primitives_of_a_node_are_one_mesh(tmp_path: Path) -> None:
    """In the file's order: prim_id and materials are as if each were a mesh."""
    made = document([{"mesh": 0, "name": "box", "scale": [2, 2, -2]}], two_halves())
    scene = read_gltf(tmp_path, made)
    (mesh,) = scene.meshes
    assert mesh.name == "box"
    assert mesh.material_ids.tolist() == [0] * 6 + [1] * 6
    expected = VERTICES[FACES][:, [0, 2, 1]] * [2, 2, -2]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], expected)
    (placed,) = read_gltf(tmp_path, made, instances=True).flattened().meshes
    np.testing.assert_array_equal(placed.vertices[placed.faces], expected)
    assert (placed.name, placed.material_ids.tolist()) == ("box", mesh.material_ids.tolist())


def test_attributes_that_some_primitives_lack(tmp_path: Path) -> None:
    """Hits see what they saw when each primitive was a mesh."""
    rng = np.random.default_rng(1)
    attributes = {
        "NORMAL": rng.uniform(-1, 1, (18, 3)).astype(np.float32),
        "TEXCOORD_0": rng.uniform(0, 1, (18, 2)).astype(np.float32),
        "COLOR_0": rng.uniform(0, 1, (18, 3)).astype(np.float32),
    }
    turned = {"mesh": 0, "rotation": [0.5, 0.5, 0.5, 0.5]}
    scene = read_gltf(tmp_path, document([turned], two_halves(**attributes)))
    nodes = [{"children": [1, 2]}, turned, {**turned, "mesh": 1}]
    first, second = two_halves(**attributes)
    apart = read_gltf(tmp_path, document(nodes, [first], [second]))
    assert len(scene.meshes) == 1
    assert len(apart.meshes) == 2
    for name in ("faces", "material_ids", "normals", "texcoords", "colors"):
        joined, parts = getattr(scene.attributes, name), getattr(apart.attributes, name)
        np.testing.assert_array_equal(joined, parts)
    np.testing.assert_array_equal(scene.triangles.corners, apart.triangles.corners)
    assert np.isnan(scene.meshes[0].normals[:18]).all()
    assert np.isnan(scene.meshes[0].texcoords[:18]).all()
    assert (scene.meshes[0].colors[:18] == 1.0).all()


WHEELS = [
    {"name": "truck", "children": [1, 2, 5]},
    {"name": "axle", "children": [3]},
    {"name": "axle", "children": [4]},
    {"name": "wheel", "mesh": 0},
    {"name": "wheel", "mesh": 0},
    {"name": "engine", "mesh": 0, "children": [6]},
    {"mesh": 0},
]


def test_nodes_are_named_by_their_path(tmp_path: Path) -> None:
    expected = ["truck/axle/wheel", "truck/axle/wheel_2", "truck/engine", "truck/engine/rim"]
    made = document(WHEELS, ("rim", two_halves()))
    assert names_of(read_gltf(tmp_path, made)) == expected
    placed = read_gltf(tmp_path, made, instances=True)
    assert names_of(placed) == ["rim"]
    assert placed.placements.names == tuple(expected)
    assert names_of(placed.flattened()) == expected
    moved = placed.with_transforms(placed.placements.transforms + 1.0)
    assert moved.placements.names == tuple(expected)
    del made["meshes"][0]["name"]
    assert names_of(read_gltf(tmp_path, made))[3] == "truck/engine_2"


@pytest.mark.parametrize(
    ("node", "mesh", "expected"),
    [
        ({"name": "engine"}, "eng", "engine"),
        ({}, "eng", "eng"),
        ({"name": 7}, "eng", "eng"),
        ({"name": "  "}, "", ""),
        ({"name": "x" * 999}, "", "x" * MAX_LENGTH),
    ],
)
def test_names_of_one_node(tmp_path: Path, node: dict[str, Any], mesh: str, expected: str) -> None:
    made = document([{**node, "mesh": 0}], (mesh, two_halves()))
    assert names_of(read_gltf(tmp_path, made)) == [expected]


def test_files_without_nodes_have_the_names_of_meshes(tmp_path: Path) -> None:
    made = document([], ("a", two_halves()), ("a", two_halves()), two_halves())
    del made["nodes"], made["scenes"], made["scene"]
    assert names_of(read_gltf(tmp_path, made)) == ["a", "a_2", "part"]


def test_copies_have_names(tmp_path: Path) -> None:
    made = document([{"name": "tree", "mesh": 0}], ("oak", two_halves()))
    shifts = np.array([[0, 0, 0], [5, 0, 0], [9, 0, 0]], np.float32)
    made = tiny.with_accessor(made, shifts)
    extension = {"attributes": {"TRANSLATION": len(made["accessors"]) - 1}}
    made["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": extension}
    expected = ["tree", "tree_2", "tree_3"]
    assert names_of(read_gltf(tmp_path, made)) == expected
    placed = read_gltf(tmp_path, made, instances=True)
    assert (names_of(placed), placed.placements.names) == (["oak"], tuple(expected))
    assert names_of(placed.flattened()) == expected
    rows = Scene.instances(placed, np.eye(3, 4), names=["row"])
    assert rows.placements.names == ("row/tree", "row/tree_2", "row/tree_3")
    with pytest.raises(ValueError, match="names: expected 1, one per transform, got 2"):
        Scene.instances(placed, np.eye(3, 4), names=["row", "column"])


def test_moving_parts_keep_their_names_and_their_mesh(tmp_path: Path) -> None:
    made = document(WHEELS, two_halves())
    times, turns = np.array([0, 2], np.float32), np.eye(4, dtype=np.float32)[[3, 2]]
    made = tiny.with_accessor(tiny.with_accessor(made, times), turns)
    first = len(made["accessors"]) - 2
    channel = {"sampler": 0, "target": {"node": 1, "path": "rotation"}}
    sampler = {"input": first, "output": first + 1}
    made["animations"] = [{"channels": [channel], "samplers": [sampler]}]
    scene = read_gltf(tmp_path, made)
    posed = scene.at(1.0)
    assert names_of(posed) == names_of(scene)
    assert [mesh.triangle_count for mesh in posed.meshes] == [12] * 4
    assert posed.meshes[1] is scene.meshes[1]


def test_skins_and_morphs_of_some_primitives(tmp_path: Path) -> None:
    """One primitive follows a joint and has normals, the other stays; both have a target."""
    joints, weights = np.zeros((18, 4), np.uint8), np.tile(np.eye(4, dtype=np.float32)[:1], (18, 1))
    up = np.tile(np.array([[0, 1, 0]], np.float32), (18, 1))
    primitives = two_halves(JOINTS_0=joints, WEIGHTS_0=weights, NORMAL=up)
    for primitive in primitives:
        primitive["targets"] = [{"POSITION": up}]
    nodes = [{"children": [1, 2]}, {"mesh": 0, "skin": 0}, {"translation": [0, 0, 9]}]
    made = document(nodes, primitives, skins=[{"joints": [2]}])
    made["meshes"][0]["weights"] = [3]
    with pytest.warns(RaystreamWarning, match="1 skinned meshes left in their bind pose"):
        (mesh,) = read_gltf(tmp_path, made).meshes
    corners = VERTICES[FACES]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][:6], corners[:6] + [0, 3, 0])
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][6:], corners[6:] + [0, 3, 9])
    assert np.isnan(mesh.normals[:18]).all()
    np.testing.assert_array_equal(mesh.normals[18:], up)
