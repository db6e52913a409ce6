"""The grid as a structure: options, hard rays, limits of memory, the build, and files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, grid_floor, soup
from raystream.core.npz import read_npz, write_npz
from raystream.structures.grid.options import MAX_CELLS
from strategies import scenes_and_rays
from test_agreement import assert_same_answers

quiet = settings(max_examples=100)


def build(vertices, faces, **options):
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), "grid", **options).structure


def rays_at(vertices, rng, count=300):
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    origins = low + rng.random((count, 3)) * (high - low) * 3 - (high - low)
    return {
        "origins": origins,
        "directions": low + rng.random((count, 3)) * (high - low) - origins,
    }


def assert_equals_brute(vertices, faces, rays, **options):
    scene = rs.Scene.from_arrays(vertices, faces)
    tracer = rs.Tracer(scene, "grid", **options)
    assert_same_answers(tracer, rs.Tracer(scene, "brute"), rays)
    return tracer


# ---- Options.


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"resolution": 0}, ValueError, "resolution: expected 1 to 1,048,576, got 0"),
        ({"resolution": (1, 2)}, ValueError, "resolution: expected one number or three, got 2"),
        ({"resolution": 2.5}, TypeError, "float"),
        ({"resolution": (2, 2, 1 << 21)}, ValueError, "got 2,097,152"),
        ({"min_resolution": -1}, ValueError, "min_resolution: expected 1 to 1,048,576, got -1"),
        ({"min_resolution": 4, "resolution": 4}, ValueError, "min_resolution: expected None"),
        ({"levels": 3}, ValueError, "levels: expected 1 to 2, got 3"),
        ({"levels": 1.0}, TypeError, "float"),
        ({"cells": 3}, TypeError, "cells"),
    ],
)
def test_options_are_checked(options, error, words):
    with pytest.raises(error, match=words):
        build(*soup(2), **options)


def test_resolutions():
    mesh = soup(40, 1)
    assert build(*mesh, resolution=5).lattice.counts == (5, 5, 5)
    assert build(*mesh, resolution=np.array([2, 3, 4])).lattice.counts == (2, 3, 4)
    assert build(*mesh, resolution=5).options.resolution == (5, 5, 5)
    assert build(*grid_floor(4), resolution=5).lattice.counts == (5, 1, 5)
    thin = grid_floor(4)[0] + np.array([0, 1e-3, 0]) * soup(100)[0][:25]
    assert build(thin, grid_floor(4)[1], resolution=500).lattice.counts[1] < 100
    assert build(*grid_floor(4), min_resolution=6).lattice.counts == (6, 1, 6)
    stretched = soup(400, 1)[0] * [1, 3, 2]
    counts = build(stretched, soup(400)[1], min_resolution=8).lattice.counts
    size = np.ptp(stretched, axis=0) / counts
    assert min(counts) == 8
    assert size.max() < 1.1 * size.min()
    assert 1000 < build(*soup(1000, 1)).quality()["cells"] < 4000


def test_the_bunny_as_purcell_has_it(scenes_folder):
    tracer = rs.Tracer(rs.load("bunny"), "grid", min_resolution=64)
    assert tracer.structure.lattice.counts == (83, 82, 64)
    quality = tracer.structure.quality()
    assert quality["cells"] == 83 * 82 * 64
    assert 0.9 < quality["empty share"] < 1
    assert quality["references per triangle"] < 4


def test_figures():
    structure = build(*soup(500, 1), resolution=(4, 5, 6))
    quality = structure.quality()
    assert [quality[f"cells {axis}"] for axis in "xyz"] == [4, 5, 6]
    assert quality["cells"] == 120
    sizes = np.diff(structure.lists.splits)
    assert quality["largest list"] == sizes.max()
    assert quality["references per triangle"] == sizes.sum() / 500
    assert quality["bytes"] == structure.report.byte_count >= 4 * (121 + sizes.sum())
    two = build(*soup(500, 1), resolution=(4, 5, 6), levels=2).quality()
    assert two["divided cells"] > 50
    assert two["largest list"] < quality["largest list"]


# ---- Rays that are hard for cells.


def test_rays_in_the_faces_of_cells(rng):
    """Planes, triangles, origins and limits all on the same coarse lattice."""
    points = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3)
    vertices = points[rng.integers(0, len(points), 360)]
    faces = np.arange(360).reshape(-1, 3)
    origins = points[rng.integers(0, len(points), 500)] + rng.choice([0, 0, 0.5], (500, 3))
    directions = rng.integers(-2, 3, (500, 3)).astype(float)
    directions[~directions.any(axis=1)] = (0, 1, 0)
    for options in ({"resolution": 4}, {"resolution": (4, 2, 8)}, {"resolution": 2, "levels": 2}):
        for t_min in (0.0, 0.5, 1.0, -1.0):
            rays = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": 2.0}
            assert_equals_brute(vertices, faces, rays, **options)


def test_walls_between_cells(rng):
    """A wall in each plane between cells, of two triangles that share an edge."""
    walls = []
    for axis in range(3):
        for x in range(5):
            square = np.array([[x, 0, 0], [x, 4, 0], [x, 4, 4], [x, 0, 4.0]])
            walls.append(np.roll(square, axis, axis=1))
    faces = np.array([[4 * i, 4 * i + j, 4 * i + j + 1] for i in range(15) for j in (1, 2)])
    vertices = np.concatenate(walls)
    rays = rays_at(vertices, rng, 500)
    rays["origins"][::2] = np.round(rays["origins"][::2])
    rays["directions"][::3] = np.round(rays["directions"][::3])
    rays["directions"][~rays["directions"].any(axis=1)] = (1, 0, 0)
    for resolution in (1, 2, 4, 8):
        assert_equals_brute(vertices, faces, rays, resolution=resolution)


def test_hits_beyond_an_edge_in_another_cell(rng):
    """A ray almost in a triangle's plane may hit that plane, far from the triangle.

    So cells next to a triangle list it as well, if its plane and its box go through them.
    """
    corners = rng.random((40, 3, 3)).astype(np.float32).astype(float)
    origins, directions = [], []
    for a, b, c in corners:
        normal = np.cross(b - a, c - a)
        weights = rng.uniform(-1, 2, (2000, 3))
        weights /= weights.sum(axis=1, keepdims=True)
        beyond = weights @ [a, b, c]
        low, high = np.min([a, b, c], axis=0), np.max([a, b, c], axis=0)
        in_box = ((beyond >= low) & (beyond <= high)).all(axis=1)
        beyond = beyond[in_box & (weights.min(axis=1) < -0.05)]
        inside = rng.dirichlet([1, 1, 1], len(beyond)) @ [a, b, c]
        along = inside - beyond
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        tilt = 10.0 ** rng.uniform(-9, -6, (len(beyond), 1)) / np.linalg.norm(normal)
        along += normal * tilt
        origins.append(beyond - along * rng.uniform(0.5, 3, (len(beyond), 1)))
        directions.append(along)
    rays = {"origins": np.concatenate(origins), "directions": np.concatenate(directions)}
    mesh = corners.reshape(-1, 3), np.arange(120).reshape(-1, 3)
    for options in ({}, {"resolution": 30}, {"resolution": 3, "levels": 2}):
        tracer = assert_equals_brute(*mesh, rays, **options)
    # There are such hits: the points that t gives are not in the triangles.
    many = tracer.multi_hit(**rays)
    along = rays["directions"][many.ray_id].astype(np.float32).astype(float)
    points = rays["origins"][many.ray_id].astype(np.float32) + along * many.t[:, None]
    a, b, c = corners[many.prim_id].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    outside = np.min(
        [
            np.einsum("ij,ij->i", np.cross(q - p, points - p), normal)
            for p, q in ((a, b), (b, c), (c, a))
        ],
        axis=0,
    )
    assert (outside < -0.01 * np.einsum("ij,ij->i", normal, normal)).sum() > 10


@quiet
@given(
    scenes_and_rays(),
    st.sampled_from([1, 2, 3, (7, 1, 2), (1, 16, 1), None]),
    st.sampled_from([1, 2]),
    st.sampled_from([0.0, -np.inf, 0.5]),
)
def test_equals_brute_force(drawn, resolution, levels, t_min):
    vertices, faces, origins, directions = drawn
    rays = {"origins": origins, "directions": directions, "t_min": t_min}
    assert_equals_brute(vertices, faces, rays, resolution=resolution, levels=levels)


# ---- Bounded memory.


def test_too_many_cells_are_refused():
    mesh = soup(20, 1)
    with pytest.raises(ValueError, match="resolution: 100,000 x 100,000 x 100,000 cells are out"):
        build(*mesh, resolution=100_000)
    flat = mesh[0] * [1e6, 1e6, 1.0]  # where a cell is as large as rounding may move a hit
    with pytest.raises(ValueError, match=r"min_resolution: [\d,]+ x [\d,]+ x 1 cells"):
        build(flat, mesh[1], min_resolution=64)
    with pytest.raises(ValueError, match="resolution"):
        build(*mesh, resolution=(MAX_CELLS // 256, 512, 1))


def test_cells_that_do_not_fit_are_refused(monkeypatch):
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 1 << 20)
    with pytest.raises(MemoryError, match=r"resolution: 1,000,000 cells would.*coarser"):
        build(*soup(20, 1), resolution=100)
    assert build(*soup(20, 1)).quality()["cells"] < 100


def test_too_many_references_are_refused(monkeypatch):
    monkeypatch.setattr("raystream.structures.grid.build.MAX_REFERENCES", 1000)
    with pytest.raises(ValueError, match="min_resolution: more than 1,000 references"):
        build(*soup(200, 1), min_resolution=20)


def test_large_triangles_make_coarser_cells(rng):
    vertices = rng.random((60_000, 3))
    faces = np.arange(60_000).reshape(-1, 3)
    for levels in (1, 2):
        quality = build(vertices, faces, levels=levels).quality()
        # Those of cells that are not divided come on top.
        assert quality["references per triangle"] * 20_000 <= 2**20 * (1.0, 1.1)[levels - 1]
        assert quality["cells"] >= 8


@pytest.mark.parametrize("levels", [1, 2])
def test_a_teapot_in_a_stadium(levels, rng):
    """Detail of a millimetre in a scene of a thousand kilometres: few cells, the same hits."""
    small, small_faces = dented_sphere(2)
    large, large_faces = grid_floor(2)
    vertices = np.concatenate([small * 1e-3 + 0.5, large * 1e6 - [0, 1, 0]])
    faces = np.concatenate([small_faces, large_faces + len(small)])
    rays = rays_at(small * 1e-3 + 0.5, rng)
    tracer = assert_equals_brute(vertices, faces, rays, levels=levels)
    assert tracer.structure.quality()["cells"] < 4 * len(faces)
    assert tracer.any_hit(**rays).any()


def test_a_huge_empty_grid(rng):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertices = np.concatenate([vertices, 1000 - vertices, vertices + [500, 0, 0]])
    faces = np.arange(9).reshape(-1, 3)
    rays = rays_at(vertices, rng)
    rays["directions"][::3] = vertices[rng.integers(0, 9, 100)] - rays["origins"][::3]
    tracer = assert_equals_brute(vertices, faces, rays, resolution=150)
    assert tracer.structure.quality()["empty share"] > 0.999
    assert tracer.any_hit(**rays).any()


# ---- The build.


def test_the_same_lists_for_any_number_of_threads():
    mesh = soup(3000, 1)
    for levels in (1, 2):
        grids = []
        for count in (1, 3):
            rs.set_thread_count(count)
            try:
                grids.append(build(*mesh, levels=levels).saved_arrays())
            finally:
                rs.set_thread_count(None)
        for name, array in grids[0].items():
            assert_same_bits(array, grids[1][name])


def test_progress_and_interrupts():
    scene = rs.Scene.from_arrays(*soup(20_000, 1, 0.02))
    seen = []
    rs.Tracer(scene, "grid", progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (20_000, 20_000)
    assert seen == sorted(seen)

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.Tracer(scene, "grid", progress=interrupt)


def test_long_lists_make_short_calls():
    """Otherwise Ctrl-C would be delayed."""
    mesh = soup(20_000, 1, 0.02)
    assert build(*mesh, resolution=1).rays_per_call < 300
    assert build(*mesh).rays_per_call == 4096


# ---- Files.


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("splits", lambda a: a[:-1]),
        ("splits", lambda a: a.astype(np.int64)),
        ("splits", lambda a: a[:, None]),
        ("splits", put(-1, 2**32 - 1)),
        ("splits", put(0, 1)),
        ("splits", put(3, 2**31)),
        ("references", lambda a: a[:-1]),
        ("references", put(0, -1)),
        ("references", put(0, 10**6)),
        ("references", put(slice(None), 0)),
        ("references", lambda a: a.astype(np.uint32)),
        ("counts", put(0, 0)),
        ("counts", put(0, -2)),
        ("counts", put(slice(None), 1 << 20)),
        ("counts", put(1, 1 << 40)),
        ("counts", lambda a: a[:2]),
        ("box", put((0, 0), np.nan)),
        ("box", put((1, 0), np.inf)),
        ("box", put((0, 1), 1.0)),
        ("box", lambda a: a[::-1].copy()),
        ("box", lambda a: a.astype(np.float64)),
        ("fine_cells", put(0, -1)),
        ("fine_cells", put(-1, 10**9)),
        ("fine_cells", lambda a: a[::-1].copy()),
        ("fine_cells", lambda a: a[:-1]),
        ("fine_counts", put((0, 0), 0)),
        ("fine_counts", put((0, 0), 1025)),
        ("fine_counts", put(0, 1024)),
        ("fine_splits", lambda a: a[:-1]),
        ("fine_references", put(0, 10**6)),
    ],
)
def test_hostile_files_are_refused(tmp_path, name, change):
    scene = rs.Scene.from_arrays(*soup(400, 1))
    rs.Tracer(scene, "grid", resolution=(3, 4, 5), levels=2).save(tmp_path / "x.npz")
    arrays = read_npz(tmp_path / "x.npz")
    arrays[f"structure.{name}"] = change(arrays[f"structure.{name}"].copy())
    write_npz(tmp_path / "y.npz", arrays)
    with pytest.raises(rs.FileFormatError, match=r"y\.npz: "):
        rs.Tracer.load(tmp_path / "y.npz")
    del arrays[f"structure.{name}"]
    write_npz(tmp_path / "y.npz", arrays)
    with pytest.raises(rs.FileFormatError, match="missing"):
        rs.Tracer.load(tmp_path / "y.npz")
