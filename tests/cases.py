"""Rays and scenes that every structure must answer alike, hard ones by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import raystream as rs
from meshes import cube, dented_sphere, grid_floor, icosphere, lattice_soup, soup

#: Rays of a case; benchmarks/agreement.py takes more.
RAY_COUNT = 400


@dataclass
class Case:
    """A scene of one mesh, and rays."""

    vertices: np.ndarray
    faces: np.ndarray
    origins: np.ndarray
    directions: np.ndarray
    t_min: np.ndarray | float = 0.0
    t_max: np.ndarray | float = np.inf

    @property
    def scene(self) -> rs.Scene:
        return rs.Scene.from_arrays(self.vertices, self.faces)

    def limits(self):
        shape = (len(self.origins),)
        return np.broadcast_to(self.t_min, shape), np.broadcast_to(self.t_max, shape)


def _rays_at(vertices, rng):
    """Rays from around a mesh to points near it."""
    count = RAY_COUNT
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = (high - low).max()
    origins = low + rng.random((count, 3)) * (high - low) + rng.normal(size=(count, 3)) * size
    targets = low + rng.random((count, 3)) * (high - low)
    return origins, targets - origins


def _aimed(vertices, faces, rng, from_inside):
    """Rays at vertices, points of edges and edge midpoints."""
    count = RAY_COUNT
    corners = vertices[faces[rng.integers(0, len(faces), count)]]
    share = rng.choice([0.0, 0.5, 0.25, rng.random()], count)[:, None]
    targets = corners[:, 0] * (1 - share) + corners[:, 1] * share
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    size = np.ptp(vertices, axis=0).max()
    if from_inside:
        origins = middle + rng.normal(size=(count, 3)) * 0.02 * size
    else:
        away = rng.normal(size=(count, 3))
        origins = middle + away / np.linalg.norm(away, axis=1, keepdims=True) * 2 * size
    return origins, targets - origins


def random_soup(rng):
    mesh = soup(300, 1)
    return Case(*mesh, *_rays_at(mesh[0], rng))


def closed_mesh(rng):
    mesh = dented_sphere(2)
    return Case(*mesh, *_rays_at(mesh[0], rng))


def edges_and_vertices_from_inside(rng):
    mesh = dented_sphere(2)
    return Case(*mesh, *_aimed(*mesh, rng, True))


def edges_and_vertices_from_outside(rng):
    mesh = icosphere(2)
    return Case(*mesh, *_aimed(*mesh, rng, False))


def exact_edges_on_a_lattice(rng):
    vertices, faces = lattice_soup(80)
    origins = rng.integers(-9, 10, (RAY_COUNT, 3)).astype(float)
    targets = vertices[rng.integers(0, len(vertices), RAY_COUNT)]
    directions = targets - origins
    directions[~directions.any(axis=1)] = (1, 0, 0)
    return Case(vertices, faces, origins, directions)


def axis_parallel(rng):
    mesh = lattice_soup(80, 5)
    axis = rng.integers(0, 3, RAY_COUNT)
    directions = np.eye(3)[axis] * rng.choice([-1.0, 1.0, -0.0], (RAY_COUNT, 1))
    directions[~directions.any(axis=1)] = (0.0, -0.0, -1.0)
    origins = rng.integers(-4, 5, (RAY_COUNT, 3)) + rng.choice([0, 0.5], (RAY_COUNT, 3))
    return Case(*mesh, origins, directions)


def one_zero_component(rng):
    mesh = dented_sphere(1)
    origins, directions = _rays_at(mesh[0], rng)
    directions[np.arange(RAY_COUNT), rng.integers(0, 3, RAY_COUNT)] = 0.0
    return Case(*mesh, origins, directions)


def in_the_plane_of_a_triangle(rng):
    mesh = grid_floor(6)
    origins = rng.uniform(-2, 2, (RAY_COUNT, 3)) * [1, 0, 1]
    directions = rng.normal(size=(RAY_COUNT, 3)) * [1, 0, 1]
    return Case(*mesh, origins, directions)


def almost_in_the_plane_of_a_triangle(rng):
    """Rays that pass an edge: rounding accepts them, and their t can be far from the triangle.

    Small triangles all around make boxes and planes between the large ones' edges and those hits.
    """
    large = rng.random((30, 3, 3))
    small = rng.random((1000, 1, 3)) + rng.normal(size=(1000, 3, 3)) * 0.01
    vertices = np.concatenate([large, small]).astype(np.float32).reshape(-1, 3)
    count = 4 * RAY_COUNT
    triangles = vertices.reshape(-1, 3, 3)[rng.integers(0, len(large), count)].astype(float)
    # From a point in the plane, outside the edges, towards one inside.
    outer = rng.uniform(-1, 2, (count, 3, 1))
    outside = (outer / outer.sum(axis=1, keepdims=True) * triangles).sum(axis=1)
    inside = (rng.dirichlet([1, 1, 1], count)[:, :, None] * triangles).sum(axis=1)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tilt = 10.0 ** rng.uniform(-9, -6, (count, 1)) * rng.choice([-1, 1], (count, 1))
    directions = inside - outside
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions += normals * tilt
    origins = outside - directions * rng.uniform(0.5, 3, (count, 1))
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return Case(vertices, faces, origins, directions)


def flat_box(rng):
    mesh = grid_floor(6)
    origins = rng.uniform(-2, 2, (RAY_COUNT, 3))
    origins[::4, 1] = 0.0  # begin in the plane
    return Case(*mesh, origins, rng.uniform(-1, 1, (RAY_COUNT, 3)) - origins)


def degenerate_and_duplicate(rng):
    vertices, faces = soup(60, 7)
    points = np.repeat(rng.integers(0, len(vertices), (40, 1)), 3, axis=1)
    lines = rng.integers(0, len(vertices), (40, 3))
    lines[:, 2] = lines[:, 1]
    faces = np.vstack([points, faces, lines, faces[:, [1, 2, 0]], faces])
    return Case(vertices, faces, *_rays_at(vertices, rng))


def huge_offset(rng):
    vertices, faces = dented_sphere(2)
    vertices = vertices + [1e7, -3e7, 2e7]
    return Case(vertices, faces, *_rays_at(vertices, rng))


def tiny_scale(rng):
    vertices, faces = dented_sphere(2)
    vertices = vertices * 1e-6
    return Case(vertices, faces, *_rays_at(vertices, rng))


def tiny_scale_at_a_huge_offset(rng):
    vertices, faces = dented_sphere(1)
    vertices = vertices * 1e-3 + [1e7, 0, 0]
    return Case(vertices, faces, *_rays_at(vertices, rng))


def enormous_scale(rng):
    vertices, faces = dented_sphere(1)
    vertices = vertices * 1e20
    return Case(vertices, faces, *_rays_at(vertices, rng))


def origins_far_away(rng):
    vertices, faces = icosphere(2)
    origins = rng.normal(size=(RAY_COUNT, 3)) * 1e6
    return Case(vertices, faces, origins, rng.uniform(-1, 1, (RAY_COUNT, 3)) - origins)


def directions_of_any_length(rng):
    mesh = soup(100, 3)
    origins, directions = _rays_at(mesh[0], rng)
    return Case(*mesh, origins, directions * 10.0 ** rng.uniform(-25, 25, (RAY_COUNT, 1)))


def from_a_surface(rng):
    vertices, faces = dented_sphere(2)
    corners = vertices[faces[rng.integers(0, len(faces), RAY_COUNT)]]
    weights = rng.dirichlet([1, 1, 1], RAY_COUNT)
    origins = np.einsum("nk,nkx->nx", weights, corners)
    return Case(vertices, faces, origins, rng.normal(size=(RAY_COUNT, 3)))


def limited_intervals(rng):
    mesh = soup(200, 11)
    origins, directions = _rays_at(mesh[0], rng)
    t_min = rng.uniform(-1, 1, RAY_COUNT)
    return Case(*mesh, origins, directions, t_min, t_min + rng.uniform(-0.2, 1, RAY_COUNT))


def limits_at_the_hits_themselves(rng):
    case = random_soup(rng)
    t = rs.Tracer(case.scene, "brute").first_hit(case.origins, case.directions).t
    case.t_min = np.where(np.isfinite(t) & (np.arange(RAY_COUNT) % 2 == 0), t, 0)
    case.t_max = t
    return case


def one_triangle(rng):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    return Case(vertices, np.array([[0, 1, 2]]), *_rays_at(vertices + [0, 0, 0.1], rng))


def a_cube_along_its_diagonals(rng):
    mesh = cube()
    corners = rng.integers(0, 2, (RAY_COUNT, 3)).astype(float)
    directions = np.array([1.0, 1.0, 1.0]) - 2 * corners
    directions[::3] *= rng.integers(0, 2, (len(directions[::3]), 3))
    directions[~directions.any(axis=1)] = (0, 1, 0)
    return Case(*mesh, corners - 2 * directions, directions)


CASES: dict[str, Callable[[np.random.Generator], Case]] = {
    make.__name__: make
    for make in (
        random_soup,
        closed_mesh,
        edges_and_vertices_from_inside,
        edges_and_vertices_from_outside,
        exact_edges_on_a_lattice,
        axis_parallel,
        one_zero_component,
        in_the_plane_of_a_triangle,
        almost_in_the_plane_of_a_triangle,
        flat_box,
        degenerate_and_duplicate,
        huge_offset,
        tiny_scale,
        tiny_scale_at_a_huge_offset,
        enormous_scale,
        origins_far_away,
        directions_of_any_length,
        from_a_surface,
        limited_intervals,
        limits_at_the_hits_themselves,
        one_triangle,
        a_cube_along_its_diagonals,
    )
}
