import numpy as np
import pytest

import raystream as rs
from meshes import dented_sphere, grid_floor, icosphere

SIZE = 128, 96


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


@pytest.fixture(scope="module")
def dressed():
    """A smooth ball, a ball that is textured and whose normals point inside, and a bare floor."""
    vertices, faces = icosphere(2)
    halves = np.arange(len(faces)) % 2
    materials = [rs.Material(name=name) for name in ("plain", "red", "blue")]
    ball = rs.Mesh(vertices - [2, 0, 0], faces, normals=3 * vertices, material_ids=1 + halves)
    other = rs.Mesh(
        vertices + [2, 0, 0], faces, normals=-vertices, texcoords=vertices[:, :2], material_ids=2
    )
    floor = grid_floor(4)
    floor = rs.Mesh(np.array(floor[0]) * 9 - [0, 5, 0], floor[1])
    return rs.Scene([ball, other, floor], materials=materials)


def rays_at(scene, count=400):
    rng = np.random.default_rng(1)
    targets = rng.uniform(-3, 3, (count, 3))
    origins = targets + [0, 20, 0]
    return origins, targets * [1, 0.3, 1] - origins


def test_materials_are_those_of_the_meshes(dressed):
    hits = rs.Tracer(dressed).first_hit(*rays_at(dressed))
    for prim, mesh, within, material in zip(
        hits.prim_id, hits.mesh_id, hits.mesh_prim_id, hits.material_id, strict=True
    ):
        expected = dressed.meshes[mesh].material_ids[within] if prim >= 0 else -1
        assert material == expected
    assert set(hits.material_id) == {0, 1, 2}
    assert hits.material_id.dtype == np.int32


def test_texcoords_lie_between_those_of_vertices(dressed):
    hits = rs.Tracer(dressed).first_hit(*rays_at(dressed))
    textured = hits.mesh_id == 1
    assert 20 < textured.sum() < 380
    # They are the vertices' x and y, and so are the positions'.
    expected = hits.positions[textured, :2] - [2, 0]
    np.testing.assert_allclose(hits.texcoords[textured], expected, atol=1e-6)
    assert np.isnan(hits.texcoords[~textured]).all()
    assert hits.texcoords.dtype == np.float32


def test_shading_normals_are_smooth_and_on_the_side_of_the_triangles(dressed):
    hits = rs.Tracer(dressed).first_hit(*rays_at(dressed))
    on_balls = (hits.mesh_id == 0) | (hits.mesh_id == 1)
    center = np.where(hits.mesh_id[on_balls, None] == 0, [-2.0, 0, 0], [2.0, 0, 0])
    outward = hits.positions[on_balls] - center
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    seen = hits.shading_normals
    np.testing.assert_allclose(seen[on_balls], outward, atol=0.02)
    assert np.abs(hits.normals[on_balls] - outward).max() > 0.05  # those are flat
    floor = hits.mesh_id == 2
    assert floor.any()
    np.testing.assert_array_equal(seen[floor], hits.normals[floor])
    assert np.isnan(seen[~hits.is_hit]).all()
    assert seen.dtype == np.float32


def test_normals_that_cancel_give_way_to_the_triangles():
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for normals in (np.zeros((3, 3)), [[0, 0, 0], [1, 0, 0], [-1, 0, 0]], np.full((3, 3), np.nan)):
        scene = rs.Scene.from_arrays(triangle, [[0, 1, 2]], normals=normals)
        hit = rs.Tracer(scene).first_hit([0.25, 0.25, 1], [0, 0, -1])
        hit.u[...] = hit.v[...] = 0.5
        assert hit.shading_normals.tolist() == [0, 0, 1]


def test_shading_normals_are_those_of_pictures(dressed):
    """Bit for bit except for the side: images turn them to the eye."""
    camera = rs.Camera((0, 3, 12), (0, 0, 0))
    tracer = rs.Tracer(dressed)
    layer = rs.render(tracer, "vis", SIZE, camera=camera, layers=["normal"]).layers["normal"]
    hits = tracer.first_hit(*camera.rays(*SIZE))
    smooth = hits.mesh_id < 2
    seen = hits.shading_normals
    # Where one points away from the eye, images take the triangle's.
    faces_eye = np.einsum("hwk,hwk->hw", seen, camera.rays(*SIZE)[1]) < 0
    compared = hits.is_hit & smooth & faces_eye
    assert compared.sum() > 300
    np.testing.assert_array_equal(layer[compared], seen[compared])


def test_attributes_of_many_hits_and_of_picked_ones(dressed):
    tracer = rs.Tracer(dressed)
    rays = rays_at(dressed)
    many, first = tracer.multi_hit(*rays), tracer.first_hit(*rays)
    rows = many.ray_splits[:-1][first.is_hit]
    for name in ("material_id", "texcoords", "shading_normals"):
        expected = getattr(first, name)[first.is_hit]
        np.testing.assert_array_equal(getattr(many, name)[rows], expected)
        np.testing.assert_array_equal(getattr(first[3], name), getattr(first, name)[3])
        assert getattr(first[:0], name).shape[0] == 0


def test_hits_know_attributes_wherever_the_structure_comes_from(dressed, tmp_path):
    rays = rays_at(dressed)
    expected = rs.Tracer(dressed).first_hit(*rays)
    tracer = rs.Tracer(dressed)
    tracer.save(tmp_path / "built.npz")
    loaded = rs.Tracer.load(tmp_path / "built.npz", dressed).first_hit(*rays)
    tracer.update(dressed.replace(background=(1, 0, 0)))
    for hits in (loaded, tracer.first_hit(*rays)):
        np.testing.assert_array_equal(hits.material_id, expected.material_id)
        np.testing.assert_array_equal(hits.texcoords, expected.texcoords)
    bare = rs.Tracer.load(tmp_path / "built.npz")
    for hits in (bare.first_hit(*rays), rs.Tracer(bare.scene).first_hit(*rays)):
        np.testing.assert_array_equal(hits.material_id, np.where(hits.is_hit, 0, -1))
        assert np.isnan(hits.texcoords).all()
        np.testing.assert_array_equal(hits.shading_normals, hits.normals)


def test_hits_of_before_an_update_keep_their_attributes(dressed):
    tracer = rs.Tracer(dressed)
    before = tracer.first_hit(*rays_at(dressed))
    turned = [
        mesh.moved(mesh.vertices, -np.ones((len(mesh.vertices), 3))) for mesh in dressed.meshes
    ]
    tracer.update(dressed.replace(meshes=turned))
    after = tracer.first_hit(*rays_at(dressed))
    smooth = before.mesh_id == 0
    assert (np.ptp(np.abs(after.shading_normals[smooth]), axis=1) < 1e-6).all()
    assert (np.ptp(np.abs(before.shading_normals[smooth]), axis=1) > 1e-6).any()


def test_an_empty_scene_has_no_attributes():
    hits = rs.Tracer(rs.Scene()).first_hit([[0, 0, 0]], [0, 0, 1])
    assert hits.material_id.tolist() == [-1]
    assert np.isnan(hits.texcoords).all()
    assert np.isnan(hits.shading_normals).all()
