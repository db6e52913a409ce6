"""trimesh's interface: its methods and shapes, the right hits, and a mesh that changes."""

from __future__ import annotations

import copy
import inspect
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings

from meshes import dented_sphere, icosphere, lattice_soup, soup
from oracles import check_counts, check_first, judge
from raystream.adapters.trimesh import _INSIDE, RayMeshIntersector
from strategies import scenes_and_rays


def mesh_of(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def rays_of(count, seed=0, size=3.0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-size, size, (count, 3)), rng.normal(size=(count, 3))


@pytest.fixture(scope="module")
def sphere():
    return mesh_of(*icosphere(3))


@pytest.fixture(scope="module")
def ray(sphere):
    return RayMeshIntersector(sphere)


# Right answers, by an oracle in float64.


@pytest.mark.parametrize("shape", [soup(60), dented_sphere(2), lattice_soup(40)])
def test_all_methods_agree_with_the_oracle(shape):
    vertices, faces = shape
    count = 1500
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    origins, targets = np.random.default_rng(4).uniform(low, high, (2, count, 3))
    directions = targets - (low + high) / 2 + (targets - origins)
    verdict = judge(vertices, faces, origins, directions, np.zeros(count), np.full(count, np.inf))
    ours = RayMeshIntersector(mesh_of(vertices, faces))

    first = ours.intersects_first(origins, directions)
    tri, ray, points = ours.intersects_id(
        origins, directions, multiple_hits=False, return_locations=True
    )
    assert len(ray) > 100
    t = np.full(count, np.inf)
    along = np.einsum("ij,ij->i", points - origins[ray], directions[ray])
    t[ray] = along / np.einsum("ij,ij->i", directions[ray], directions[ray])
    check_first(verdict, t, first)
    assert (first[ray] == tri).all()
    assert (np.flatnonzero(first >= 0) == ray).all()
    assert (ours.intersects_any(origins, directions) == (first >= 0)).all()

    tri, ray = ours.intersects_id(origins, directions)
    check_counts(verdict, np.bincount(ray, minlength=count))
    assert (verdict.sure | verdict.doubt)[ray, tri].all()
    missed = verdict.sure.copy()
    missed[ray, tri] = False
    assert not missed.any()


@settings(max_examples=60)
@given(case=scenes_and_rays())
def test_rows_are_consistent(case):
    vertices, faces, origins, directions = case
    ours = RayMeshIntersector(mesh_of(vertices, faces))
    first = ours.intersects_first(origins, directions)
    assert (ours.intersects_any(origins, directions) == (first >= 0)).all()
    locations, ray, tri = ours.intersects_location(origins, directions)
    assert locations.shape == (len(ray), 3)
    assert np.isfinite(locations).all()
    assert (np.diff(ray) >= 0).all()
    assert (first[ray] >= 0).all()
    near = ours.intersects_location(origins, directions, max_hits=1)
    assert (near[1] == np.unique(ray)).all()
    # On the triangles' boxes, within float32's rounding.
    corners = np.asarray(vertices, float)[faces][tri]
    slack = 1e-5 * np.abs(vertices).max(initial=1e-30)
    assert (locations >= corners.min(axis=1, initial=np.inf) - slack).all()
    assert (locations <= corners.max(axis=1, initial=-np.inf) + slack).all()


def test_locations_are_on_rays_and_planes(sphere, ray):
    origins, directions = rays_of(2000, seed=1)
    origins *= 1e4  # ten kilometres away, aimed at the sphere
    directions = rays_of(2000, seed=2, size=0.5)[0] - origins
    locations, index_ray, index_tri = ray.intersects_location(origins, directions)
    assert len(index_ray) > 3000
    unit = trimesh.unitize(directions)[index_ray]
    off_ray = np.linalg.norm(np.cross(locations - origins[index_ray], unit), axis=1)
    off_plane = np.einsum(
        "ij,ij->i", locations - sphere.triangles[index_tri, 0], sphere.face_normals[index_tri]
    )
    assert off_ray.max() < 1e-10
    assert np.abs(off_plane).max() < 1e-11


def test_a_ray_almost_in_the_plane_stays_on_the_triangle():
    """There float64's plane is far from the triangle's in float32, along the ray."""
    rng = np.random.default_rng(0)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ axes.T + 0.3
    square = mesh_of(corners, [[0, 1, 2], [0, 2, 3]])
    count = 5000
    beside = np.column_stack([rng.uniform(-3, 3, (count, 2)), np.zeros(count)])
    along = np.column_stack([rng.normal(size=(count, 2)), rng.normal(size=count) * 1e-8])
    origins = (beside - 3 * along) @ axes.T + 0.3  # some only seem to hit, in float32
    locations, ray, _ = RayMeshIntersector(square).intersects_location(origins, along @ axes.T)
    assert len(ray) > 500
    inside = (locations - 0.3) @ axes
    assert np.abs(inside).max() < 1 + 1e-5


def test_crossings_of_a_closed_mesh_are_counted_once():
    vertices, faces = icosphere(2)
    ours = RayMeshIntersector(mesh_of(vertices, faces))
    targets = np.concatenate([vertices, vertices[faces[:, :2]].mean(axis=1)])
    origins = np.full_like(targets, 0.0) + [0.1, 0.05, -0.02]  # inside
    _, ray = ours.intersects_id(origins, targets - origins)
    assert (np.bincount(ray, minlength=len(targets)) == 1).all()
    assert ours.intersects_any(origins, targets - origins).all()


def test_no_layer_is_lost():
    square = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], float)
    vertices = np.concatenate([square + [0, 0, 1e-6 * i] for i in range(150)])
    layers = RayMeshIntersector(mesh_of(vertices, np.arange(450).reshape(-1, 3)))
    locations, _, tri = layers.intersects_location([[0, 0, 1]], [[0, 0, -1]])
    assert (tri == np.arange(149, -1, -1)).all()
    assert np.allclose(locations[:, 2], 1e-6 * tri, rtol=0, atol=1e-12)
    assert len(layers.intersects_id([[0, 0, 1]], [[0, 0, -1]], max_hits=7)[0]) == 7


# As trimesh has it.


def undecorated(method):
    """The method itself: the decorator `log_time` hides its signature."""
    while "args" in inspect.signature(method).parameters and method.__closure__:
        method = next(cell.cell_contents for cell in method.__closure__)
    return method


def test_methods_and_arguments_are_those_of_trimesh():
    pytest.importorskip("embreex")
    from trimesh.ray import ray_pyembree, ray_triangle

    for theirs in (ray_pyembree.RayMeshIntersector, ray_triangle.RayMeshIntersector):
        for name, method in inspect.getmembers(theirs, inspect.isfunction):
            if name.startswith("_") and name not in ("__init__", "__copy__", "__deepcopy__"):
                continue
            wanted = inspect.signature(undecorated(method)).parameters
            ours = inspect.signature(getattr(RayMeshIntersector, name)).parameters
            assert set(wanted) - {"kwargs", "args"} <= set(ours), name
    order = inspect.signature(undecorated(ray_pyembree.RayMeshIntersector.intersects_id)).parameters
    assert list(inspect.signature(RayMeshIntersector.intersects_id).parameters) == list(order)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_results_are_those_of_trimesh_with_embree(offset):
    pytest.importorskip("embreex")
    from trimesh.ray.ray_pyembree import RayMeshIntersector as Embree

    vertices, faces = dented_sphere(3)
    mesh = mesh_of(vertices + offset, faces)
    origins, directions = rays_of(4000, seed=3)
    origins += offset
    theirs, ours = Embree(mesh), RayMeshIntersector(mesh)

    # Far from the origin their intersects_first and intersects_any are wrong for some rays, as
    # they round origins to float32 before they subtract the mesh's corner; intersects_id is not.
    tri, ray = theirs.intersects_id(origins, directions, multiple_hits=False)
    one = np.full(len(origins), -1)
    one[ray] = tri
    two = ours.intersects_first(origins, directions)
    same = one == two
    assert same.mean() > 0.999  # theirs may choose another triangle at an edge
    if not offset:
        assert (theirs.intersects_first(origins, directions) == one).all()
        seen = theirs.intersects_any(origins, directions)
        assert (seen == ours.intersects_any(origins, directions))[same].all()
    for options in ({}, {"multiple_hits": False}, {"multiple_hits": True, "max_hits": 2}):
        results = [
            engine.intersects_id(origins, directions, return_locations=True, **options)
            for engine in (theirs, ours)
        ]
        rows = []
        for tri, ray, points in results:
            assert points.shape == (len(tri), 3)
            assert points.dtype == np.float64
            keep = same[ray]
            order = np.lexsort((tri[keep], ray[keep]))
            rows.append((tri[keep][order], ray[keep][order], points[keep][order]))
        one_set, two_set = ({*zip(r[0], r[1], strict=True)} for r in rows)
        assert len(one_set ^ two_set) < 1e-3 * len(one_set)
        if one_set == two_set and len(rows[0][0]) == len(rows[1][0]):
            assert np.abs(rows[0][2] - rows[1][2]).max() < 1e-6
        locations = ours.intersects_location(origins, directions, **options)
        for a, b in zip(locations, (results[1][2], results[1][1], results[1][0]), strict=True):
            assert (a == b).all()
    points = np.random.default_rng(1).uniform(-2, 2, (2000, 3)) + offset
    assert (theirs.contains_points(points) != ours.contains_points(points)).mean() < 1e-3


def test_dtypes_and_shapes(ray):
    for origins, directions in (
        ([[0, 0, 3], [9, 9, 9]], [[0, 0, -1], [0, 0, -1]]),
        (np.zeros((0, 3)), np.zeros((0, 3))),
        ([], []),
    ):
        count = len(origins)
        assert ray.intersects_first(origins, directions).dtype == np.int64
        assert ray.intersects_first(origins, directions).shape == (count,)
        assert ray.intersects_any(origins, directions).dtype == bool
        locations, index_ray, index_tri = ray.intersects_location(origins, directions)
        assert locations.dtype == np.float64
        assert index_ray.dtype == index_tri.dtype == np.int64
        assert locations.shape == (2 if count else 0, 3)
        assert len(ray.intersects_id(origins, directions)) == 2
        assert ray.contains_points(origins).shape == (count,)
    assert len(ray.intersects_id([[0, 0, 3]], [[0, 0, -1]], False, 0)[0]) == 0
    assert len(ray.intersects_id([[0, 0, 3]], [[0, 0, -1]], True, 0)[0]) == 0


def test_it_answers_for_the_mesh():
    mesh = mesh_of(*icosphere(3))
    mesh.ray = RayMeshIntersector(mesh)
    points = np.random.default_rng(2).uniform(-1.2, 1.2, (5000, 3))
    radius = np.linalg.norm(points, axis=1)
    inside = mesh.contains(points)
    inner = np.linalg.norm(mesh.triangles_center, axis=1).min()
    assert inside[radius < 0.99 * inner].all()
    assert not inside[radius > 1].any()
    near = (radius > 0.99 * inner) & (radius < 1)
    normals, corners = mesh.face_normals, mesh.triangles[:, 0]
    depth = np.einsum("nk,fk->nf", points[near], normals) - np.einsum("fk,fk->f", corners, normals)
    assert (inside[near] == (depth.max(axis=1) < 0)).all()  # the mesh is convex


def test_points_whose_ray_passes_vertices_are_found_inside():
    vertices, faces = icosphere(3)
    ours = RayMeshIntersector(mesh_of(vertices, faces))
    # Their line in the direction that is counted passes through a vertex, but for rounding.
    points = vertices - 0.05 * np.sign(vertices @ _INSIDE[0])[:, None] * _INSIDE[0]
    normals = mesh_of(vertices, faces).face_normals
    depth = (points @ normals.T - np.einsum("fk,fk->f", vertices[faces[:, 0]], normals)).max(axis=1)
    clear = np.abs(depth) > 1e-5
    assert clear.sum() > 500
    assert (ours.contains_points(points) == (depth < 0))[clear].all()


def test_a_ray_exactly_through_vertices_counts_them_once():
    tip = 2 * _INSIDE[0].astype(np.float32).astype(float)
    side, front = np.cross(tip, [1.0, 0, 0]), np.cross(tip, [0, 1.0, 0])
    vertices = [tip, -tip, side, -side, front, -front]
    faces = [(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    assert RayMeshIntersector(mesh_of(vertices, faces)).contains_points([[0, 0, 0]]).all()


def test_a_cavity_is_outside():
    outer, inner = trimesh.creation.box((2, 2, 2)), trimesh.creation.box((1, 1, 1))
    inner.invert()
    ours = RayMeshIntersector(trimesh.util.concatenate([outer, inner]))
    assert ours.contains_points([[0, 0, 0], [0.75, 0, 0], [1.5, 0, 0]]).tolist() == [
        False,
        True,
        False,
    ]


def test_points_beside_an_open_mesh_are_outside():
    vertices, faces = icosphere(2)
    opened = mesh_of(vertices, faces[vertices[faces][:, :, 2].mean(axis=1) < 0.5])
    ours = RayMeshIntersector(opened)
    assert not ours.contains_points([[0, 0, 5], [3, 0, 0], [0, 0, -1.5]]).any()
    assert ours.contains_points([[0, 0, -0.9]]).all()


# Changes.


def changed(mesh, change):
    """The answers of an intersector that has seen a mesh before and after, and of a new one."""
    ours = RayMeshIntersector(mesh)
    origins, directions = rays_of(500, seed=5)
    center = mesh.bounds.mean(axis=0)
    before = ours.intersects_location(origins + center, directions)
    change(mesh)
    center = np.zeros(3) if mesh.bounds is None else mesh.bounds.mean(axis=0)
    return [
        before,
        *(
            engine.intersects_location(origins + center, directions)
            for engine in (ours, RayMeshIntersector(mesh))
        ),
    ]


def scale_up(mesh):
    mesh.apply_scale(1.3)


def move(mesh):
    mesh.apply_translation([0.5, 0.25, 0])


def move_far(mesh):
    mesh.apply_translation([3e6, -7e5, 2e6])


def write_vertices(mesh):
    mesh.vertices[:, 2] *= 0.5


def drop_faces(mesh):
    mesh.update_faces(np.arange(len(mesh.faces)) % 2 == 0)


def turn_faces(mesh):
    mesh.faces = np.roll(mesh.faces, 1, axis=1)


def subdivide(mesh):
    other = mesh.subdivide()
    mesh.vertices, mesh.faces = other.vertices, other.faces


def empty(mesh):
    mesh.update_faces(np.zeros(len(mesh.faces), bool))


@pytest.mark.parametrize(
    "change",
    [scale_up, move, move_far, write_vertices, drop_faces, turn_faces, subdivide, empty],
    ids=lambda change: change.__name__,
)
def test_changes_of_the_mesh_are_followed(change):
    before, after, new = changed(mesh_of(*dented_sphere(2)), change)
    for one, two in zip(after, new, strict=True):
        assert one.shape == two.shape
        assert (one == two).all()
    assert (
        before[0].shape != after[0].shape
        or not np.array_equal(before[0], after[0])
        or (change in (turn_faces,))
    )


def test_an_unchanged_mesh_is_not_built_again(sphere):
    ours = RayMeshIntersector(sphere)
    ours.intersects_any([[0, 0, 3]], [[0, 0, -1]])
    tracer = ours._tracer()
    ours.contains_points([[0, 0, 0]])
    assert ours._tracer() is tracer
    moved = sphere.copy()
    ours = RayMeshIntersector(moved)
    tracer = ours._tracer()
    moved.vertices *= 1.1
    assert ours._tracer() is tracer  # refitted
    moved.vertices += 1e9
    assert ours._tracer() is not tracer  # about another centre


def test_copies_and_pickles_answer_alike(sphere):
    origins, directions = rays_of(200)
    ours = RayMeshIntersector(sphere, scale_to_box=False, structure="kdtree")
    wanted = ours.intersects_location(origins, directions)
    for other in (copy.copy(ours), copy.deepcopy(ours), pickle.loads(pickle.dumps(ours))):
        assert other._tracer().structure.name == "kdtree"
        for one, two in zip(other.intersects_location(origins, directions), wanted, strict=True):
            assert (one == two).all()
    mesh = sphere.copy()
    mesh.ray = RayMeshIntersector(mesh)
    mesh.ray.intersects_any(origins, directions)
    back = pickle.loads(pickle.dumps(mesh))
    assert back.ray.mesh is back
    assert (
        back.ray.intersects_any(origins, directions) == mesh.ray.intersects_any(origins, directions)
    ).all()


def test_threads_share_one_structure(sphere):
    ours = RayMeshIntersector(sphere)
    origins, directions = rays_of(2000)
    wanted = RayMeshIntersector(sphere).intersects_first(origins, directions)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: ours.intersects_first(origins, directions), range(16)))
        tracers = set(pool.map(lambda _: id(ours._tracer()), range(16)))
    assert all((one == wanted).all() for one in found)
    assert len(tracers) == 1


# Bad input.


def test_bad_arguments_are_named(ray, sphere):
    good = [[0, 0, 3]], [[0, 0, -1]]
    for method in (ray.intersects_id, ray.intersects_location, ray.intersects_first):
        with pytest.raises(ValueError, match="ray_origins, ray_directions: 1 and 2 rays"):
            method(good[0], [[0, 0, -1]] * 2)
        with pytest.raises(ValueError, match=r"ray_origins: expected shape \(n, 3\)"):
            method([0, 0, 3], good[1])
        with pytest.raises(TypeError, match="ray_directions"):
            method(good[0], [["a", "b", "c"]])
    for many in (True, False):
        with pytest.raises(ValueError, match="max_hits"):
            ray.intersects_id(*good, multiple_hits=many, max_hits=-1)
    with pytest.raises(TypeError):
        ray.intersects_id(*good, max_hits=1.5)
    with pytest.raises(TypeError):
        ray.intersects_id(*good, unknown=1)
    with pytest.raises(ValueError, match=r"points: expected shape \(n, 3\)"):
        ray.contains_points([0, 0, 0])
    with pytest.raises(TypeError, match="geometry: expected a trimesh"):
        RayMeshIntersector(trimesh.Scene())
    with pytest.raises(TypeError, match="geometry: expected a trimesh"):
        RayMeshIntersector()
    with pytest.raises(TypeError, match="two names"):
        RayMeshIntersector(sphere, mesh=sphere)
    assert RayMeshIntersector(mesh=sphere).mesh is sphere


def test_bad_rays_miss_and_bad_points_are_outside(ray):
    origins = np.array([[np.nan, 0, 3], [0, 0, np.inf], [0, 0, 3], [0, 0, 3], [1e300, 0, 3]])
    directions = np.array([[0, 0, -1], [0, 0, -1], [0, 0, 0], [np.nan, 0, -1], [0, 0, -1.0]])
    assert (ray.intersects_first(origins, directions) == -1).all()
    assert not ray.intersects_any(origins, directions).any()
    assert len(ray.intersects_location(origins, directions)[0]) == 0
    assert not ray.contains_points([[np.nan, 0, 0], [np.inf, 0, 0], [1e300, 0, 0]]).any()


def test_an_empty_mesh_is_never_hit():
    ours = RayMeshIntersector(trimesh.Trimesh())
    rays = [[0, 0, 3]], [[0, 0, -1]]
    assert ours.intersects_first(*rays).tolist() == [-1]
    assert ours.intersects_location(*rays)[0].shape == (0, 3)
    assert ours.contains_points([[0, 0, 0]]).tolist() == [False]
