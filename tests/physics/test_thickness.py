"""Known chords through solids, and reports of unpaired crossings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import EVERY_QUERY, TRACERS, assert_same_bits
from meshes import cube, dented_sphere, icosphere
from raystream.physics import segments
from raystream.physics.thickness import UnpairedKind
from solid_meshes import (
    box_chords,
    box_mesh,
    joined,
    rays_from_outside,
    sphere_chords,
    sphere_mesh,
    tracer_of,
)

COLUMNS = (
    "ray_splits", "t_entry", "t_exit", "path_length", "mesh_id", "material_id",
    "entry_prim_id", "exit_prim_id", "unpaired_ray", "unpaired_t", "unpaired_prim_id",
    "unpaired_mesh_id", "unpaired_kind", "status", "is_complete",
)  # fmt: skip

X = [1.0, 0.0, 0.0]
ENTRY, EXIT = UnpairedKind.ENTRY, UnpairedKind.EXIT


def spans(found):
    return list(zip(found.t_entry.tolist(), found.t_exit.tolist(), strict=True))


def test_box_chords_are_exact(rng):
    low, high = [-0.5, -0.75, -0.25], [0.5, 0.25, 1.0]
    origins, directions = rays_from_outside(rng, 20_000)
    found = rs.thickness(tracer_of(box_mesh(low, high)), origins, directions)
    chords = box_chords(origins, directions, low, high)
    assert found.is_complete.all()
    np.testing.assert_allclose(found.total_length(), chords, atol=2e-6 * 10)
    assert 0.2 < (found.counts == 1).mean() < 0.8
    assert (found.t_entry <= found.t_exit).all()


def test_sphere_chords_to_the_mesh_s_coarseness(rng):
    origins, directions = rays_from_outside(rng, 20_000)
    found = rs.thickness(tracer_of(sphere_mesh(level=5)), origins, directions)
    chords = sphere_chords(origins, directions, [0, 0, 0], 1.0)
    inner = chords > 0.5
    np.testing.assert_allclose(found.total_length()[inner], chords[inner], atol=4e-3)
    assert found.is_complete.all()


def test_directions_of_any_length_give_scene_units():
    tracer = tracer_of(box_mesh([0, 0, 0], [1, 1, 1]))
    for length in (1e-20, 0.25, 1.0, 3.0, 1e20):
        found = rs.thickness(tracer, [-1.0, 0.3, 0.4], [length, 0.0, 0.0])
        assert found.path_length == pytest.approx(1.0, rel=1e-6)
        assert found.t_entry == pytest.approx(1.0 / length, rel=1e-6)


def test_a_shell_in_one_mesh_has_a_cavity():
    shell = joined(sphere_mesh(), sphere_mesh(radius=0.5, flipped=True))
    found = rs.thickness(tracer_of(shell), [-3.0, 0.01, 0.02], X)
    assert found.counts.item() == 2
    assert found.is_complete.all()
    assert not found.mesh_is_flipped.any()
    assert found.total_length().item() == pytest.approx(1.0, abs=0.01)


def test_nested_and_overlapping_parts_of_one_mesh_are_one_solid():
    nested = joined(box_mesh([0, 0, 0], [4, 1, 1]), box_mesh([1, 0.2, 0.2], [2, 0.8, 0.8]))
    assert spans(rs.thickness(tracer_of(nested), [-1.0, 0.5, 0.4], X)) == [(1.0, 5.0)]
    overlapping = joined(box_mesh([0, 0, 0], [2, 1, 1]), box_mesh([1, 0, 0], [3, 1, 1]))
    assert spans(rs.thickness(tracer_of(overlapping), [-1.0, 0.5, 0.4], X)) == [(1.0, 4.0)]


def test_parts_that_touch_make_one_segment_whichever_comes_first():
    left, right = box_mesh([0, 0, 0], [1, 1, 1]), box_mesh([1, 0, 0], [2, 1, 1])
    for parts in ((left, right), (right, left)):
        found = rs.thickness(tracer_of(joined(*parts)), [-1.0, 0.5, 0.4], X)
        assert spans(found) == [(1.0, 3.0)]


def test_overlapping_meshes_have_segments_of_their_own():
    meshes = box_mesh([0, 0, 0], [2, 1, 1]), box_mesh([1, 0, 0], [3, 1, 1])
    with pytest.warns(rs.RaystreamWarning, match="thickness: meshes overlap.*0 and 1"):
        found = rs.thickness(tracer_of(*meshes), [-1.0, 0.5, 0.4], X)
    assert spans(found) == [(1.0, 3.0), (2.0, 4.0)]
    assert found.mesh_id.tolist() == [0, 1]
    assert found.total_length().item() == 4.0
    assert found.total_length(by="mesh").tolist() == [2.0, 2.0]


def test_materials_come_from_where_the_ray_enters():
    ids = np.zeros(12, int)
    ids[:2] = 1  # low x
    materials = rs.Material("steel"), rs.Material("lead"), rs.Material("unused")
    meshes = (
        box_mesh([0, 0, 0], [1, 1, 1], material_ids=ids),
        box_mesh([2, 0, 0], [3, 1, 1], material_ids=1),
    )
    tracer = tracer_of(*meshes, materials=materials)
    found = rs.thickness(tracer, [[-1.0, 0.5, 0.4], [4.0, 0.5, 0.4]], [X, [-1.0, 0, 0]])
    assert found.material_id.tolist() == [1, 1, 1, 0]
    assert found.total_length(by="material").tolist() == [[0, 2, 0], [1, 1, 0]]
    assert found.material_names == ("steel", "lead", "unused")
    with pytest.raises(ValueError, match="by: expected 'mesh' or 'material'"):
        found.total_length(by="colour")


def test_inward_normals_are_noticed_and_said():
    for flipped in (False, True):
        found = rs.thickness(tracer_of(box_mesh([0, 0, 0], [1, 1, 1], flipped=flipped)),
                             [-1.0, 0.5, 0.4], X)  # fmt: skip
        assert found.mesh_is_closed.tolist() == [True]
        assert found.mesh_is_flipped.tolist() == [flipped]
        assert spans(found) == [(1.0, 2.0)]
        assert found.is_complete.all()


def test_a_flipped_part_beside_a_larger_one_is_reported():
    mesh = joined(box_mesh([0, 0, 0], [1, 1, 1], flipped=True), box_mesh([2, 0, 0], [9, 1, 1]))
    for ends in ("report", "clip"):
        found = rs.thickness(tracer_of(mesh), [-1.0, 0.5, 0.4], X, ends=ends)
        assert not found.mesh_is_flipped.any()
        assert spans(found) == [(3.0, 10.0)]
        assert found.unpaired_kind.tolist() == [EXIT, ENTRY]
        assert found.unpaired_t.tolist() == [1.0, 2.0]
        assert not found.is_complete


def test_an_open_mesh_is_reported_and_not_guessed():
    vertices, faces = cube()
    lid_less = rs.Mesh(vertices, faces[2:])
    for ends in ("report", "clip"):
        found = rs.thickness(
            tracer_of(lid_less),
            [[-1.0, 0.5, 0.4], [2.0, 0.5, 0.4], [0.4, 0.5, 3.0]],
            [X, [-1.0, 0, 0], [0, 0, -1.0]],
            ends=ends,
        )
        assert not found.mesh_is_closed.any()
        assert found.counts.tolist() == [0, 0, 1]
        assert found.unpaired_ray.tolist() == [0, 1]
        assert found.unpaired_kind.tolist() == [EXIT, ENTRY]
        assert found.unpaired_t.tolist() == [2.0, 1.0]
        assert found.unpaired_mesh_id.tolist() == [0, 0]
        assert found.is_complete.tolist() == [False, False, True]


def test_segments_that_the_interval_cuts():
    tracer = tracer_of(box_mesh([0, 0, 0], [4, 1, 1]), box_mesh([5, 0, 0], [6, 1, 1]))
    origins = [[1.0, 0.5, 0.4], [-1.0, 0.5, 0.4], [1.0, 0.5, 0.4], [4.5, 0.5, 0.4]]
    t_max = np.array([9.0, 3.0, 2.0, 0.25])
    found = rs.thickness(tracer, origins, X, t_max=t_max)
    assert found.counts.tolist() == [1, 0, 0, 0]
    assert found.unpaired_kind.tolist() == [EXIT, ENTRY]  # the third ray sees nothing
    assert found.is_complete.tolist() == [False, False, True, True]
    clipped = rs.thickness(tracer, origins, X, t_max=t_max, ends="clip")
    assert spans(clipped) == [(0.0, 3.0), (4.0, 5.0), (1.0, 3.0), (0.0, 2.0)]
    assert clipped.counts.tolist() == [2, 1, 1, 0]
    assert (clipped.entry_prim_id < 0).tolist() == [True, False, False, True]
    assert (clipped.exit_prim_id < 0).tolist() == [False, False, True, True]
    assert clipped.mesh_id.tolist() == [0, 1, 0, 0]
    assert clipped.is_complete.all()


def test_clipping_from_within_nested_parts_and_walls():
    nested = joined(box_mesh([0, 0, 0], [4, 1, 1]), box_mesh([1, 0.2, 0.2], [2, 0.8, 0.8]))
    found = rs.thickness(tracer_of(nested), [1.5, 0.5, 0.4], X, ends="clip")
    assert spans(found) == [(0.0, 2.5)]
    wall = joined(box_mesh([0, 0, 0], [4, 1, 1]), box_mesh([1, 0.2, 0.2], [2, 0.8, 0.8],
                                                          flipped=True))  # fmt: skip
    found = rs.thickness(tracer_of(wall), [0.5, 0.5, 0.4], X, ends="clip")
    assert spans(found) == [(0.0, 0.5), (1.5, 3.5)]
    assert found.is_complete.all()
    assert found.t_entry.dtype == found.t_exit.dtype == np.float32


def test_clipping_agrees_with_the_chord_of_the_interval(rng):
    low, high = [-0.5, -0.75, -0.25], [0.5, 0.25, 1.0]
    tracer = tracer_of(box_mesh(low, high))
    origins = rng.uniform(-1, 1, (5000, 3))
    directions = rng.normal(size=(5000, 3))
    t_min = rng.uniform(-1, 1, 5000).astype(np.float32)
    t_max = t_min + rng.uniform(0, 1, 5000).astype(np.float32)
    found = rs.thickness(tracer, origins, directions, t_min=t_min, t_max=t_max, ends="clip")
    with np.errstate(divide="ignore"):
        a, b = (np.array([low, high])[:, None] - origins) / directions
    near = np.maximum(np.minimum(a, b).max(axis=1), t_min)
    far = np.minimum(np.maximum(a, b).min(axis=1), t_max)
    expected = np.maximum(far - near, 0) * np.linalg.norm(directions, axis=1)
    np.testing.assert_allclose(found.total_length(), expected, atol=1e-5)
    assert found.is_complete.all()


def test_rays_through_edges_and_vertices_are_complete(rng):
    for vertices, faces in (icosphere(3), dented_sphere(3), cube()):
        vertices = np.float32(vertices)
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
        count = 60_000
        chosen = faces[rng.integers(0, len(faces), count)]
        share = rng.choice([0.0, 0.5], count)[:, None]
        corners = vertices.astype(float)
        targets = corners[chosen[:, 0]] * (1 - share) + corners[chosen[:, 1]] * share
        origins = rng.normal(size=(count, 3)) * 9
        origins = origins[np.linalg.norm(origins, axis=1) > 5]
        directions = targets[: len(origins)] - origins
        found = rs.thickness(tracer, origins, directions)
        assert found.is_complete.all()
        many = tracer.multi_hit(origins, directions, crossings="surfaces")
        assert (many.counts % 2 == 0).all()
        assert (found.path_length >= 0).all()


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
@pytest.mark.parametrize("name", EVERY_QUERY)
def test_every_structure_gives_the_same_bits(name, rng):
    meshes = (
        joined(sphere_mesh(level=1), sphere_mesh(radius=0.5, level=1, flipped=True)),
        box_mesh([0, 0, 0], [1.5, 1, 1]),
        rs.Mesh(*icosphere(0)[:1], icosphere(0)[1][3:]),
        rs.Mesh(*dented_sphere(1)),
    )
    scene = rs.Scene(meshes)
    corners = np.concatenate([mesh.vertices for mesh in meshes])
    origins = rng.normal(size=(300, 3)) * 3
    directions = corners[rng.integers(0, len(corners), 300)] - origins
    directions[::50] = 0.0
    rays = {"t_min": rng.choice([0.0, -9.0], 300), "t_max": rng.choice([1.0, np.inf], 300)}
    tracer, oracle = rs.Tracer(scene, **TRACERS[name]), rs.Tracer(scene, "brute")
    for ends in ("report", "clip"):
        found = rs.thickness(tracer, origins, directions, **rays, ends=ends)
        expected = rs.thickness(oracle, origins, directions, **rays, ends=ends)
        for column in COLUMNS:
            assert_same_bits(getattr(found, column), getattr(expected, column))
        assert len(found.t_entry) > 100
        assert len(found.unpaired_t) > 10


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_blocks_change_nothing(monkeypatch, rng):
    tracer = tracer_of(sphere_mesh(level=2), box_mesh([0, 0, 0], [2, 2, 2]))
    origins, directions = rays_from_outside(rng, 6000)
    origins, directions = origins.reshape(60, 100, 3), directions.reshape(60, 100, 3)
    whole = rs.thickness(tracer, origins, directions)
    assert whole.counts.shape == whole.is_complete.shape == (60, 100)
    monkeypatch.setattr(segments, "_RAYS_PER_BLOCK", 1024)
    seen = []
    parts = rs.thickness(
        tracer, origins, directions, progress=lambda done, total: seen.append((done, total))
    )
    for column in COLUMNS:
        assert_same_bits(getattr(parts, column), getattr(whole, column))
    assert seen == sorted(seen)
    assert seen[-1] == (6000, 6000)


def test_ctrl_c_gets_through(rng):
    def interrupt(done, total):
        raise KeyboardInterrupt

    tracer = tracer_of(sphere_mesh())
    with pytest.raises(KeyboardInterrupt):
        rs.thickness(tracer, *rays_from_outside(rng, 1000), progress=interrupt)


def test_nothing_and_bad_rays():
    for scene in (rs.Scene(), rs.Scene([box_mesh([0, 0, 0], [1, 1, 1])])):
        found = rs.thickness(rs.Tracer(scene), np.zeros((0, 3)), np.zeros((0, 3)))
        assert found.total_length().shape == (0,)
        assert found.ray_splits.tolist() == [0]
        found = rs.thickness(rs.Tracer(scene), np.zeros((2, 3)), [[0, 0, 0], [np.nan, 0, 1]])
        assert found.is_complete.tolist() == [False, False]
        assert found.total_length(by="mesh").shape == (2, len(scene.meshes))
    with pytest.raises(ValueError, match="ends: expected 'report' or 'clip', got 'guess'"):
        rs.thickness(rs.Tracer(scene), X, X, ends="guess")


def test_far_from_the_origin_and_tiny():
    for scale, offset in ((1e-6, 0.0), (1.0, 1e7), (1e-3, -1e5)):
        box = rs.Mesh(cube()[0] * scale + offset, cube()[1])
        origins = np.array([[-1.0, 0.3, 0.4]]) * scale + offset
        found = rs.thickness(tracer_of(box), origins, X)
        assert found.mesh_is_closed.all()
        assert found.total_length().item() == pytest.approx(scale, rel=1e-5)


def test_after_an_update():
    tracer = tracer_of(box_mesh([0, 0, 0], [1, 1, 1]))
    assert spans(rs.thickness(tracer, [-1.0, 0.5, 0.4], X)) == [(1.0, 2.0)]
    tracer.update(cube()[0] * [-3, 1, 1])  # mirrored: its normals now point inward
    found = rs.thickness(tracer, [-4.0, 0.5, 0.4], X)
    assert spans(found) == [(1.0, 4.0)]
    assert found.mesh_is_flipped.all()


boxes = st.lists(
    st.tuples(*[st.integers(-3, 2)] * 3, *[st.integers(1, 3)] * 3), min_size=1, max_size=4
)


@given(boxes, st.tuples(*[st.integers(-9, 9)] * 3), st.tuples(*[st.integers(-3, 3)] * 3))
@settings(max_examples=150)
def test_a_union_of_boxes_is_measured_as_intervals_are(sizes, origin, target):
    """Boxes on a lattice in one mesh; rays through the middle of cells."""
    origin = np.array(origin) + [0.25, 0.375, 0.3125]
    direction = np.array(target) + [0.5, 0.4375, 0.46875] - origin
    parts = [(np.array(s[:3]), np.array(s[:3]) + s[3:]) for s in sizes]
    tracer = tracer_of(joined(*(box_mesh(*part) for part in parts)))
    found = rs.thickness(tracer, origin, direction, t_min=-100.0)
    assert found.is_complete.all()
    cuts = []
    for low, high in parts:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (low - origin) / direction, (high - origin) / direction
        cuts.append((np.minimum(a, b).max(), np.maximum(a, b).min()))
    points = np.unique([p for cut in cuts if cut[0] < cut[1] for p in cut])
    middles, widths = (points[1:] + points[:-1]) / 2, np.diff(points)
    inside = np.any([(a < middles) & (middles < b) for a, b in cuts], axis=0)
    expected = widths[inside].sum() * np.linalg.norm(direction)
    assert found.total_length().item() == pytest.approx(expected, abs=1e-4)
