"""Visibility between points, against brute force, float64 and solids where the answer is known."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import EVERY_QUERY, TRACERS
from instanced import random_transforms
from meshes import cube, dented_sphere, icosphere, soup
from oracles import judge
from raystream.core.errors import FileFormatError
from raystream.line_of_sight import resumable_array, visibility
from raystream.line_of_sight.tiles import Tiles
from strategies import COORDINATES, meshes


def tracer_of(mesh, **options):
    return rs.Tracer(rs.Scene.from_arrays(*mesh), **options)


def surely(mesh, a, b):
    """Whether pairs surely see each other, and surely do not: shape (N, M), in float64."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    shape = len(a), len(b)
    origins = np.repeat(a, len(b), axis=0)
    directions = np.tile(b, (len(a), 1)) - origins
    moves = directions.any(axis=1)
    directions[~moves] = 1.0
    ends = np.zeros(len(origins)), np.ones(len(origins))
    verdict = judge(*mesh, origins, directions, *ends)
    hidden = verdict.sure.any(axis=1) & moves
    seen = ~(verdict.sure | verdict.doubt).any(axis=1) | ~moves
    return seen.reshape(shape), hidden.reshape(shape)


def check(seen, sure):
    assert not (sure[0] & ~seen).any()
    assert not (sure[1] & seen).any()


@pytest.fixture
def points(rng):
    return rng.random((70, 3)), rng.random((90, 3))


@pytest.fixture(scope="module")
def soup_tracer():
    return tracer_of(soup(60))


@pytest.mark.parametrize("name", EVERY_QUERY)
def test_every_structure_sees_the_same(name, points, soup_tracer):
    a, b = points
    seen = rs.visibility(tracer_of(soup(60), **TRACERS[name]), a, b)
    assert seen.dtype == np.bool_
    assert seen.shape == (70, 90)
    blocked = soup_tracer.any_hit(a[:, None], b - a[:, None], t_max=1.0)
    np.testing.assert_array_equal(seen, ~blocked)
    assert 0.05 < seen.mean() < 0.95


def test_free_points_agree_with_float64(points):
    a, b = points
    mesh = soup(60)
    sure = surely(mesh, a, b)
    check(rs.visibility(tracer_of(mesh), a, b), sure)
    assert (sure[0] | sure[1]).mean() > 0.99


@pytest.mark.exhaustive
def test_a_million_pairs_agree_with_float64(rng):
    mesh = soup(40, seed=3)
    tracer = tracer_of(mesh)
    a, b = rng.random((2, 1000, 3))
    seen, doubts = rs.visibility(tracer, a, b), 0
    for first in range(0, 1000, 8):
        rows = slice(first, first + 8)
        sure = surely(mesh, a[rows], b)
        check(seen[rows], sure)
        doubts += int((~(sure[0] | sure[1])).sum())
    assert doubts < 3000


@pytest.mark.exhaustive
def test_a_million_pairs_on_convex_solids(rng):
    for mesh in (icosphere(3), cube()):
        tracer = tracer_of(mesh)
        assert rs.visibility(tracer, *(random_points(tracer, 1000, rng) for _ in range(2))).all()


@settings(max_examples=40)
@given(st.data())
def test_lattices_agree_with_float64(data):
    (vertices, faces), scale, offset = data.draw(meshes())
    rows = st.lists(st.tuples(*[COORDINATES] * 3), min_size=1, max_size=5)
    a, b = (np.array(data.draw(rows)) * scale + offset for _ in range(2))
    tracer = tracer_of((vertices, faces))
    seen = rs.visibility(tracer, a, b)
    if len(faces):
        check(seen, surely((vertices, faces), a, b))
    else:
        assert seen.all()
    own = rs.visibility(tracer, a)
    np.testing.assert_array_equal(own, own.T)
    assert own.diagonal().all()


def test_forms_are_the_same_matrix(soup_tracer, points, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", 600)
    a, b = points
    for other in (b, b[:1], b[:13], None):
        dense = rs.visibility(soup_tracer, a, other)
        count = len(a) if other is None else len(other)
        bits = rs.visibility(soup_tracer, a, other, form="bits")
        assert bits.dtype == np.uint8
        assert bits.shape == (70, -(-count // 8))
        np.testing.assert_array_equal(np.unpackbits(bits, axis=1, count=count), dense)
        sparse = rs.visibility(soup_tracer, a, other, form="sparse")
        assert sparse.shape == (70, count)
        np.testing.assert_array_equal(sparse.dense(), dense)
        for i in range(70):
            row = sparse.indices[sparse.indptr[i] : sparse.indptr[i + 1]]
            assert row.tolist() == np.flatnonzero(dense[i]).tolist()
        monkeypatch.setattr(visibility, "MOST_TILE", 1 << 18)
        np.testing.assert_array_equal(rs.visibility(soup_tracer, a, other), dense)
        monkeypatch.setattr(visibility, "MOST_TILE", 600)


def test_equal_points_are_traced_half(soup_tracer, rng, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", 600)
    points, steps = rng.random((120, 3)), []
    seen = rs.visibility(
        soup_tracer, points, progress=lambda done, total: steps.append((done, total))
    )
    np.testing.assert_array_equal(seen, seen.T)
    assert seen.diagonal().all()
    check(seen, surely(soup(60), points, points))
    done, totals = zip(*steps, strict=True)
    assert list(done) == sorted(done)
    assert set(totals) == {done[-1]}
    assert done[-1] <= 0.6 * 120**2
    monkeypatch.undo()
    np.testing.assert_array_equal(rs.visibility(soup_tracer, points), seen)


@pytest.mark.parametrize("shape", [(1, 1), (7, 1), (1, 9), (100, 30), (64, 64), (65, 63), (0, 4)])
@pytest.mark.parametrize("is_half", [False, True])
def test_tiles_cover_all_pairs_once(shape, is_half):
    if is_half:
        shape = (shape[0], shape[0])
    tiles = Tiles.of(shape, is_half, 200)
    count, done = np.zeros(shape, int), 0
    for tile in tiles:
        assert tile.begin == done
        assert tile.columns.start % 8 == 0
        assert tile.ray_count <= 200
        done += tile.ray_count
        count[tile.rows, tile.columns] += 1
        if is_half and tile.rows != tile.columns:
            count[tile.columns, tile.rows] += 1
    assert (count == 1).all()
    assert done == tiles.ray_count


# Points on surfaces.


def random_points(tracer, count, rng):
    """Points on triangles by area, some on edges and at vertices."""
    corners = tracer.structure.triangles.corners.astype(float)
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    prim_ids = rng.choice(len(corners), count, p=area / area.sum())
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    return rs.surface_points(tracer, prim_ids, u, v)


CONVEX = {"sphere": icosphere(2), "cube": cube(), "coarse": icosphere(0)}


@pytest.mark.parametrize("solid", CONVEX)
@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e4, 3.0), (1.0, 1e6), (7.0, 90.0)]
)
def test_points_on_a_convex_solid_see_each_other_through_it(solid, scale, offset, rng):
    vertices, faces = CONVEX[solid]
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    tracer = tracer_of((vertices @ rotation.T * scale + offset, faces))
    points = random_points(tracer, 400, rng)
    assert rs.visibility(tracer, points).all()
    assert rs.visibility(tracer, points, points).all()
    # Outside of it they see nothing.
    outward = rs.visibility(tracer, points, front_only=True)
    assert not outward.any()
    middle = (vertices @ rotation.T * scale + offset).mean(axis=0)
    assert rs.visibility(tracer, [middle], points).all()
    assert rs.visibility(tracer, points, [middle]).all()
    assert not rs.visibility(tracer, points, [middle], front_only=True).any()


def test_a_far_point_sees_the_near_half_of_a_sphere(rng):
    """With no doubt but at the silhouette, from 2 to 10**6 radii away."""
    tracer = tracer_of(icosphere(3))
    points = random_points(tracer, 3000, rng)
    for distance in (2.0, 10.0, 1e3, 1e6):
        eye = np.array([0.6, 0.0, 0.8]) * distance
        toward = eye - points.positions
        height = np.einsum("nk,nk->n", points.normals.astype(float), toward)
        height /= np.linalg.norm(toward, axis=1)
        for front_only in (False, True):
            for pair in ((points, [eye]), ([eye], points)):
                seen = rs.visibility(tracer, *pair, front_only=front_only).ravel()
                assert seen[height > 1e-4].all()
                # A convex solid hides from outside all that faces away.
                assert not seen[height < -1e-4].any()


@pytest.mark.ci
@pytest.mark.parametrize("distance", [5.0, 1e3, 1e6, 1e12])
def test_a_shell_just_above_hides_a_sphere_from_afar(distance, rng):
    """However long a segment, its end stays below the shell, at 0.001 of the radius."""
    vertices, faces = icosphere(3)
    meshes = [rs.Mesh(vertices * radius, faces) for radius in (1.0, 1.001)]
    tracer = rs.Tracer(rs.Scene(meshes))
    inner = random_points(tracer, 2000, rng)
    inner = rs.surface_points(tracer, inner.prim_id % len(faces), inner.u, inner.v)
    outer = rs.surface_points(tracer, inner.prim_id + len(faces), inner.u, inner.v)
    eye = [[0.6 * distance, 0.0, 0.8 * distance]]
    for pair in ((inner, eye), (eye, inner)):
        assert not rs.visibility(tracer, *pair).any()
    assert rs.visibility(tracer, inner, outer).diagonal().all()
    toward = np.einsum("nk,nk->n", outer.normals.astype(float), eye - outer.positions)
    toward /= np.linalg.norm(eye - outer.positions, axis=1)
    seen = rs.visibility(tracer, eye, outer).ravel()
    assert seen[toward > 1e-3].all()
    assert not seen[toward < -1e-3].any()


def test_equal_points_of_two_sheets_see_each_other():
    """Even on opposite fronts, with both sheets between them."""
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2], [0, 2, 1]]))
    points = rs.surface_points(tracer, [0, 1])
    assert rs.visibility(tracer, points).all()


def test_surface_points_agree_with_float64(rng):
    """A solid that is not convex: moved ends in float64, with offsets that are not ours."""
    mesh = dented_sphere(2)
    tracer = tracer_of(mesh)
    points = random_points(tracer, 60, rng)
    normals = points.normals.astype(float)
    delta = points.positions[None] - points.positions[:, None]
    side = np.sign(np.einsum("nk,nmk->nm", normals, delta))
    moved = points.positions[:, None] + 3e-4 * side[..., None] * normals[:, None]
    starts, stops = moved.reshape(-1, 3), moved.transpose(1, 0, 2).reshape(-1, 3)
    apart = (points.prim_id != points.prim_id[:, None]).ravel()
    count = np.count_nonzero(apart)
    ends = np.zeros(count), np.ones(count)
    verdict = judge(*mesh, starts[apart], (stops - starts)[apart], *ends)
    hidden = verdict.sure.any(axis=1)
    seen = ~(verdict.sure | verdict.doubt).any(axis=1)
    found = rs.visibility(tracer, points).ravel()[apart]
    # Moved points can be on the wrong side of a neighbour; those are rare.
    assert (hidden & found).mean() < 2e-3
    assert (seen & ~found).mean() < 2e-3
    assert (hidden | seen).mean() > 0.95
    assert 0.2 < found.mean() < 0.9


def test_points_of_one_plane_see_each_other_along_its_front():
    """Two triangles of a wall, and points that are on the edge between them."""
    wall = rs.Scene.from_arrays(
        [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]]
    )
    tracer = rs.Tracer(wall)
    points = rs.surface_points(tracer, [0, 0, 1, 1], [0.2, 0.5, 0.3, 0.5], [0.2, 0.5, 0.3, 0.0])
    assert rs.visibility(tracer, points).all()
    assert not rs.visibility(tracer, points, front_only=True).any()
    eyes = [[1.0, 2.0, 3.0], [1.0, 2.0, -3.0]]
    assert rs.visibility(tracer, eyes, points).all()
    front = rs.visibility(tracer, eyes, points, front_only=True)
    assert front.tolist() == [[True] * 4, [False] * 4]
    # A free point there touches the wall.
    assert not rs.visibility(tracer, eyes, [[1.0, 2.0, 0.0]]).any()


def test_vertices_skip_their_triangles():
    """A vertex of a cube sees all others through the inside, and past it along edges."""
    vertices, faces = cube()
    tracer = tracer_of((vertices, faces))
    around = [np.flatnonzero((faces == i).any(axis=1)) for i in range(8)]
    width = max(map(len, around))
    ids = np.array([np.pad(one, (0, width - len(one)), constant_values=-1) for one in around])
    assert not rs.visibility(tracer, vertices)[~np.eye(8, dtype=bool)].any()
    assert rs.visibility(tracer, vertices, skip_a=ids).all()
    assert rs.visibility(tracer, vertices, vertices, skip_a=ids, skip_b=ids).all()
    one_side = rs.visibility(tracer, vertices, [[0.5, 0.5, 0.5], [2, 2, 2]], skip_a=ids)
    assert one_side[:, 0].all()
    assert one_side[:, 1].tolist() == [False] + [True] * 7


@pytest.mark.parametrize("form", ["dense", "bits", "sparse"])
def test_invalid_points_see_nothing(form, soup_tracer):
    points = np.array([[9.0, 9, 9], [np.nan, 0, 0], [np.inf, 0, 0], [2.0**201, 0, 0], [9, 9, 8]])
    seen = rs.visibility(soup_tracer, points, form=form)
    if form == "bits":
        seen = np.unpackbits(seen, axis=1, count=5).astype(bool)
    seen = seen if form != "sparse" else seen.dense()
    good = np.array([True, False, False, False, True])
    np.testing.assert_array_equal(seen, good & good[:, None])
    hits = soup_tracer.first_hit([[9.0, 9, 9], [0.5, 0.5, 9]], [0, 0, -1.0])
    assert hits.is_hit.tolist() == [False, True]
    assert rs.visibility(soup_tracer, hits, [[0.5, 0.5, 9.0]]).ravel().tolist() == [False, True]


def test_a_degenerate_triangle_has_no_points():
    scene = rs.Scene.from_arrays(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 3]]
    )
    tracer = rs.Tracer(scene)
    points = rs.surface_points(tracer, [0, 1])
    assert rs.visibility(tracer, points).tolist() == [[False, False], [False, True]]


def test_empty_scenes_and_sets():
    nothing = rs.Tracer(rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int)))
    assert rs.visibility(nothing, [[0, 0, 0], [1, 2, 3]]).all()
    assert rs.visibility(nothing, []).shape == (0, 0)
    assert rs.visibility(nothing, [], [[1, 2, 3]], form="bits").shape == (0, 1)
    empty = rs.visibility(nothing, [[1, 2, 3]], [], form="sparse")
    assert empty.indptr.tolist() == [0, 0]
    assert empty.shape == (1, 0)
    assert rs.visibility(nothing, [[0, 0, 1e-320]], [[0, 0, 0]]).all()


def test_instances(rng):
    """Free points see what they see in the flattened scene."""
    transforms = random_transforms(rng, 6, spread=2.0)
    scene = rs.Scene.instances([rs.Scene.from_arrays(*icosphere(1))], transforms)
    tracer, flat = rs.Tracer(scene), rs.Tracer(scene.flattened())
    points = rng.uniform(-4, 4, (150, 3))
    seen, expected = (rs.visibility(one, points, form="bits") for one in (tracer, flat))
    assert np.unpackbits(seen ^ expected).mean() < 2e-4  # rounding at silhouettes


# Memory and files.


@pytest.mark.parametrize("form", ["dense", "bits", "sparse"])
def test_memory_is_bounded(form, soup_tracer, rng):
    points = rng.random((3000, 3))
    rs.visibility(soup_tracer, points[:600], form=form)  # compile
    limit = 60_000_000 if form != "sparse" else 220_000_000
    tracemalloc.start()
    try:
        rs.visibility(soup_tracer, points, form=form, max_memory=limit)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < limit


def test_too_little_memory_is_refused_with_numbers(soup_tracer, rng, monkeypatch):
    points = rng.random((5000, 3))
    monkeypatch.setattr(rs.Tracer, "any_hit", lambda *_, **__: pytest.fail("traced"))
    with pytest.raises(MemoryError, match=r"5,000 x 5,000 points take 0\.025 GB.*allows 0\.010 GB"):
        rs.visibility(soup_tracer, points, max_memory=10_000_000)
    with pytest.raises(MemoryError, match=r"form='bits' \(0\.003 GB\)"):
        rs.visibility(soup_tracer, points, max_memory=10_000_000)
    with pytest.raises(MemoryError, match="are free"):
        rs.visibility(soup_tracer, np.zeros((2_000_000, 3)), form="bits")


def test_sparse_results_stop_at_the_limit(soup_tracer, rng, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", 4096)
    points = rng.random((1000, 3)) + 10.0  # all see each other
    with pytest.raises(MemoryError, match=r"pairs after \d.*% of the rays"):
        rs.visibility(soup_tracer, points, form="sparse", max_memory=60_000_000)


@pytest.mark.parametrize("form", ["dense", "bits"])
@pytest.mark.parametrize("is_half", [False, True])
def test_interrupted_results_resume(form, is_half, soup_tracer, points, tmp_path, monkeypatch):
    monkeypatch.setattr(visibility, "MOST_TILE", 600)
    monkeypatch.setattr(resumable_array, "_INTERVAL", 0.0)
    a, b = points
    pair = (a,) if is_half else (a, b)
    expected = rs.visibility(soup_tracer, *pair, form=form)
    path = tmp_path / "seen.npy"
    traced = []

    def stop_after(limit):
        def progress(done, total):
            traced.append(done)
            if done >= limit * total:
                raise KeyboardInterrupt

        return progress

    for limit in (0.0, 0.3, 0.6):
        with pytest.raises(KeyboardInterrupt):
            rs.visibility(soup_tracer, *pair, form=form, out=path, progress=stop_after(limit))
    found = rs.visibility(
        soup_tracer, *pair, form=form, out=path, progress=lambda done, _: traced.append(done)
    )
    # Only the tile in which each run was interrupted could be traced twice, and was not.
    assert traced == sorted(set(traced))
    assert isinstance(found, np.memmap)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.load(path), expected)
    monkeypatch.setattr(rs.Tracer, "any_hit", lambda *_, **__: pytest.fail("traced again"))
    again = rs.visibility(soup_tracer, *pair, form=form, out=path)
    np.testing.assert_array_equal(again, expected)


def test_files_are_not_mixed(soup_tracer, points, tmp_path):
    a, b = points
    path = tmp_path / "seen.npy"
    rs.visibility(soup_tracer, a, b, out=path)
    before = path.read_bytes()
    other = tracer_of(soup(60, seed=1))
    for tracer, pair, options, named in (
        (soup_tracer, (b, a), {}, "block, shape, the points"),
        (soup_tracer, (a + 1e-9, b), {}, "the points"),
        (other, (a, b), {}, "the scene"),
        (soup_tracer, (a, b), {"form": "bits"}, "form"),
    ):
        with pytest.raises(FileFormatError, match=rf"another query \(different: {named}\)"):
            rs.visibility(tracer, *pair, out=path, **options)
    assert path.read_bytes() == before
    foreign = tmp_path / "mine.npy"
    np.save(foreign, a)
    with pytest.raises(FileFormatError, match="exists, but not its journal"):
        rs.visibility(soup_tracer, a, b, out=foreign)
    np.testing.assert_array_equal(np.load(foreign), a)
    path.write_bytes(before[:200])
    with pytest.raises(FileFormatError, match="is damaged"):
        rs.visibility(soup_tracer, a, b, out=path)
    path.unlink()  # the journal alone has nothing to lose
    rs.visibility(soup_tracer, a, b, out=path)
    assert path.read_bytes() == before
    assert rs.visibility(soup_tracer, [], b, out=tmp_path / "none.npy").shape == (0, 90)


def test_a_file_has_one_writer(soup_tracer, points, tmp_path):
    path = tmp_path / "seen.npy"

    def write_again(*_):
        rs.visibility(soup_tracer, *points, out=path)

    with pytest.raises(FileFormatError, match="another process"):
        rs.visibility(soup_tracer, *points, out=path, progress=write_again)


# Bad input.


@pytest.mark.parametrize(
    ("arguments", "options", "error", "named"),
    [
        (([1, 2, 3],), {}, ValueError, r"a: expected shape \(N, 3\)"),
        (([[1, 2]],), {}, ValueError, "a: expected shape"),
        (([["x", "y", "z"]],), {}, TypeError, "a: expected real numbers"),
        (([[1, 2, 3]], [[1j, 2, 3]]), {}, TypeError, "b: expected real numbers"),
        (([[1, 2, 3]],), {"form": "csr"}, ValueError, "form: expected"),
        (([[1, 2, 3]],), {"skip_b": [0]}, ValueError, "skip_b: expected None"),
        (([[1, 2, 3]],), {"skip_a": [0, 1]}, ValueError, r"skip_a: expected shape \(1,\)"),
        (([[1, 2, 3]],), {"skip_a": [0.5]}, TypeError, "skip_a: expected integers"),
        (([[1, 2, 3]],), {"skip_a": [60]}, ValueError, "skip_a: expected triangles, 0 to 59"),
        (([[1, 2, 3]],), {"max_memory": -1}, ValueError, "max_memory: expected"),
        (([[1, 2, 3]],), {"max_memory": 1e9}, TypeError, "integer"),
        (([[1, 2, 3]],), {"out": "seen.txt"}, ValueError, "out: expected a name"),
        (([[1, 2, 3]],), {"out": "a.npy", "form": "sparse"}, ValueError, "ends in .zarr for"),
    ],
)
def test_bad_input_is_named(soup_tracer, arguments, options, error, named):
    with pytest.raises(error, match=named):
        rs.visibility(soup_tracer, *arguments, **options)


def test_a_scene_is_not_a_tracer():
    scene = rs.load("cornell")
    for run in (
        lambda: rs.visibility(scene, [[1, 2, 3]]),
        lambda: rs.surface_points(scene, [0]),
        lambda: rs.visible_faces(scene),
    ):
        with pytest.raises(TypeError, match="tracer: expected a Tracer, got Scene"):
            run()


def test_hits_of_another_scene_are_refused(soup_tracer):
    far = tracer_of((icosphere(0)[0] + 1e6, icosphere(0)[1]))
    with pytest.raises(ValueError, match="a: the hits are of another scene"):
        rs.visibility(soup_tracer, rs.surface_points(far, [0]))


@pytest.mark.parametrize(
    ("arguments", "error", "named"),
    [
        (([60],), ValueError, "prim_ids: 60 is not a triangle"),
        (([-2],), ValueError, "prim_ids: -2"),
        (([0.5],), TypeError, "prim_ids: expected integers"),
        (([0], 0.8, 0.8), ValueError, "u, v: expected weights"),
        (([0], np.nan), ValueError, "u, v: expected weights"),
        (([0], [0.1, 0.2]), ValueError, "u: shape"),
    ],
)
def test_bad_surface_points_are_named(soup_tracer, arguments, error, named):
    with pytest.raises(error, match=named):
        rs.surface_points(soup_tracer, *arguments)


def test_surface_points_are_on_their_triangles(soup_tracer):
    corners = soup_tracer.structure.triangles.corners.astype(float)
    points = rs.surface_points(soup_tracer, np.arange(60))
    np.testing.assert_allclose(points.positions, corners.mean(axis=1), atol=1e-6)
    some = rs.surface_points(soup_tracer, [[3, -1], [5, 3]], [[1.0, 9.0], [0.0, 0.0]], 0.0)
    assert some.is_hit.tolist() == [[True, False], [True, True]]
    np.testing.assert_array_equal(some.positions[0, 0], corners[3, 1])
    assert np.isnan(some.positions[0, 1]).all()
    assert rs.surface_points(soup_tracer, []).prim_id.shape == (0,)
    for k, weights in enumerate([(0, 0), (1, 0), (0, 1)]):
        vertex = rs.surface_points(soup_tracer, [7], *weights)
        np.testing.assert_array_equal(vertex.positions[0], corners[7, k])
