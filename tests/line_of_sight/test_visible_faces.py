"""Visible faces, against a ray for each pixel by brute force and against `visibility`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import EVERY_QUERY, TRACERS
from meshes import cube, dented_sphere, icosphere, soup
from oracles import judge
from raystream.line_of_sight import visible_faces
from strategies import meshes

SIZE = 64, 48

CAMERAS = {
    "perspective": rs.Camera((2.0, 1.5, 3.0), (0.5, 0.5, 0.5), fov=30.0),
    "wide": rs.Camera((0.5, 0.5, 0.4), (0.6, 0.5, 1.5), fov=120.0),
    "orthographic": rs.Camera(
        (2.0, 1.5, 3.0), (0.5, 0.5, 0.5), projection="orthographic", height=1.2
    ),
    "everywhere": rs.Camera((0.5, 0.5, 0.5), (0.5, 0.5, 1.5), projection="equirectangular"),
    "lens": rs.Camera((2.0, 1.5, 3.0), (0.5, 0.5, 0.5), fov=30.0, aperture=0.3),
}


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("tracer", EVERY_QUERY)
def test_no_face_at_a_pixel_s_centre_is_missed(camera, tracer):
    scene = rs.Scene.from_arrays(*soup(50))
    camera = CAMERAS[camera]
    found = rs.visible_faces(rs.Tracer(scene, **TRACERS[tracer]), camera, SIZE, points_per_face=0)
    image = rs.Tracer(scene, "brute").first_hit(*camera.rays(*SIZE)).prim_id
    ids, counts = np.unique(image[image >= 0], return_counts=True)
    assert found.prim_ids.dtype == np.int32
    np.testing.assert_array_equal(found.prim_ids, ids)
    np.testing.assert_array_equal(found.pixel_counts, counts)
    assert len(ids) > 5


@pytest.mark.parametrize("camera", CAMERAS)
def test_blocks_change_nothing(camera, monkeypatch):
    tracer = rs.Tracer(rs.Scene.from_arrays(*dented_sphere(2)))
    view = rs.Camera((9.0, 1.0, 9.0), (0.0, -2.0, 1.0), projection=CAMERAS[camera].projection)
    expected = rs.visible_faces(tracer, view, SIZE)
    monkeypatch.setattr(visible_faces, "_BLOCK", 200)
    found = rs.visible_faces(tracer, view, SIZE)
    np.testing.assert_array_equal(found.prim_ids, expected.prim_ids)
    np.testing.assert_array_equal(found.pixel_counts, expected.pixel_counts)


@pytest.mark.parametrize("camera", CAMERAS)
def test_small_faces_are_found_by_their_centres(camera):
    """A fine mesh in few pixels; the truth about centres comes from float64."""
    vertices, faces = dented_sphere(2)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    mesh = (vertices - low) / (high - low).max(), faces
    tracer = rs.Tracer(rs.Scene.from_arrays(*mesh))
    camera = CAMERAS[camera]
    found = rs.visible_faces(tracer, camera, (16, 12))
    bare = rs.visible_faces(tracer, camera, (16, 12), points_per_face=0)
    assert set(bare.prim_ids) == set(found.prim_ids[found.pixel_counts > 0])
    assert len(found.prim_ids) > len(bare.prim_ids)

    centres = mesh[0][faces].mean(axis=1)
    view = (centres - np.asarray(camera.eye)) @ camera.basis().T
    origins = np.broadcast_to(np.asarray(camera.eye), centres.shape)
    if camera.projection == "orthographic":
        half = np.array([0.6 * 16 / 12, 0.6])
        origins = centres - view[:, 2:] * camera.basis()[2]
        inside = (np.abs(view[:, :2]) < half).all(axis=1) & (view[:, 2] > 0)
    elif camera.projection == "equirectangular":
        inside = np.ones(len(centres), bool)
    else:
        half = np.tan(np.radians(camera.fov / 2)) * np.array([16 / 12, 1.0])
        inside = (np.abs(view[:, :2]) < half * view[:, 2:]).all(axis=1) & (view[:, 2] > 0)
    verdict = judge(*mesh, origins, centres - origins, np.zeros(len(faces)), np.ones(len(faces)))
    own = np.arange(len(faces))
    verdict.sure[own, own] = verdict.doubt[own, own] = False
    clear = ~(verdict.sure | verdict.doubt).any(axis=1)
    seen = np.isin(own, found.prim_ids)
    assert not (inside & clear & ~seen).any()
    # And no face is seen without a reason.
    hidden = verdict.sure.any(axis=1) | ~inside
    assert not (hidden & np.isin(own, found.prim_ids[found.pixel_counts == 0])).any()
    assert (inside & clear).sum() > 20


def test_faces_smaller_than_a_pixel_in_a_crowd():
    """All front faces of a sphere of 20,480 triangles in an image of 8 x 8 pixels."""
    vertices, faces = icosphere(5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    camera = rs.Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    found = rs.visible_faces(tracer, camera, (8, 8))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    height = np.einsum("fk,fk->f", normals, [0.0, 0.0, 5.0] - corners[:, 0])
    expected = np.flatnonzero(height > 1e-9)
    missing = np.setdiff1d(expected, found.prim_ids)
    extra = np.setdiff1d(found.prim_ids, np.flatnonzero(height > -1e-9))
    assert len(missing) == 0
    assert len(extra) == 0
    assert found.pixel_counts.sum() <= 64


def test_more_points_find_faces_whose_centre_is_hidden():
    """A triangle behind a screen that hides its centre, between the pixels' centres."""
    vertices = np.array(
        [[-1, -1, 0], [1, -1, 0], [0, 1, 0], [-0.7, -0.6, 1], [0.7, -0.6, 1], [0.0, 0.5, 1]], float
    )
    vertices[:, 0] += 0.013
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]]))
    camera = rs.Camera((0.0, 0.0, 9.0), (0.0, 0.0, 0.0), fov=60.0)
    few, many = (
        rs.visible_faces(tracer, camera, (1, 1), points_per_face=n).prim_ids.tolist()
        for n in (1, 12)
    )
    assert few == [1]
    assert many == [0, 1]


def test_a_point_looks_everywhere():
    vertices, faces = cube()
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    inside = rs.visible_faces(tracer, [0.3, 0.4, 0.5], (64, 32))
    assert inside.prim_ids.tolist() == list(range(12))
    assert inside.pixel_counts.sum() == 64 * 32
    outside = rs.visible_faces(tracer, (9.0, 0.5, 0.5), (64, 32))
    sides = np.unique(vertices[faces[outside.prim_ids]][..., 0])
    assert sides.tolist() == [1.0]
    far = rs.visible_faces(tracer, (1e9, 0.5, 0.5), (64, 32))
    assert set(far.prim_ids) == set(outside.prim_ids)


@settings(max_examples=30)
@given(st.data())
def test_lattices(data):
    """All first hits are found, and faces without pixels are not hidden from float64."""
    (vertices, faces), scale, offset = data.draw(meshes())
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    eye = np.array([1.3, 2.1, 6.2]) * scale + offset
    if not np.isfinite(eye).all():
        return
    found = rs.visible_faces(tracer, eye, (32, 16))
    assert (np.diff(found.prim_ids) > 0).all()
    rare = found.prim_ids[found.pixel_counts == 0]
    if len(rare):
        corners = np.asarray(vertices, float)[faces]
        centres = corners.mean(axis=1)[rare]
        verdict = judge(
            vertices,
            faces,
            np.broadcast_to(eye, centres.shape),
            centres - eye,
            np.zeros(len(rare)),
            np.full(len(rare), 1 - 1e-5),
        )
        verdict.sure[np.arange(len(rare)), rare] = False
        assert not verdict.sure.any()


def test_defaults_and_progress():
    scene = rs.load("cornell")
    tracer = rs.Tracer(scene)
    steps = []
    found = rs.visible_faces(
        tracer, size=(600, 600), progress=lambda done, total: steps.append((done, total))
    )
    assert found.pixel_counts.sum() <= 360_000
    assert all(done <= total for done, total in steps)
    assert steps[-1][0] == steps[-1][1]
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    nothing = rs.Tracer(rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int)))
    assert len(rs.visible_faces(nothing, [0, 0, 0]).prim_ids) == 0


@pytest.mark.parametrize(
    ("camera", "size", "points", "error", "named"),
    [
        ("front", SIZE, 1, TypeError, "camera: .*give a Camera or a point"),
        ([1, 2], SIZE, 1, ValueError, r"camera: expected shape \(3,\)"),
        ([np.nan, 0, 0], SIZE, 1, ValueError, "camera: expected finite"),
        (None, (0, 5), 1, ValueError, "size: expected"),
        (None, 64, 1, ValueError, "size: expected"),
        (None, SIZE, -1, ValueError, "points_per_face: expected at least 0"),
        (None, SIZE, 1.5, TypeError, "integer"),
    ],
)
def test_bad_input_is_named(camera, size, points, error, named):
    tracer = rs.Tracer(rs.load("cornell"))
    with pytest.raises(error, match=named):
        rs.visible_faces(tracer, camera, size, points_per_face=points)
