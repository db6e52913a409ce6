"""Solids within solids: both lengths with a warning, or the inner one's."""

from __future__ import annotations

import re
import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import cube
from raystream.physics import segments
from solid_meshes import box_chords, box_mesh, joined, rays_from_outside, sphere_mesh, tracer_of

X = [1.0, 0.0, 0.0]
COLUMNS = (
    "ray_splits", "t_entry", "t_exit", "path_length", "mesh_id", "material_id", "entry_prim_id",
    "exit_prim_id", "instance_id",
)  # fmt: skip


def overlapping(*named):
    """Expect the one warning, which names these meshes."""
    return pytest.warns(rs.RaystreamWarning, match=".*".join(map(re.escape, named)))


def rows(found):
    columns = found.mesh_id, found.t_entry, found.t_exit
    return list(zip(*(column.tolist() for column in columns), strict=True))


def pipe_in_concrete(**pipe):
    """A block of 100, and a square pipe with walls of 2, which the block has no hole for."""
    outside = box_mesh([-0.5, 40, 40], [100.5, 60, 60])
    bore = box_mesh([-0.5, 42, 42], [100.5, 58, 58], flipped=True)
    walls = joined(outside, bore, name="pipe", material_ids=1)
    block = box_mesh([0, 0, 0], [100, 100, 100], name="concrete", material_ids=0)
    materials = rs.Material("concrete"), rs.Material("steel")
    return rs.Scene([block, walls], materials=materials)


def test_a_pipe_in_concrete():
    tracer = rs.Tracer(pipe_in_concrete())
    ray = [50.0, -10.0, 50.0], [0.0, 1.0, 0.0]
    with overlapping("meshes overlap", "0 ('concrete') and 1 ('pipe')", "nested='inner'"):
        both = rs.thickness(tracer, *ray)
    assert both.total_length(by="material").tolist() == [100.0, 4.0]
    inner = rs.thickness(tracer, *ray, nested="inner")
    assert inner.total_length(by="material").tolist() == [96.0, 4.0]
    assert rows(inner) == [(0, 10, 50), (1, 50, 52), (0, 52, 68), (1, 68, 70), (0, 70, 110)]
    assert inner.total_length() == 100.0
    assert inner.is_complete
    passed = rs.attenuation(inner, {"concrete": 0.01, "steel": 0.25})
    assert passed == pytest.approx(np.exp(-0.96 - 1.0))
    # Pieces end at the triangles of the pipe, and keep the material of the block.
    of_pipe = inner.entry_prim_id >= 12, inner.exit_prim_id >= 12
    np.testing.assert_array_equal(of_pipe[0], [False, True, True, True, True])
    np.testing.assert_array_equal(of_pipe[1], [True, True, True, True, False])
    assert inner.material_id.tolist() == [0, 1, 0, 1, 0]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_three_nested_shells(order):
    balls = [box_mesh([-r] * 3, [r] * 3, name=f"r{r}") for r in (3, 2, 1)]
    tracer = tracer_of(*(balls[k] for k in order))
    with overlapping("('r"):
        both = rs.thickness(tracer, [-5.0, 0.25, 0.125], X)
    assert both.total_length() == 12.0
    for ends, start, left in (("report", -5.0, 0.0), ("clip", -2.5, 0.5)):
        inner = rs.thickness(tracer, [start, 0.25, 0.125], X, ends=ends, nested="inner")
        lengths = dict(zip(inner.mesh_names, inner.total_length(by="mesh").tolist(), strict=True))
        assert lengths == {"r3": 2.0 - left, "r2": 2.0, "r1": 2.0}
        assert (inner.t_entry[1:] == inner.t_exit[:-1]).all()
        assert inner.is_complete


def test_of_overlapping_solids_the_smaller_one_displaces_the_other_in_both_directions():
    small, large = box_mesh([0, 0, 0], [2, 1, 1]), box_mesh([1, 0, 0], [4, 1, 1])
    for meshes in ((small, large), (large, small)):
        for origin, way in ((-1.0, X), (5.0, [-1.0, 0.0, 0.0])):
            tracer = tracer_of(*meshes)
            with overlapping("0 and 1"):
                both = rs.thickness(tracer, [origin, 0.5, 0.4], way)
            assert both.total_length() == 5.0
            inner = rs.thickness(tracer, [origin, 0.5, 0.4], way, nested="inner")
            lengths = inner.total_length(by="mesh").tolist()
            assert lengths == [2.0, 2.0]


def test_of_equal_solids_the_later_one_counts():
    one, other = box_mesh([0, 0, 0], [2, 1, 1]), box_mesh([1, 0, 0], [3, 1, 1])
    tracer = tracer_of(one, other, one)
    with overlapping("0 and 1; 0 and 2"):
        both = rs.thickness(tracer, [-1.0, 0.5, 0.4], X)
    assert both.total_length(by="mesh").tolist() == [2.0, 2.0, 2.0]
    inner = rs.thickness(tracer, [-1.0, 0.5, 0.4], X, nested="inner")
    assert inner.total_length(by="mesh").tolist() == [0.0, 1.0, 2.0]
    doubled = rs.thickness(tracer_of(one, one), [-1.0, 0.5, 0.4], X, nested="inner")
    assert rows(doubled) == [(1, 1.0, 3.0)]


def test_closed_meshes_displace_open_ones():
    vertices, faces = cube()
    # Without the two sides along y, whose volume would say nothing.
    straight = np.ptp(vertices[faces][:, :, 1], axis=1) > 0
    tube = rs.Mesh(vertices * [1, 0.1, 1], faces[straight], name="tube")
    tracer = tracer_of(tube, box_mesh([0.25, -1, -1], [2, 2, 2]))
    inner = rs.thickness(tracer, [-1.0, 0.05, 0.4], X, nested="inner")
    assert inner.mesh_is_closed.tolist() == [False, True]
    assert rows(inner) == [(0, 1.0, 1.25), (1, 1.25, 3.0)]


def test_instances():
    block = rs.Scene([box_mesh([0, 0, 0], [1, 1, 1], name="block")])
    transforms = np.zeros((4, 3, 4))
    for k, (size, place) in enumerate([(4.0, 0.0), (1.0, 1.0), (2.0, 1.5), (2.0, 1.5)]):
        transforms[k] = np.hstack([size * np.eye(3), [[place], [0.0], [0.0]]])
    transforms[3, 0, 0], transforms[3, 0, 3] = -2.0, 3.5  # mirrored, at the same place
    scene = rs.Scene.instances([block], transforms, [0] * 4)
    ray = [-1.0, 0.5, 0.4], X
    with overlapping("two instances of 0 ('block')"):
        both = rs.thickness(rs.Tracer(scene), *ray)
    assert both.total_length() == pytest.approx(9.0)
    inner = rs.thickness(rs.Tracer(scene), *ray, nested="inner")
    found = list(zip(inner.instance_id.tolist(), inner.path_length.tolist(), strict=True))
    assert found == [(0, 1.0), (1, 1.0), (3, 1.5), (0, 0.5)]
    flat = rs.thickness(rs.Tracer(scene.flattened()), *ray, nested="inner")
    np.testing.assert_array_equal(flat.path_length, inner.path_length)


def quiet(*meshes, origins, directions, **options):
    """Both lengths, without a warning; with "inner" the same bits."""
    tracer = tracer_of(*meshes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = rs.thickness(tracer, origins, directions, **options)
    inner = rs.thickness(tracer, origins, directions, nested="inner", **options)
    for column in COLUMNS:
        assert_same_bits(getattr(inner, column), getattr(both, column))
    return both


def test_solids_apart_stay_as_they_are(rng):
    meshes = [sphere_mesh([3 * k, 0, 0], level=2) for k in range(3)]
    meshes.append(joined(sphere_mesh(radius=2.0), sphere_mesh(radius=1.5, flipped=True)))
    meshes[3] = rs.Mesh(meshes[3].vertices + [0, 6, 0], meshes[3].faces)
    meshes.append(sphere_mesh([0, 6, 0]))  # in the cavity
    origins, directions = rays_from_outside(rng, 20_000, 9.0)
    found = quiet(*meshes, origins=origins, directions=directions, ends="clip")
    assert (found.counts > 2).any()


def test_solids_that_touch_do_not_overlap(rng):
    """A pipe in concrete with a hole for it, cut into other triangles: t differs by rounding."""
    vertices, faces = sphere_mesh(level=2).vertices, sphere_mesh(level=2).faces
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[0] *= np.linalg.det(turn)
    box = box_mesh([-3, -3, -3], [3, 3, 3])
    ball = rs.Mesh(vertices @ turn.T, faces, name="ball")
    hole = rs.Mesh(ball.vertices, np.roll(faces[:, ::-1], 1, axis=1))
    middle = rs.Mesh(box.vertices @ turn.T, box.faces)
    beside = rs.Mesh((box.vertices + [6, 0, 0]) @ turn.T, box.faces[:, [1, 2, 0]])
    origins, directions = rays_from_outside(rng, 20_000, 3.0)
    tracer = tracer_of(joined(middle, hole), ball, beside)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = rs.thickness(tracer, 3 * origins, directions)
    inner = rs.thickness(tracer, 3 * origins, directions, nested="inner")
    np.testing.assert_allclose(inner.total_length("mesh"), both.total_length("mesh"), atol=1e-5)


def test_the_warning_is_one_and_short():
    meshes = [box_mesh([-k] * 3, [k] * 3, name=f"{'shell' * 30} {k}") for k in range(1, 40)]
    with pytest.warns(rs.RaystreamWarning) as caught:
        rs.thickness(tracer_of(*meshes), [[-99.0, 0.5, 0.25]] * 100, X)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert "35 more pairs" in text
    assert len(text) < 600


def test_unknown_values_are_named():
    with pytest.raises(ValueError, match="nested: expected 'both' or 'inner', got 'outer'"):
        rs.thickness(tracer_of(box_mesh([0, 0, 0], [1, 1, 1])), [0, 0, 0], X, nested="outer")
    with pytest.raises(ValueError, match="nested: expected 'both' or 'inner', got 'outer'"):
        rs.render(rs.load("cornell"), "xray", size=(2, 2), absorption=1.0, nested="outer")


def test_an_x_ray_image_of_solids_within_solids():
    scene = pipe_in_concrete()
    camera = rs.Camera(
        (50, -50, 50), (50, 50, 50), up=(0, 0, 1), projection="orthographic", height=1.0
    )
    options = {"size": (1, 1), "camera": camera, "absorption": 0.01}
    with overlapping("xray: meshes overlap"):
        both = rs.render(scene, "xray", **options)
    inner = rs.render(scene, "xray", nested="inner", **options)
    for image, length in ((both, 104.0), (inner, 100.0)):
        np.testing.assert_allclose(image.pixels, np.exp(-0.01 * length), rtol=1e-5)


def expected_lengths(boxes, origins, directions):
    """By sorting the ends of intervals: each stretch belongs to the smallest box around it."""
    count = len(boxes)
    volumes = [np.prod(np.float32(high) - np.float32(low)) for low, high in boxes]
    lengths = np.zeros((len(origins), count))
    for ray, (origin, way) in enumerate(zip(origins, directions, strict=True)):
        with np.errstate(divide="ignore"):
            ends = (np.float32(boxes).astype(float) - origin) / way
        near, far = ends.min(axis=1).max(axis=1), ends.max(axis=1).min(axis=1)
        near = np.maximum(near, 0.0)
        places = np.sort(np.concatenate([near, far]))
        for t, until in pairwise(places):
            around = [k for k in range(count) if near[k] <= t and until <= far[k]]
            if around and until > t:
                owner = min(around, key=lambda k: (volumes[k], -k))
                lengths[ray, owner] += (until - t) * np.linalg.norm(way)
    return lengths


@given(st.integers(0, 2**20), st.integers(1, 9), st.sampled_from(["report", "clip"]))
@settings(max_examples=30)
def test_boxes_among_boxes(seed, count, ends):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-1, 0.7, (count, 3))
    boxes = np.stack([low, low + rng.uniform(0.05, 1.5, (count, 3))], axis=1)
    origins, directions = rays_from_outside(rng, 40)
    if ends == "clip":
        origins *= rng.uniform(0.0, 0.3, (40, 1))
    tracer = tracer_of(*(box_mesh(*box) for box in boxes), structure="brute")
    found = rs.thickness(tracer, origins, directions, ends=ends, nested="inner")
    expected = expected_lengths(boxes, origins, directions)
    np.testing.assert_allclose(found.total_length(by="mesh"), expected, atol=2e-5)
    same = found.ray_id[1:] == found.ray_id[:-1]
    assert (found.t_entry[1:] >= found.t_exit[:-1])[same].all()


def test_blocks_and_float64_rays_change_nothing(monkeypatch, rng):
    meshes = [box_mesh(low, low + rng.uniform(0.5, 2, 3)) for low in rng.uniform(-1, 0, (6, 3))]
    tracer = tracer_of(*meshes)
    origins, directions = np.float32(rays_from_outside(rng, 3000))
    whole = rs.thickness(tracer, origins, directions, nested="inner")
    monkeypatch.setattr(segments, "_RAYS_PER_BLOCK", 700)
    parts = rs.thickness(tracer, np.float64(origins), np.float64(directions), nested="inner")
    for column in COLUMNS:
        assert_same_bits(getattr(parts, column), getattr(whole, column))
    low, high = np.float32(meshes[0].vertices).min(axis=0), meshes[0].vertices.max(axis=0)
    most = box_chords(origins, directions, low, high)
    assert (whole.total_length(by="mesh")[:, 0] <= most + 1e-5).all()
