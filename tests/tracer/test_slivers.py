"""Solids that only triangles without area close: which points are inside them."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest

import raystream as rs
from meshes import cube, icosphere
from raystream.kernels.solids import solids_of
from raystream.tracer.inside import _DIRECTIONS
from slivers import FORMS, loose, split_box, split_edge, split_mesh
from solid_meshes import box_chords, box_mesh, joined, rays_from_outside


def obj(vertices, faces):
    rows = ["v {!r} {!r} {!r}".format(*row) for row in vertices.tolist()]
    return "\n".join(rows + ["f {} {} {}".format(*row) for row in (faces + 1).tolist()]).encode()


def ply(vertices, faces):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(map(repr, row)) for row in vertices.tolist()]
    return (head + "\n".join(rows + ["3 {} {} {}".format(*row) for row in faces.tolist()])).encode()


def stl(vertices, faces):
    rows = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows["corners"] = vertices[faces]
    return b" " * 80 + struct.pack("<I", len(faces)) + rows.tobytes()


def glb(vertices, faces):
    points, indices = np.float32(vertices), np.uint32(faces)
    payload = points.tobytes() + indices.tobytes()
    views = [{"buffer": 0, "byteLength": points.nbytes},
             {"buffer": 0, "byteOffset": points.nbytes, "byteLength": indices.nbytes}]  # fmt: skip
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(payload)}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": indices.size, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(payload), 0x004E4942) + payload
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf(vertices, faces):
    whole = glb(vertices, faces)
    (length,) = struct.unpack_from("<I", whole, 12)
    document = json.loads(whole[20 : 20 + length])
    payload = base64.b64encode(whole[28 + length :]).decode()
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + payload
    return json.dumps(document).encode()


@pytest.mark.filterwarnings("ignore::raystream.RaystreamWarning")  # counts what has no area
@pytest.mark.parametrize("write", [obj, ply, stl, glb, gltf])
@pytest.mark.parametrize("splits", [1, 4])
def test_files(write, splits, tmp_path):
    path = tmp_path / f"part.{write.__name__}"
    path.write_bytes(write(*split_box(splits)))
    scene = rs.load(path)
    assert scene.triangles.degenerate_count == splits
    assert solids_of(scene.triangles).is_closed.all()
    tracer = rs.Tracer(scene)
    points = [[1.5, 1.4, 1.3], [0.9, 1.5, 1.5]]
    assert tracer.contains(points).tolist() == [True, False]
    assert tracer.signed_distance(points).tolist() == pytest.approx([-0.3, 0.1])
    assert rs.thickness(tracer, [0.0, 1.4, 1.3], [1.0, 0.0, 0.0]).mesh_is_closed.all()


@pytest.mark.parametrize("form", FORMS)
def test_points(form, rng):
    mesh = split_mesh(form)
    tracer = rs.Tracer(rs.Scene([mesh]))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    points = rng.uniform(low - 0.5, high + 0.5, (5000, 3))
    found = tracer.contains(points)
    np.testing.assert_array_equal(found, tracer.contains(points, method="winding"))
    assert 200 < found.sum() < 4000
    np.testing.assert_array_equal(tracer.signed_distance(points) < 0, found)


@pytest.mark.parametrize("direction", _DIRECTIONS)
def test_points_whose_rays_pass_the_split_edge(direction):
    """They may slip through beside the sliver: the other rays disagree, and winding decides."""
    vertices, faces = split_edge(*icosphere(1), face=3, splits=5, off=0.0)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    a, b = vertices[icosphere(1)[1][3][:2]]
    aims = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
    for t in (0.2, 0.6, 2.0):
        points = aims - t * np.array(direction)
        np.testing.assert_array_equal(
            tracer.contains(points), tracer.contains(points, method="winding")
        )


def test_parts_that_only_slivers_close_together():
    """A cube of six open meshes, and a sliver at an edge."""
    vertices, faces = split_box()
    parts = [rs.Mesh(vertices, faces[k : k + 2]) for k in range(0, len(faces), 2)]
    tracer = rs.Tracer(rs.Scene(parts))
    assert tracer.contains([[1.5, 1.4, 1.3], [2.5, 1.4, 1.3]]).tolist() == [True, False]


def test_edges_of_meshes_that_stay_open_are_named():
    vertices, faces = split_box()
    closed = rs.Mesh(vertices, faces, name="closed")
    holed = rs.Mesh(vertices + [5, 0, 0], np.delete(faces, 4, axis=0), name="holed")
    unclosed = rs.Mesh(vertices + [9, 0, 0], faces[:-1], name="no sliver")
    with pytest.raises(ValueError, match="inside") as caught:
        rs.Tracer(rs.Scene([closed, holed, unclosed])).contains([0, 0, 0])
    text = str(caught.value)
    assert "meshes 1 ('holed') and 2 ('no sliver') are open" in text
    assert "at 6 edges: (" in text
    assert "and 3 more; use method='winding'" in text
    assert "closed'" not in text
    vertices, faces = cube()
    with pytest.raises(ValueError, match="at 3 edges") as caught:
        rs.Tracer(rs.Scene.from_arrays(vertices, faces[1:])).contains([0, 0, 0])
    for corner in vertices[faces[0]]:
        assert "({:.6g}, {:.6g}, {:.6g})".format(*corner) in str(caught.value)


def test_edges_are_found_in_world_space():
    vertices, faces = cube()
    far = rs.Scene.from_arrays(vertices + [1e6, 0, 0], faces[2:])
    with pytest.raises(ValueError, match=r"\(1e\+06, ") as caught:
        rs.Tracer(far).contains([0, 0, 0])
    assert "at 4 edges" in str(caught.value)


@pytest.mark.parametrize("splits", [1, 7])
def test_thickness(splits, rng):
    vertices, faces = split_box(splits)
    tracer = rs.Tracer(rs.Scene([rs.Mesh(vertices, faces), rs.Mesh(*loose(vertices + 4, faces))]))
    origins, directions = rays_from_outside(rng, 3000)
    origins += 1.5
    found = rs.thickness(tracer, origins, directions)
    assert found.mesh_is_closed.all()
    chords = box_chords(origins, directions, [1, 1, 1], [2, 2, 2])
    np.testing.assert_allclose(found.total_length("mesh")[:, 0], chords, atol=1e-5)
    inside = rs.thickness(tracer, [1.5, 1.4, 1.3], directions, ends="clip", t_max=0.01)
    assert inside.is_complete.all()
    length = 0.01 * np.linalg.norm(directions, axis=1)
    np.testing.assert_allclose(inside.total_length(), length, rtol=1e-5)


def test_inward_normals():
    vertices, faces = split_box()
    found = rs.thickness(
        rs.Tracer(rs.Scene.from_arrays(vertices, faces[:, ::-1])), [0.0, 1.4, 1.3], [1.0, 0, 0]
    )
    assert found.mesh_is_flipped.tolist() == [True]
    assert found.total_length() == 1.0


class Leaky(rs.Tracer):
    """Rays slip through the first surface, as they may beside a sliver."""

    def multi_hit(self, origins, directions, **options):
        many = super().multi_hit(origins, directions, **options)
        kept = np.ones(len(many.t), bool)
        kept[many.ray_splits[:-1][many.counts > 1]] = False
        many.ray_splits = np.concatenate([[0], np.cumsum(kept)])[many.ray_splits]
        for name in ("t", "u", "v", "prim_id", "_instance_id"):
            if getattr(many, name) is not None:
                setattr(many, name, getattr(many, name)[kept])
        many.__dict__.pop("counts", None)
        return many


@pytest.mark.parametrize("placed", [False, True])
def test_a_ray_that_slips_through_does_not_begin_inside(placed):
    """With "clip", an exit without an entry means a beginning inside only if that is so."""
    solid = joined(rs.Mesh(*split_box()), box_mesh([5, 1, 1], [6, 2, 2]))
    scene = rs.Scene([box_mesh([8, 1, 1], [9, 2, 2]), solid])
    if placed:
        move = np.hstack([2 * np.eye(3), [[1.0], [2.0], [3.0]]])
        scene = rs.Scene.instances([scene], [np.eye(3, 4) + 100.0, move], [0, 0])
    way = [2.0 if placed else 1.0, 0.0, 0.0]
    starts = np.array([[0.0, 1.4, 1.3], [1.5, 1.4, 1.3]])
    starts = starts * 2 + [1, 2, 3] if placed else starts
    found = rs.thickness(Leaky(scene), starts[:1], way, ends="clip", t_max=7.0)
    assert found.unpaired_t.tolist() == pytest.approx([2.0])
    assert found.unpaired_mesh_id.tolist() == [1]
    assert found.is_complete.tolist() == [False]
    assert found.t_entry.tolist() == pytest.approx([5.0])
    found = rs.thickness(rs.Tracer(scene), starts, way, ends="clip", t_max=7.0)
    assert found.is_complete.all()
    assert found.t_exit.tolist() == pytest.approx([2.0, 6.0, 0.5, 4.5, 7.0])
