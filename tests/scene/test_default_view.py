"""Cameras of scenes that have none: what they show, from where, and rooms from inside."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import cube, grid_floor, icosphere, soup
from solid_meshes import box_mesh, sphere_mesh

SIZE = 72, 72
UPS = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.1, 0.95, -0.15)]


def usual_camera(scene, aspect=4 / 3):
    return rs.Camera.framing(*scene.bounds, up=scene.up, aspect=aspect)


def assert_same_view(camera, other):
    """Of the same place, from the same direction."""
    np.testing.assert_allclose(camera.look_at, other.look_at, atol=1e-6)
    np.testing.assert_allclose(toward_eye(camera), toward_eye(other), atol=1e-6)
    assert camera.up == other.up


def hits_of(scene, camera=None):
    camera = camera or scene.camera_for(SIZE[0] / SIZE[1])
    return rs.Tracer(scene).first_hit(*camera.rays(*SIZE))


def toward_eye(camera):
    offset = np.subtract(camera.eye, camera.look_at)
    return offset / np.linalg.norm(offset)


def shows_all(camera, meshes, aspect=4 / 3):
    """Whether all vertices of meshes are inside the image."""
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    right, upward, depth = camera.basis() @ (vertices - np.array(camera.eye)).T
    half = math.tan(math.radians(camera.fov) / 2)
    return bool(
        (depth > 0).all()
        and (np.abs(right / depth) <= half * aspect).all()
        and (np.abs(upward / depth) <= half).all()
    )


def stray_triangles(size, distance, count=5, seed=1):
    """Some triangles of a size, on a sphere of a radius."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(count, 1, 3))
    away *= distance / np.linalg.norm(away, axis=2, keepdims=True)
    vertices = (away + rng.normal(size=(count, 3, 3)) * size).reshape(-1, 3)
    return rs.Mesh(vertices, np.arange(3 * count).reshape(-1, 3))


def open_box(side, *, flipped=False):
    """A unit cube without the faces whose outward normal is `side`."""
    vertices, faces = cube()
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outward = np.sign(np.einsum("fk,fk->f", normals, corners.mean(axis=1) - 0.5))
    faces = faces[(outward[:, None] * normals) @ np.array(side) < 0.5]
    return rs.Scene([rs.Mesh(vertices, faces[:, ::-1] if flipped else faces)])


FURNITURE = [
    ((0.3, 0.0, 0.3), (1.5, 0.8, 1.2)),
    ((4.5, 0.0, 0.2), (5.8, 1.9, 0.8)),
    ((2.4, 0.0, 1.6), (3.7, 0.7, 2.5)),
    ((2.7, 0.0, 2.8), (3.2, 0.9, 3.3)),
    ((0.2, 0.0, 2.9), (0.8, 2.1, 3.8)),
    ((5.1, 0.0, 2.6), (5.7, 0.6, 3.4)),
]


def room(scale=1.0, flipped=False):
    """A closed room of 6 x 2.7 x 4 with furniture."""
    boxes = [((0.0, 0.0, 0.0), (6.0, 2.7, 4.0)), *FURNITURE]
    return rs.Scene(
        [
            box_mesh(np.array(low) * scale, np.array(high) * scale, flipped=flipped and not number)
            for number, (low, high) in enumerate(boxes)
        ]
    )


# What to frame.


@pytest.mark.parametrize(
    "mesh",
    [
        rs.Mesh(*icosphere(3)),
        rs.Mesh(*cube()),
        rs.Mesh(*soup(300)),
        box_mesh((0, 0, 0), (1, 12, 1)),
        box_mesh((-3, 0, -3), (3, 0.2, 3)),
    ],
    ids=["sphere", "cube", "soup", "tower", "plate"],
)
@pytest.mark.parametrize("up", UPS[:3])
def test_ordinary_models_are_framed_completely(mesh, up):
    scene = rs.Scene([mesh], up=up)
    for aspect in (4 / 3, 0.5, 3.0):
        assert shows_all(scene.camera_for(aspect), [mesh], aspect)


@pytest.mark.parametrize("aspect", [0.3, 0.9, 4 / 3, 2.1, 4.0])
@pytest.mark.parametrize("shape", ["sphere", "pyramid"])
def test_models_reach_the_border_of_the_image(shape, aspect):
    vertices, faces = icosphere(4)
    if shape == "pyramid":  # the corners of its box are empty at the top
        vertices = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1], [0, 3, 0.0]])
        faces = [[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]]
    camera = rs.Scene([rs.Mesh(vertices, faces)]).camera_for(aspect)
    right, upward, depth = camera.basis() @ (vertices - np.array(camera.eye)).T
    half = math.tan(math.radians(camera.fov) / 2)
    reach = max(np.abs(right / depth).max() / aspect, np.abs(upward / depth).max()) / half
    assert (0.88 if shape == "sphere" else 0.7) < reach < 1


@pytest.mark.parametrize(
    ("make", "up"), [*((icosphere, up) for up in UPS), *((cube, up) for up in UPS[:4])]
)
def test_what_looks_alike_from_all_sides_is_seen_from_the_usual_one(make, up):
    scene = rs.Scene([rs.Mesh(*(make(3) if make is icosphere else make()))], up=up)
    for aspect in (4 / 3, 2.0):
        camera, usual = scene.camera_for(aspect), usual_camera(scene, aspect)
        assert_same_view(camera, usual)
        distance = math.dist(camera.eye, camera.look_at) / math.dist(usual.eye, usual.look_at)
        assert distance == pytest.approx(1) if make is cube else 0.5 < distance < 1


@pytest.mark.parametrize("size", [0.01, 1.0, 1000.0], ids=["small", "as large", "huge"])
@pytest.mark.parametrize("distance", [20.0, 1000.0, 1e6])
def test_a_few_strays_are_ignored(size, distance):
    scene = rs.Scene([sphere_mesh(level=4), stray_triangles(size, distance + 2 * size)])
    hits = hits_of(scene)
    assert np.mean(hits.mesh_id == 0) > 0.2
    assert shows_all(scene.camera, scene.meshes[:1])


def test_strays_at_any_distance_are_ignored():
    vertices, faces = icosphere(4)
    far = [[1.0, 0.0, 0.0], [1.0, 1e-3, 0.0], [1.0, 0.0, 1e-3]]
    for size in (1e-6, 1e-25, 1e-38):
        scene = rs.Scene([rs.Mesh(vertices * size, faces), rs.Mesh(far, [[0, 1, 2]])])
        camera = scene.camera
        assert math.dist(camera.eye, camera.look_at) < 0.1


def test_a_vertex_far_away_is_ignored():
    vertices, faces = icosphere(4)
    vertices[7] = 1e5, -3e5, 2e5
    scene = rs.Scene([rs.Mesh(vertices, faces)])
    assert np.mean(hits_of(scene).is_hit) > 0.2


def test_thin_parts_are_shown():
    antenna = box_mesh((-0.01, 0.9, -0.01), (0.01, 8.0, 0.01))
    scene = rs.Scene([sphere_mesh(level=4), antenna])
    assert shows_all(scene.camera, scene.meshes)
    beads = [sphere_mesh((1.5 * k, 0, 0), 0.05, level=1) for k in range(1, 9)]
    scene = rs.Scene([sphere_mesh(level=4), *beads])
    assert shows_all(scene.camera, scene.meshes)


def test_parts_beside_each_other_are_shown():
    scene = rs.Scene([sphere_mesh(level=4), sphere_mesh((2.9, 0.0, 0.0), 0.2, level=1)])
    assert shows_all(scene.camera, scene.meshes)


@pytest.mark.parametrize("cells", [1, 60], ids=["two triangles", "many triangles"])
@pytest.mark.parametrize("width", [10.0, 100.0, 10_000.0])
def test_a_large_ground_does_not_make_what_stands_on_it_small(cells, width):
    vertices, faces = grid_floor(cells)
    ground = rs.Mesh(vertices * width / 2, faces)
    scene = rs.Scene([ground, sphere_mesh((0.3, 1.0, 0.0), level=3)])
    hits = hits_of(scene)
    assert np.mean(hits.mesh_id == 1) > 0.17  # 0.24 without a ground
    assert shows_all(scene.camera, scene.meshes[1:])


def test_a_ground_that_is_not_much_larger_is_shown():
    vertices, faces = grid_floor(1)
    scene = rs.Scene([rs.Mesh(vertices * 2.5, faces), sphere_mesh((0.0, 1.0, 0.0), level=3)])
    assert shows_all(scene.camera, scene.meshes)
    many = [sphere_mesh((3.0 * x, 1.0, 3.0 * z), level=1) for x in range(5) for z in range(5)]
    scene = rs.Scene([rs.Mesh(vertices * 20.0 + [6, 0, 6], faces), *many])
    assert shows_all(scene.camera, many)


@pytest.mark.parametrize("radius", [25.0, 1000.0])
@pytest.mark.parametrize("is_half", [False, True], ids=["sphere", "dome"])
def test_what_is_under_a_sky_is_seen(radius, is_half):
    vertices, faces = icosphere(3)
    if is_half:
        faces = faces[(vertices[faces][..., 1] >= 0).all(axis=1)]
    ground = rs.Mesh(grid_floor(1)[0] * radius * 0.9, grid_floor(1)[1])
    sky = rs.Mesh(vertices * radius, faces[:, ::-1])
    model = sphere_mesh((0.3, 1.0, 0.0), level=2)
    for meshes in ([model, sky], [model, sky, ground]):
        scene = rs.Scene(meshes)
        assert np.mean(hits_of(scene).mesh_id == 0) > 0.15
        assert shows_all(scene.camera, [model])


def test_a_lamp_keeps_its_foot():
    scene = rs.Scene(
        [box_mesh((-1, 0, -1), (1, 0.1, 1)), box_mesh((-0.05, 0.1, -0.05), (0.05, 6, 0.05))]
    )
    assert shows_all(scene.camera, scene.meshes)


# From where.


@pytest.mark.parametrize("flipped", [False, True], ids=["outward", "inward"])
@pytest.mark.parametrize("side", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0)], ids=str)
def test_an_open_box_is_seen_from_its_open_side(side, flipped):
    scene = open_box(side, flipped=flipped)
    assert toward_eye(scene.camera) @ np.array(side) > 0.3


@pytest.mark.parametrize("side", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)], ids=str)
def test_a_shelf_is_seen_from_the_front(side):
    angle = math.atan2(side[0], side[2])
    turn = np.array(
        [
            [math.cos(angle), 0, math.sin(angle)],
            [0, 1, 0],
            [-math.sin(angle), 0, math.cos(angle)],
        ]
    )
    boxes = [box_mesh((-1, 0, -0.5), (1, 3, -0.4))]
    boxes += [
        box_mesh((x, y, -0.4), (x + 0.3, y + 0.4, 0.1)) for x in (-0.8, 0, 0.5) for y in (0.3, 1.6)
    ]
    meshes = [rs.Mesh(np.asarray(mesh.vertices) @ turn.T, mesh.faces) for mesh in boxes]
    assert toward_eye(rs.Scene(meshes).camera) @ np.array(side) > 0.5


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(n, marks=pytest.mark.ci) for n in range(3, 20))]
)
@pytest.mark.parametrize("up", UPS[:2])
def test_a_flat_mesh_is_not_seen_edge_on(seed, up):
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    vertices, faces = grid_floor(4)
    for mesh in (rs.Mesh(vertices @ turn.T, faces), rs.Mesh(turn.T[:3] * 1.0, [[0, 1, 2]])):
        scene = rs.Scene([mesh], up=up)
        corners = mesh.vertices[mesh.faces[0]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        assert abs(toward_eye(scene.camera) @ normal) > 0.3 * np.linalg.norm(normal)


@pytest.mark.parametrize("up", UPS[:4])
@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_mesh_in_a_plane_of_two_axes_is_not_seen_edge_on(shift, up):
    vertices, faces = grid_floor(4)
    scene = rs.Scene([rs.Mesh(np.roll(vertices, shift, axis=1), faces)], up=up)
    assert abs(toward_eye(scene.camera)[(1 + shift) % 3]) > 0.3
    assert np.mean(hits_of(scene).is_hit) > 0.1


def test_a_relief_is_seen_from_its_front():
    vertices, faces = grid_floor(24)
    x, _, z = vertices.T
    relief = np.stack([x, z, 0.1 * np.sin(9 * x) * np.cos(7 * z)], axis=1)
    for mesh_faces in (faces, faces[:, ::-1]):
        mesh = rs.Mesh(relief, mesh_faces)
        corners = mesh.vertices[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        front = np.sign(normals[:, 2].mean())
        assert front * toward_eye(rs.Scene([mesh]).camera)[2] > 0.5


# Rooms.


@pytest.mark.parametrize("flipped", [False, True], ids=["outward", "inward"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_room_is_seen_from_inside(scale, flipped):
    scene = room(scale, flipped)
    camera = scene.camera
    eye = np.array(camera.eye) / scale
    assert ((eye > 0.1) & (eye < [5.9, 2.6, 3.9])).all()
    for low, high in FURNITURE:
        assert not ((eye > np.array(low) - 0.05) & (eye < np.array(high) + 0.05)).all()
    hits = hits_of(scene)
    assert hits.is_hit.all()
    assert len(np.unique(hits.mesh_id)) >= 5  # walls and most of the furniture
    assert 60 <= camera.fov <= 70
    assert np.median(hits.t) > 1.5 * scale
    assert scene.camera_for(0.5) == camera


def test_a_room_may_have_another_up():
    def turned(points):
        return np.asarray(points)[:, [2, 0, 1]]

    meshes = [rs.Mesh(turned(mesh.vertices), mesh.faces) for mesh in room().meshes]
    camera = rs.Scene(meshes, up=(0, 0, 1)).camera
    assert 0.5 < camera.eye[2] < 2.2
    assert abs(camera.basis()[1] @ [0, 0, 1]) > 0.9
    assert 0 < camera.eye[0] < 4
    assert 0 < camera.eye[1] < 6


@pytest.mark.parametrize(
    "scene",
    [
        rs.Scene([rs.Mesh(*cube())]),
        rs.Scene([rs.Mesh(cube()[0], cube()[1][:, ::-1])]),
        rs.Scene([rs.Mesh(*icosphere(3))]),
        rs.Scene([rs.Mesh(*soup(2000, size=0.05))]),
    ],
    ids=["cube", "inward cube", "sphere", "soup"],
)
def test_what_is_no_room_is_seen_from_outside(scene):
    low, high = scene.bounds
    eye = np.array(scene.camera.eye)
    assert ((eye < low) | (eye > high)).any()


def test_the_cornell_box_is_seen_through_its_opening():
    scene = rs.load("cornell").replace(camera=None)
    assert scene.camera.eye[2] < scene.bounds[0, 2]
    assert len(np.unique(hits_of(scene).prim_id)) > 15


# Hard cases, and what the choice depends on.


def test_a_scene_without_triangles_has_the_usual_camera():
    for scene in (rs.Scene(), rs.Scene.from_arrays([[5, 5, 5]] * 3, [[0, 1, 2]])):
        assert scene.camera == usual_camera(scene)


def test_triangles_that_cannot_be_hit_do_not_count():
    vertices, faces = icosphere(2)
    bad = [[math.nan, 0, 0], [1e4, 0, 0], [2e4, 0, 0], [3e4, 0, 0], [math.inf, 1, 1], [0, 1, 0]]
    added = len(vertices) + np.array([[0, 1, 2], [1, 2, 3], [4, 5, 1]])
    whole = rs.Scene.from_arrays(np.vstack([vertices, bad]), np.vstack([faces, added]))
    assert whole.camera == rs.Scene.from_arrays(vertices, faces).camera


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e6])
@pytest.mark.parametrize("make", [room, lambda: open_box((0, 0, -1))], ids=["room", "open box"])
def test_the_choice_does_not_depend_on_the_scale(scale, make):
    scene = make()
    scaled = rs.Scene([rs.Mesh(np.asarray(m.vertices) * scale, m.faces) for m in scene.meshes])
    camera, other = scene.camera, scaled.camera
    assert camera.fov == other.fov
    if camera.fov == 40:
        assert toward_eye(other)[2] < -0.3
    else:
        low, high = scaled.bounds
        assert ((low < other.eye) & (other.eye < high)).all()


@pytest.mark.ci
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["soup", "sphere", "room"]))
def test_the_choice_does_not_depend_on_the_order_of_triangles(seed, kind):
    if kind == "room":
        scene = room()
        vertices = np.concatenate([np.asarray(m.vertices)[m.faces] for m in scene.meshes])
    else:
        made = soup(200) if kind == "soup" else icosphere(2)
        vertices = np.concatenate([made[0][made[1]], [[[50, 0, 0], [51, 0, 0], [50, 1, 0]]]])
    count = len(vertices)
    faces = np.arange(3 * count).reshape(-1, 3)
    order = np.random.default_rng(seed).permutation(count)
    one = rs.Scene.from_arrays(vertices.reshape(-1, 3), faces).camera
    other = rs.Scene.from_arrays(vertices.reshape(-1, 3), faces[order]).camera
    for field in ("eye", "look_at", "up", "fov"):
        np.testing.assert_allclose(getattr(other, field), getattr(one, field), rtol=1e-9)


def test_own_cameras_are_kept():
    camera = rs.Camera((9, 9, 9), (0, 0, 0))
    scene = room().replace(camera=camera)
    assert scene.camera is camera
    assert scene.replace(camera=None).camera != camera


def test_the_camera_follows_up_and_meshes():
    scene = rs.Scene([rs.Mesh(*icosphere(2))])
    tilted = scene.replace(up=(0, 0, 1))
    assert_same_view(tilted.camera, usual_camera(tilted))
    assert_same_view(scene.camera, usual_camera(scene))
    larger = scene.replace(meshes=[rs.Mesh(icosphere(2)[0] * 2, icosphere(2)[1])])
    np.testing.assert_allclose(larger.camera.eye, np.multiply(scene.camera.eye, 2), rtol=1e-6)


def test_choosing_a_camera_keeps_no_copy_of_the_triangles():
    scene = rs.Scene([sphere_mesh(level=5)])
    tracer = rs.Tracer(scene)
    before = scene.triangles.byte_count
    assert scene.camera.fov == 40
    assert scene.triangles.byte_count == before
    assert tracer.first_hit(*scene.camera.rays(8, 6)).is_hit.any()


@pytest.mark.ci
def test_all_renderers_use_the_same_camera():
    scene = room()
    image = rs.render(scene, "vis", (24, 18))
    given_camera = rs.render(scene, "vis", (24, 18), camera=scene.camera_for(24 / 18))
    np.testing.assert_array_equal(image.pixels, given_camera.pixels)
    moved = dataclasses.replace(scene.camera, fov=20.0)
    assert (rs.render(scene, "vis", (24, 18), camera=moved).pixels != image.pixels).any()
