"""Moving vertices: every query then answers as brute force in the same frame."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import EVERY_GRAPHICS_TRACER, EVERY_TREE, assert_same_bits
from meshes import dented_sphere, icosphere, soup
from raystream.core.triangles import RECENTRE_RATIO, Triangles
from test_agreement import assert_same_answers


def in_the_frame_of(tracer: rs.Tracer) -> rs.Tracer:
    """Brute force of the tracer's scene, whose store is made by NumPy in the same frame."""
    frame = tracer.structure.triangles
    corners = [frame.to_local(mesh.vertices)[mesh.faces] for mesh in tracer.scene.meshes]
    store = Triangles.from_local(
        np.concatenate(corners), frame.mesh_splits, frame.center, frame.scale
    )
    return rs.Tracer(rs.Scene.from_triangles(store), "brute")


def rays_at(vertices, rng, count=300):
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = (high - low).max()
    origins = low + rng.random((count, 3)) * (high - low) + rng.normal(size=(count, 3)) * size
    targets = low + rng.random((count, 3)) * (high - low)
    return {"origins": origins, "directions": targets - origins}


def deformed(vertices, rng):
    """Bent, stretched, turned, torn or shuffled; sometimes hardly moved."""
    kind = rng.integers(6)
    size = np.ptp(vertices, axis=0).max()
    if kind == 0:
        return vertices + np.sin(vertices[:, [1, 2, 0]] * rng.uniform(1, 9)) * 0.3 * size
    if kind == 1:
        return vertices * rng.uniform(0.1, 3, 3)
    if kind == 2:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        return vertices @ turn + rng.normal(size=3) * size
    if kind == 3:
        return vertices + rng.normal(size=vertices.shape) * size * 10.0 ** rng.uniform(-6, 0)
    if kind == 4:
        return rng.permutation(vertices)
    flat = vertices.copy()
    flat[:, rng.integers(3)] = 0.25
    return flat


@pytest.mark.parametrize("quality", ["fast", "balanced"])
@pytest.mark.parametrize("max_cost_growth", [0.0, 1.5, np.inf])
@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.exhaustive)])
def test_many_deformations(quality, max_cost_growth, count, rng):
    vertices, faces = dented_sphere(1)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), quality=quality)
    seen = set()
    for _ in range(count):
        moved = deformed(vertices, rng)
        report = tracer.update(moved, max_cost_growth=max_cost_growth)
        seen.add(report.rebuilt)
        assert report.cost <= max(max_cost_growth, 1.0) * report.cost_when_built
        assert_same_bits(tracer.scene.meshes[0].vertices, moved)
        assert_same_answers(tracer, in_the_frame_of(tracer), rays_at(moved, rng, 60))
    assert seen == {0.0: {True}, 1.5: {False, True}, np.inf: {False}}[max_cost_growth]


@pytest.mark.parametrize(
    "make_tracer_anywhere", [*EVERY_TREE, *EVERY_GRAPHICS_TRACER], indirect=True
)
def test_every_structure_can_be_updated(make_tracer_anywhere, rng):
    vertices, faces = soup(120, 4)
    tracer = make_tracer_anywhere(rs.Scene.from_arrays(vertices, faces))
    for _ in range(4):
        vertices = deformed(vertices, rng)
        tracer.update(vertices.astype(np.float32))
        assert tracer.structure.options == make_tracer_anywhere(tracer.scene).structure.options
        assert_same_answers(tracer, in_the_frame_of(tracer), rays_at(vertices, rng))


def test_the_store_is_what_the_constructor_would_make(rng):
    """Bit for bit, with bounds and counts, for both dtypes, moved and scaled frames."""
    for offset, scale in ((0.0, 1.0), (1e7, 1.0), (0.0, 1e-9), (-3e3, 1e9)):
        vertices, faces = dented_sphere(2)
        for dtype in (np.float32, np.float64):
            points = (vertices * scale + offset).astype(dtype)
            points[[3, 50]] = np.nan
            points[7] = points[faces[0, 0]]
            tracer = rs.Tracer(rs.Scene.from_arrays(points, faces), "brute")
            expected = tracer.structure.triangles
            tracer.update(points)
            found = tracer.structure.triangles
            assert found is not expected
            for name in (
                "corners",
                "prim_ids",
                "mesh_splits",
                "center",
                "bounds",
                "max_coordinate",
            ):
                assert_same_bits(getattr(found, name), getattr(expected, name))
            assert found.scale == expected.scale
            assert found.degenerate_count == expected.degenerate_count
            assert found.nonfinite_count == expected.nonfinite_count > 0


def test_triangles_vanish_and_come_back(rng):
    vertices, faces = dented_sphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    rays = rays_at(vertices, rng)
    before = tracer.multi_hit(**rays)
    for value in (np.nan, np.inf, 1e300):
        broken = vertices.copy()
        broken[rng.integers(0, len(vertices), 60), rng.integers(3)] = value
        report = tracer.update(broken, max_cost_growth=np.inf)
        assert not report.rebuilt
        assert tracer.scene.skipped_count > 60
        assert_same_answers(tracer, in_the_frame_of(tracer), rays)
    collapsed = vertices.copy()
    collapsed[faces[::3]] = collapsed[faces[::3, :1]]
    tracer.update(collapsed)
    assert_same_answers(tracer, in_the_frame_of(tracer), rays)
    tracer.update(np.zeros_like(vertices))
    assert not tracer.any_hit(**rays).any()
    assert tracer.update(vertices).cost > 0
    again = tracer.multi_hit(**rays)
    for column in ("ray_splits", "t", "u", "v", "prim_id"):
        assert_same_bits(getattr(again, column), getattr(before, column))


def test_triangles_that_could_not_be_hit_at_first_appear(rng):
    vertices, faces = soup(50, 3)
    hidden = vertices.copy()
    hidden[30:60] = np.nan
    hidden[90:93] = 0.5
    tracer = rs.Tracer(rs.Scene.from_arrays(hidden, faces))
    assert tracer.update(vertices).rebuilt
    rays = rays_at(vertices, rng)
    assert_same_answers(tracer, in_the_frame_of(tracer), rays)
    assert not tracer.update(hidden, max_cost_growth=np.inf).rebuilt
    assert_same_answers(tracer, in_the_frame_of(tracer), rays)
    nothing = rs.Tracer(rs.Scene.from_arrays(np.zeros_like(vertices), faces))
    nothing.update(vertices)
    assert_same_answers(nothing, in_the_frame_of(nothing), rays)


def frame_of(tracer):
    triangles = tracer.structure.triangles
    return (*triangles.center.tolist(), triangles.scale)


@pytest.mark.parametrize("scale", [1e-38, 1e-30, 1e-12, 1e-5, 1e7, 1e11, 1e30])
def test_extreme_moves_answer_as_a_new_tracer(scale, rng):
    vertices, faces = dented_sphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    moved = vertices * scale + rng.normal(size=3) * scale * 3
    tracer.update(moved, max_cost_growth=np.inf)
    fresh = rs.Tracer(rs.Scene.from_arrays(moved, faces), "brute")
    assert frame_of(tracer) == frame_of(fresh)
    rays = rays_at(moved, rng)
    assert_same_answers(tracer, fresh, rays)
    assert tracer.any_hit(**rays).any()


FAR = [(1e5, 5e4, 0.0), (5e6, 0.0, 0.0), (-3e4, 700.0, 2e9), (0.0, 0.0, -40.0)]


@pytest.mark.parametrize("offset", FAR)
def test_a_far_move_answers_as_a_new_tracer(offset, rng):
    """In the frame where it was built, float32 would round a sphere at 5e6 to steps of a half."""
    vertices, faces = icosphere(4)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    near = {"origins": rng.normal(size=(2000, 3)) * 3, "directions": rng.normal(size=(2000, 3))}
    near["origins"][:1000] = 0.0
    before = tracer.first_hit(**near)
    moved = vertices + offset
    assert tracer.update(moved, max_cost_growth=np.inf).rebuilt
    fresh = rs.Tracer(rs.Scene.from_arrays(moved, faces), "brute")
    assert frame_of(tracer) == frame_of(fresh)
    there = near | {"origins": near["origins"] + offset}
    assert_same_answers(tracer, fresh, there)
    after = tracer.first_hit(**there)
    assert (after.prim_id == before.prim_id)[:1000].mean() > 0.999  # float64 rounds them, too
    points = there["origins"][-200:]
    found, expected = tracer.closest_point(points), fresh.closest_point(points)
    assert_same_bits(found.distance, expected.distance)
    assert_same_bits(found.prim_id, expected.prim_id)
    assert_same_bits(tracer.contains(points), fresh.contains(points))
    tracer.update(vertices)
    assert_same_bits(tracer.first_hit(**near).t, before.t)


@pytest.mark.parametrize(
    "make_tracer_anywhere", [*EVERY_TREE, *EVERY_GRAPHICS_TRACER], indirect=True
)
def test_every_structure_follows_far_moves(make_tracer_anywhere, rng):
    vertices, faces = soup(120, 4)
    tracer = make_tracer_anywhere(rs.Scene.from_arrays(vertices, faces))
    for offset in FAR[:2]:
        moved = vertices + offset
        tracer.update(moved)
        fresh = make_tracer_anywhere(tracer.scene)
        assert frame_of(tracer) == frame_of(fresh) != (0.0, 0.0, 0.0, 1.0)
        assert_same_answers(tracer, in_the_frame_of(fresh), rays_at(moved, rng))


def test_a_scene_that_shrinks_far_from_its_centre(rng):
    """Other meshes of a large scene are gone, so that what is left lies far from the centre."""
    first, second = dented_sphere(2), soup(60, 2, 300.0)
    scene = rs.Scene([rs.Mesh(first[0] + [500.0, 20.0, 0.0], first[1]), rs.Mesh(*second)])
    tracer = rs.Tracer(scene)
    assert tracer.update([None, np.full_like(second[0], np.nan)], max_cost_growth=np.inf).rebuilt
    fresh = rs.Tracer(rs.Scene(tracer.scene.meshes), "brute")
    assert frame_of(tracer) == frame_of(fresh) != (0.0, 0.0, 0.0, 1.0)
    assert_same_answers(tracer, fresh, rays_at(scene.meshes[0].vertices, rng))
    tracer.update([None, second[0]])
    assert_same_answers(tracer, in_the_frame_of(tracer), rays_at(second[0], rng))


def test_the_frame_stays_while_it_serves():
    """As a new tracer allows: so scenes that move to and fro are refitted."""
    vertices, faces = icosphere(2)
    extent = np.ptp(vertices, axis=0).max()
    for start in (0.0, 1e5):
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices + [start, 0, 0], faces))
        frame = frame_of(tracer)
        for way in (3.0, -5.0, RECENTRE_RATIO - 2, 0.0, 2 - RECENTRE_RATIO, 1.0):
            moved = vertices + [start + way * extent, 0, 0]
            assert not tracer.update(moved, max_cost_growth=np.inf).rebuilt
            assert frame_of(tracer) == frame
        reports = []
        for way in (1.0, -1.0) * 5:  # around the limit
            moved = vertices + [start + (RECENTRE_RATIO + way) * extent, 0, 0]
            reports.append(tracer.update(moved, max_cost_growth=np.inf).rebuilt)
        assert reports == [True] + [False] * 9


def test_one_triangle_flies_away(rng):
    vertices, faces = soup(200, 8)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    for distance in (1.0, 1e3, 1e6):
        vertices[:3] += distance
        tracer.update(vertices, max_cost_growth=np.inf)
        assert_same_answers(tracer, in_the_frame_of(tracer), rays_at(vertices[3:], rng))


def test_a_triangle_of_a_still_scene_may_fly_far():
    vertices, faces = soup(50, 8)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    vertices[:3] += 1e5  # another centre would not help
    assert not tracer.update(vertices, max_cost_growth=np.inf).rebuilt
    assert frame_of(tracer) == (0.0, 0.0, 0.0, 1.0)


def test_earlier_hits_keep_their_triangles():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2]]))
    early = tracer.first_hit([0.25, 0.25, 9], [0, 0, -1])
    tracer.update(vertices + [0, 0, 5])
    late = tracer.first_hit([0.25, 0.25, 9], [0, 0, -1])
    assert (early.t, late.t) == (9.0, 4.0)
    assert early.positions.tolist() == [0.25, 0.25, 0.0]
    assert late.positions.tolist() == [0.25, 0.25, 5.0]


def test_meshes_move_one_by_one(rng):
    first, second = dented_sphere(1), soup(20, 2)
    scene = rs.Scene(
        [rs.Mesh(*first, name="first"), rs.Mesh(*second, colors=np.ones((60, 3)))],
        background=(1, 2, 3),
    )
    tracer = rs.Tracer(scene)
    tracer.update([None, second[0] + 1.0])
    assert tracer.scene.meshes[0] is scene.meshes[0]
    assert tracer.scene.meshes[1].colors is scene.meshes[1].colors
    assert tracer.scene.background == scene.background
    assert scene.triangles is not tracer.scene.triangles
    assert_same_bits(scene.meshes[1].vertices, second[0])
    assert_same_answers(tracer, in_the_frame_of(tracer), rays_at(first[0], rng))


@pytest.mark.parametrize(
    ("vertices", "error", "words"),
    [
        (np.zeros((4, 3)), ValueError, "expected 3, as before, got 4"),
        ([np.zeros((4, 3))], ValueError, "expected 3, as before, got 4"),
        ([np.zeros((3, 3))] * 2, ValueError, r"expected shape \(V, 3\)"),
        (np.zeros((3, 2)), ValueError, r"expected shape \(V, 3\)"),
        ([["a", "b", "c"]] * 3, TypeError, "vertices: expected real numbers"),
        (0.0, ValueError, r"expected shape \(V, 3\)"),
    ],
)
def test_wrong_vertices_are_refused_and_nothing_moves(vertices, error, words):
    mesh = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    tracer = rs.Tracer(rs.Scene.from_arrays(*mesh))
    with pytest.raises(error, match=words):
        tracer.update(vertices)
    assert tracer.first_hit([0.25, 0.25, 9], [0, 0, -1]).t == 9.0
    two = rs.Tracer(rs.Scene([rs.Mesh(*mesh), rs.Mesh(*mesh)]))
    with pytest.raises(ValueError, match=r"for each of 2 meshes, got 1|got 3"):
        two.update([mesh[0]])
    with pytest.raises(ValueError, match="mesh 1: vertices: expected 3, as before, got 1"):
        two.update([None, [[0, 0, 0]]])


@pytest.mark.parametrize("growth", [-1.0, np.nan])
def test_max_cost_growth_is_checked(growth):
    with pytest.raises(ValueError, match="max_cost_growth"):
        rs.Tracer(rs.Scene()).update([], max_cost_growth=growth)


def test_an_empty_scene_can_be_updated():
    tracer = rs.Tracer(rs.Scene())
    tracer.update([])
    assert not tracer.any_hit([0, 0, 0], [1, 0, 0])
    tracer = rs.Tracer(rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int)))
    tracer.update(np.zeros((0, 3)))
    assert not tracer.any_hit([0, 0, 0], [1, 0, 0])


def test_a_loaded_tracer_can_be_updated(tmp_path, rng):
    vertices, faces = dented_sphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    broken = vertices.copy()
    broken[::9] = np.nan
    tracer.update(broken, max_cost_growth=np.inf)
    tracer.save(tmp_path / "moved.npz")
    loaded = rs.Tracer.load(tmp_path / "moved.npz", tracer.scene)
    rays = rays_at(vertices, rng)
    assert_same_answers(loaded, in_the_frame_of(tracer), rays)
    assert not loaded.update(vertices, max_cost_growth=np.inf).rebuilt
    assert_same_answers(loaded, in_the_frame_of(loaded), rays)


def test_progress_when_built_anew(rng):
    vertices, faces = soup(30_000, 5, 0.02)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    seen = []
    tracer.update(
        rng.permutation(vertices.reshape(-1, 3, 3)).reshape(-1, 3),
        progress=lambda done, total: seen.append((done, total)),
    )
    assert seen[-1] == (30_000, 30_000)


def test_an_interrupt_leaves_everything_as_it_was(monkeypatch, rng):
    vertices, faces = dented_sphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    rays = rays_at(vertices, rng)

    def interrupted(tree):
        raise KeyboardInterrupt

    scene = tracer.scene
    tracer.update(vertices)  # its cost when built is known from here on
    monkeypatch.setattr("raystream.structures.bvh.structure.trace_cost", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tracer.update(vertices * 2)
    monkeypatch.undo()
    assert_same_answers(tracer, rs.Tracer(scene, "brute"), rays)
