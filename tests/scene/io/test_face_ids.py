"""Faces of files: the polygon of each hit, within its mesh, in the order of the file."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from raystream.core.errors import RaystreamWarning
from scene.io import tiny

#: Corners of a row of five unit squares: 0 to 5 at y = 0, 6 to 11 at y = 1.
ROW = np.array([(x, y, 0) for y in range(2) for x in range(6)])

#: Squares, a triangle, an edge and a square of vertices that do not exist, in any order.
ROW_FACES = [(0, 1, 7, 6), (1, 2), (1, 2, 8, 7), (2, 3, 99), (2, 3, 9), (2, 9, 8), (3, 4, 10, 9)]

#: Of triangles that remain.
ROW_IDS = [0, 0, 2, 2, 4, 5, 6, 6]

DOWN = [0.0, 0.0, -1.0]


def obj(first: str = "") -> str:
    rows = "".join(f"v {x} {y} {z}\n" for x, y, z in ROW.tolist())
    return rows + first + "".join(f"f {' '.join(str(k + 1) for k in f)}\n" for f in ROW_FACES)


def listed(head: str) -> str:
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in ROW.tolist())
    return head + rows + "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in ROW_FACES)


PLY_HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 12\nproperty float x\nproperty float y\n"
    "property float z\nelement face 7\nproperty list uchar int vertex_indices\nend_header\n"
)

FILES = {"a.obj": obj(), "a.ply": listed(PLY_HEAD), "a.off": listed("OFF\n12 7 0\n")}


def load(folder: Path, name: str, text: str) -> rs.Scene:
    (folder / name).write_text(text)
    with pytest.warns(RaystreamWarning):  # of what is left out
        return rs.load(folder / name)


@pytest.mark.parametrize("name", FILES)
def test_faces_are_those_of_the_file(tmp_path: Path, name: str) -> None:
    scene = load(tmp_path, name, FILES[name])
    (mesh,) = scene.meshes
    assert mesh.face_ids is not None
    assert mesh.face_ids.tolist() == ROW_IDS
    origins = [[x, y, 1.0] for x, y in ((0.2, 0.3), (1.7, 0.3), (2.7, 0.3), (2.2, 0.6), (4.4, 0.3))]
    hits = rs.Tracer(scene).first_hit(origins, DOWN)
    assert hits.face_id.tolist() == [0, 2, 4, 5, -1]
    assert hits.face_id.dtype == np.int32


def test_faces_of_obj_are_numbered_within_each_object(tmp_path: Path) -> None:
    """With faces that are dropped before an object, at its begin and at its end."""
    text = (
        obj().replace("f 2 3\n", "f 2 3\no left\nf 1 99 2\n").replace("f 3 10 9", "o b\nf 3 10 9")
    )
    scene = load(tmp_path, "a.obj", text)
    assert [mesh.name for mesh in scene.meshes] == ["part", "left", "b"]
    ids = [None if mesh.face_ids is None else mesh.face_ids.tolist() for mesh in scene.meshes]
    assert ids == [[0, 0], [1, 1, 3], [0, 1, 1]]
    hits = rs.Tracer(scene).first_hit([[0.5, 0.4, 1], [1.5, 0.4, 1], [3.5, 0.4, 1]], DOWN)
    assert (hits.mesh_id.tolist(), hits.face_id.tolist()) == ([0, 1, 2], [0, 1, 1])


def test_faces_of_obj_groups_that_are_opened_again(tmp_path: Path) -> None:
    """The group ``none`` has a face, but no triangle."""
    text = (
        obj("g left\n")
        .replace("f 2 3\n", "g right\nf 2 3\n")
        .replace("f 3 4 100", "g none\nf 3 4 100\ng left")
    )
    scene = load(tmp_path, "a.obj", text)
    ids = {
        mesh.name: None if mesh.face_ids is None else mesh.face_ids.tolist()
        for mesh in scene.meshes
    }
    assert ids == {"left": [0, 0, 1, 2, 3, 3], "right": [1, 1]}


def test_strips_follow_the_polygons(tmp_path: Path) -> None:
    head = PLY_HEAD.replace(
        "end_header", "element tristrips 1\nproperty list int int vertex_indices\nend_header"
    )
    scene = load(tmp_path, "a.ply", listed(head) + "7 4 5 10 -1 5 11 10\n")
    (mesh,) = scene.meshes
    assert mesh.face_ids is not None
    assert mesh.face_ids.tolist() == [*ROW_IDS, 7, 8]


def test_polygons_of_nff(tmp_path: Path) -> None:
    """A run of polygons is a mesh; one without triangles is a face, too."""
    words = ["v from 0 0 9 at 0 0 0 up 0 1 0 angle 40 hither 1 resolution 8 8"]
    for face in (ROW_FACES[0], ROW_FACES[1], ROW_FACES[2], ROW_FACES[4]):
        words += [f"p {len(face)}", *(" ".join(map(str, ROW[k].tolist())) for k in face)]
    (tmp_path / "a.nff").write_text("\n".join([*words, "s 9 0 0 1", *words[1:6]]))
    scene = rs.load(tmp_path / "a.nff")
    ids = [None if mesh.face_ids is None else mesh.face_ids.tolist() for mesh in scene.meshes]
    assert ids == [[0, 0, 2, 2, 3], None, [0, 0]]


def test_triangles_that_gltf_drops_are_counted(tmp_path: Path) -> None:
    sides = tiny.SIDES.astype(np.uint16)
    sides[1, 2] = 9
    document = tiny.with_buffer(tiny.gltf_document(), tiny.TETRAHEDRON, sides)
    scene = load(tmp_path, "a.gltf", json.dumps(document))
    (mesh,) = scene.meshes
    assert mesh.face_ids is not None
    assert mesh.face_ids.tolist() == [0, 2, 3]


def test_primitives_of_gltf_follow_each_other(tmp_path: Path) -> None:
    """A triangle of the first is dropped, all of the second are, and none of the third."""
    sides = tiny.SIDES.astype(np.uint16)
    sides[1, 2] = 9
    arrays = tiny.TETRAHEDRON, sides, np.full(6, 7, np.uint16), tiny.SIDES.astype(np.uint16)
    document = tiny.with_buffer(tiny.gltf_document(), *arrays)
    of_indices = document["accessors"][1]
    document["accessors"] += [
        {**of_indices, "bufferView": 2, "count": 6},
        {**of_indices, "bufferView": 3},
    ]
    (first,) = document["meshes"][0]["primitives"]
    document["meshes"][0]["primitives"] += [{**first, "indices": 2}, {**first, "indices": 3}]
    scene = load(tmp_path, "a.gltf", json.dumps(document))
    (mesh,) = scene.meshes
    assert mesh.face_ids is not None
    assert mesh.face_ids.tolist() == [0, 2, 3, 6, 7, 8, 9]


def test_files_of_triangles_have_no_table(tmp_path: Path) -> None:
    for name, content in {
        "a.stl": tiny.stl_binary(),
        "a.off": tiny.OFF,
        "a.gltf": json.dumps(tiny.gltf_document()).encode(),
        "a.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 3 2 1\n",
    }.items():
        (tmp_path / name).write_bytes(content)
        scene = rs.load(tmp_path / name)
        assert [mesh.face_ids for mesh in scene.meshes] == [None]
        assert scene.attributes.face_ids is None


def two_quads(**attributes: object) -> rs.Scene:
    """Two squares beside each other, the second face first."""
    faces = [[0, 1, 7], [0, 7, 6], [1, 2, 8], [1, 8, 7]]
    return rs.Scene.from_arrays(ROW, faces, face_ids=[1, 1, 0, 0], **attributes)


RAYS = np.array([[0.5, 0.3, 1.0], [1.5, 0.3, 1.0], [9.0, 0.3, 1.0]])


def test_from_arrays_and_every_kind_of_hits() -> None:
    scene = two_quads()
    for tracer in (rs.Tracer(scene), rs.Tracer(scene, "brute", precision="float64")):
        assert tracer.first_hit(RAYS, DOWN).face_id.tolist() == [1, 0, -1]
        many = tracer.multi_hit(RAYS, DOWN)
        assert (many.ray_id.tolist(), many.face_id.tolist()) == ([0, 1], [1, 0])
    tracer = rs.Tracer(scene)
    assert tracer.closest_point([1.6, 0.5, 3.0]).face_id.tolist() == 0
    assert tracer.cast([0.5, 0.3, 1.0], DOWN).hits.face_id.tolist() == 1
    assert tracer.first_hit(RAYS, DOWN)[1:].face_id.tolist() == [0, -1]
    assert rs.Tracer(rs.load("cornell")).first_hit(RAYS, DOWN).face_id.tolist() == [-1, -1, -1]


def test_where_each_triangle_is_a_face() -> None:
    scene = rs.Scene([*two_quads().meshes, rs.Mesh(ROW + [0, 0, -5], [[3, 4, 10], [3, 10, 9]])])
    rays = np.array([[0.5, 0.3, 1.0], [3.5, 0.3, 1.0], [3.5, 0.7, 1.0], [3.5, 7.0, 1.0]])
    hits = rs.Tracer(scene).first_hit(rays, DOWN)
    assert hits.face_id.tolist() == [1, 0, 1, -1]
    heights = rs.Scene.height_field(np.zeros((2, 6)))
    mixed = rs.Scene.combine([two_quads(), heights, rs.Scene.spheres([[4.5, 9, 0]], 0.5)])
    hits = rs.Tracer(mixed).first_hit([[0.5, 0.3, 1], [4.7, 0.3, 1], [4.5, 9, 3]], DOWN)
    assert hits.face_id.tolist() == [1, 8, 0]
    assert hits.face_id[1:].tolist() == hits.mesh_prim_id[1:].tolist()


def test_instances_have_the_faces_of_their_objects() -> None:
    places = np.zeros((2, 3, 4))
    places[:, :, :3] = np.eye(3)
    places[1, 0, 0], places[1, 0, 3] = -1.0, 9.0  # mirrored, from x = 7 to 9
    scene = rs.Scene.instances(two_quads(), places)
    rays = np.array([[0.5, 0.3, 1.0], [8.5, 0.3, 1.0], [7.5, 0.3, 1.0], [6.5, 0.3, 1.0]])
    assert rs.Tracer(scene).first_hit(rays, DOWN).face_id.tolist() == [1, 1, 0, -1]
    assert rs.Tracer(scene.flattened()).first_hit(rays, DOWN).face_id.tolist() == [1, 1, 0, -1]


def test_copies_of_meshes_keep_their_faces() -> None:
    (mesh,) = two_quads().meshes
    moved = mesh.moved(mesh.vertices + 1.0)
    for copy in (moved, mesh.with_material_ids(0), pickle.loads(pickle.dumps(mesh))):
        assert copy.face_ids is not None
        assert copy.face_ids.tolist() == [1, 1, 0, 0]
    scene = two_quads()
    tracer = rs.Tracer(scene)
    tracer.update(scene.meshes[0].vertices + [1.0, 0.0, 0.0])
    assert tracer.first_hit(RAYS, DOWN).face_id.tolist() == [-1, 1, -1]
    both = rs.Scene.combine([rs.load("cornell"), scene])
    assert both.meshes[-1].face_ids is not None


@pytest.mark.parametrize(
    ("face_ids", "error", "reason"),
    [
        ([0, 0, 1], ValueError, r"expected shape \(4,\), got \(3,\)"),
        ([0, 0, 1, -1], ValueError, "got -1 to 1"),
        ([0, 0, 1, 2**31], ValueError, "got 0 to 2147483648"),
        ([0.0, 0.0, 1.0, 1.0], TypeError, "expected integers"),
    ],
)
def test_wrong_faces(face_ids: list[float], error: type[Exception], reason: str) -> None:
    (mesh,) = two_quads().meshes
    with pytest.raises(error, match=f"face_ids: .*{reason}"):
        rs.Mesh(mesh.vertices, mesh.faces, face_ids=face_ids)


def test_the_identity_is_not_kept() -> None:
    (mesh,) = two_quads().meshes
    assert rs.Mesh(mesh.vertices, mesh.faces, face_ids=np.arange(4)).face_ids is None
    assert rs.Mesh(mesh.vertices, np.zeros((0, 3), int), face_ids=[]).face_ids is None
