import numpy as np
import pytest

import raystream as rs
from meshes import dented_sphere, grid_floor


@pytest.fixture(scope="module")
def two_meshes():
    vertices, faces = dented_sphere(2)
    floor = grid_floor(4)
    return rs.Scene(
        [rs.Mesh(vertices, faces), rs.Mesh(np.array(floor[0]) * 9 - [0, 5, 0], floor[1])]
    )


@pytest.fixture(scope="module")
def hits(two_meshes):
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(30, 20, 3)) * 4
    directions = rng.normal(size=(30, 20, 3))
    hits = rs.Tracer(two_meshes).first_hit(origins, directions)
    hits.rays = origins, directions
    return hits


def test_positions_lie_on_rays_and_planes(two_meshes, hits):
    origins, directions = hits.rays
    found = hits.is_hit
    assert 100 < found.sum() < 500
    expected = origins + hits.t[..., None].astype(float) * directions
    np.testing.assert_allclose(hits.positions[found], expected[found], atol=2e-5)
    assert np.isnan(hits.positions[~found]).all()
    corners = two_meshes.triangles.corners[hits.prim_id[found]].astype(float)
    off = np.einsum("nk,nk->n", hits.positions[found] - corners[:, 0], hits.normals[found])
    np.testing.assert_allclose(off, 0, atol=1e-6)


def test_normals_are_unit_and_follow_the_winding(two_meshes, hits):
    found = hits.is_hit
    corners = two_meshes.triangles.corners[hits.prim_id[found]].astype(float)
    expected = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(hits.normals[found], expected, atol=1e-6)
    assert hits.normals.dtype == np.float32
    assert np.isnan(hits.normals[~found]).all()


def test_meshes_follow_from_triangles(two_meshes, hits):
    first = two_meshes.meshes[0].triangle_count
    found = hits.is_hit
    np.testing.assert_array_equal(hits.mesh_id[found], hits.prim_id[found] >= first)
    np.testing.assert_array_equal(
        hits.mesh_prim_id[found], hits.prim_id[found] - first * hits.mesh_id[found]
    )
    assert (hits.mesh_id[~found] == -1).all()
    assert (hits.mesh_prim_id[~found] == -1).all()
    assert hits.mesh_id.dtype == hits.mesh_prim_id.dtype == np.int32
    assert set(np.unique(hits.mesh_id)) == {-1, 0, 1}


def test_the_first_and_the_last_triangle_of_each_mesh_are_its_own():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) + 2.0 * np.arange(6)[:, None, None]
    meshes = [
        rs.Mesh(corners[own].reshape(-1, 3), np.arange(3 * len(corners[own])).reshape(-1, 3))
        for own in (slice(0, 1), slice(1, 1), slice(1, 4), slice(4, 6))
    ]
    hits = rs.Tracer(rs.Scene(meshes)).first_hit(corners[:, 0] + [0.25, 0.25, 1], [0, 0, -1])
    assert hits.prim_id.tolist() == [0, 1, 2, 3, 4, 5]
    assert hits.mesh_id.tolist() == [0, 2, 2, 2, 3, 3]
    assert hits.mesh_prim_id.tolist() == [0, 0, 1, 2, 0, 1]


def test_normals_of_tiny_triangles():
    scale = 1e-28
    scene = rs.Scene.from_arrays(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]) * scale, [[0, 1, 2]])
    hits = rs.Tracer(scene).first_hit([scale / 4, scale / 4, 1.0], [0, 0, -1])
    np.testing.assert_array_equal(hits.normals, [0, 0, 1])


def test_picking_rays(hits):
    row = hits[3]
    assert row.t.shape == (20,)
    np.testing.assert_array_equal(row.positions, hits.positions[3])
    chosen = hits[hits.is_hit]
    np.testing.assert_array_equal(chosen.normals, hits.normals[hits.is_hit])
    assert hits[3, 4].t.shape == ()


def test_multi_hits_rows(two_meshes):
    rng = np.random.default_rng(1)
    origins, directions = rng.normal(size=(5, 40, 3)) * 4, rng.normal(size=(5, 40, 3))
    many = rs.Tracer(two_meshes).multi_hit(origins, directions)
    assert many.counts.shape == (5, 40)
    assert many.counts.sum() == len(many.t) == many.ray_splits[-1]
    np.testing.assert_array_equal(np.bincount(many.ray_id, minlength=200), many.counts.ravel())
    o, d = origins.reshape(-1, 3)[many.ray_id], directions.reshape(-1, 3)[many.ray_id]
    np.testing.assert_allclose(many.positions, o + many.t[:, None].astype(float) * d, atol=3e-5)


@pytest.mark.parametrize("offset", [0.0, 1e5, 1e9])
@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e4])
def test_spawned_rays_leave_their_triangle(offset, scale):
    """Also when they graze it, and far from the origin."""
    rng = np.random.default_rng(5)
    vertices, faces = dented_sphere(3)
    scene = rs.Scene.from_arrays((vertices + offset / 1e4) * scale, faces)
    tracer = rs.Tracer(scene)
    count = 40_000
    targets = (vertices[rng.integers(0, len(vertices), count)] + offset / 1e4) * scale
    origins = targets + rng.normal(size=(count, 3)) * scale
    hits = tracer.first_hit(origins, targets - origins)
    tilt = 10.0 ** -rng.uniform(0, 9, count)
    along = np.cross(np.nan_to_num(hits.normals), rng.normal(size=(count, 3)))
    grazing = along + hits.normals * (tilt * rng.choice([-1, 1], count))[:, None]
    for directions in (rng.normal(size=(count, 3)), grazing):
        directions[~hits.is_hit] = 1.0
        again = tracer.multi_hit(*hits.spawn(directions))
        assert not (again.prim_id == hits.prim_id[again.ray_id]).any()
        assert len(again.t) > count / 10


def test_spawned_origins_stay_close(hits):
    origins, directions = hits.spawn([0.0, 1.0, 0.0])
    assert directions.shape == origins.shape == (30, 20, 3)
    found = hits.is_hit
    moved = np.linalg.norm(origins - hits.positions, axis=-1)[found]
    assert (moved > 0).all()
    assert moved.max() < 2e-5
    assert np.isnan(origins[~found]).all()
    with pytest.raises(ValueError, match="directions: shape"):
        hits.spawn(np.ones((7, 3)))


@pytest.mark.parametrize("aspect", [1e2, 1e4, 1e6])
def test_thin_triangles_are_hit_where_they_are(aspect):
    """Float32 differences of products keep their sign there, and lose their size."""
    rng = np.random.default_rng(0)
    count = 300
    frame, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    shape = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1 / aspect, 0]])
    corners = rng.normal(size=(count, 1, 3)) + np.einsum("kx,nxy->nky", shape, frame)
    corners = corners.astype(np.float32).astype(float)
    scene = rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    tracer = rs.Tracer(scene)
    chosen = rng.integers(0, count, 20_000)
    weights = rng.dirichlet([2, 2, 2], len(chosen))
    targets = np.einsum("nk,nkx->nx", weights, corners[chosen])
    away = rng.normal(size=(len(chosen), 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    hits = tracer.first_hit(targets + away, -away, t_min=0.9, t_max=1.1)
    own = hits.prim_id == chosen
    assert own.sum() > 1000
    # The plane's distance, exactly: what float32 adds is the rounding of one image.
    normals = np.cross(
        corners[chosen, 1] - corners[chosen, 0], corners[chosen, 2] - corners[chosen, 0]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    steep = np.abs(np.einsum("nk,nk->n", normals, away)) > 0.3
    np.testing.assert_allclose(hits.t[own & steep], 1, atol=5e-6)
    again = tracer.multi_hit(*hits.spawn(rng.normal(size=(len(chosen), 3))))
    assert not (again.prim_id == hits.prim_id[again.ray_id]).any()
