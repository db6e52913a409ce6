"""Derivatives of hits in scenes of all kinds, by central differences: what was hit held fixed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import raystream as rs
from gradients import crossing
from instanced import random_transforms
from meshes import icosphere, soup
from raystream.core.spheres import numbers_toward

_STEP = 1e-6

#: Most error of float32's u and v, relative to the largest derivative; and in float64.
TOLERANCES = {"float32": 1e-4, "float64": 1e-7}


def _instances(rng: np.random.Generator) -> rs.Scene:
    objects = [rs.Scene.from_arrays(*icosphere(1)), rs.Scene.from_arrays(*soup(20, 3))]
    transforms = random_transforms(rng, 12, 2.0)
    return rs.Scene.instances(objects, transforms, np.arange(12) % 2)


def _primitives(rng: np.random.Generator) -> rs.Scene:
    return rs.Scene.combine(
        [
            rs.Scene.from_arrays(*soup(20, 3)),
            rs.Scene.height_field(rng.uniform(-1, 1, (9, 9)), origin=(-2, -2, 0), spacing=0.5),
            rs.Scene.spheres(rng.uniform(-2, 2, (30, 3)), rng.uniform(0.2, 0.6, 30)),
        ]
    )


def _placed(rng: np.random.Generator) -> rs.Scene:
    """Instances of meshes beside those of spheres and height fields."""
    objects = [rs.Scene.from_arrays(*icosphere(1)), _primitives(rng)]
    objects.append(rs.Scene.spheres(rng.uniform(-2, 2, (9, 3)), rng.uniform(0.2, 0.9, 9)))
    transforms = random_transforms(rng, 9, 2.0)
    return rs.Scene.instances(objects, transforms, np.arange(9) % 3)


#: Scenes by kind, and the precision.
KINDS: dict[str, tuple[Callable[[np.random.Generator], rs.Scene], str]] = {
    "instances": (_instances, "float32"),
    "primitives": (_primitives, "float32"),
    "float64": (lambda _: rs.Scene.from_arrays(*icosphere(2)), "float64"),
    "instances of primitives": (_placed, "float32"),
    "instances in float64": (_instances, "float64"),
}


def tracer_and_rays(kind: str) -> tuple[rs.Tracer, np.ndarray, np.ndarray]:
    """A tracer, and rays of which most hit, in float64."""
    rng = np.random.default_rng(2013)
    make, precision = KINDS[kind]
    scene = make(rng)
    low, high = scene.bounds
    origins = low + (high - low) * rng.uniform(-0.3, 1.3, (300, 3))
    ends = low + (high - low) * rng.uniform(0.2, 0.8, (300, 3))
    ends[:30] += 3.0 * (high - low)
    return rs.Tracer(scene, precision=precision), origins, ends - origins


def _outputs(tracer: rs.Tracer, hits: Any, origins: Any, directions: Any, vertices: Any) -> Any:
    """t, u, v and the points of rays on what they hit, shape (N, 6); 0 for misses."""
    scene, store = tracer.scene, tracer.structure.triangles
    found = np.zeros((len(origins), 6))
    faces = scene.attributes.faces
    is_mesh = (hits.prim_id >= 0) & (hits.prim_id < len(faces))
    rows = np.flatnonzero(is_mesh)
    corners = np.full((len(origins), 3, 3), np.nan)
    corners[rows] = vertices[faces[hits.prim_id[rows]]]
    if scene.placements is not None:
        placed = scene.placements.transforms[hits.instance_id[rows]]
        corners[rows] = np.einsum("nij,nkj->nki", placed[:, :, :3], corners[rows])
        corners[rows] += placed[:, None, :, 3]
    spheres = store.sphere_rows(hits.prim_id)
    fields = np.flatnonzero((hits.prim_id >= 0) & ~is_mesh & (spheres < 0))
    if len(fields):
        ids, places = hits.prim_id[fields], hits.instance_id[fields]
        corners[fields] = store.points_to_world(store.corners_at(ids, places), places)
    flat = np.concatenate([rows, fields])
    found[flat] = crossing(origins[flat], directions[flat], corners[flat])
    round_ones = np.flatnonzero(spheres >= 0)
    if len(round_ones):
        world = o, d = origins[round_ones], directions[round_ones]
        if scene.placements is not None:
            back = scene.placements.inverses[hits.instance_id[round_ones]]
            o, d = (np.einsum("nij,nj->ni", back[:, :, :3], one) for one in world)
            o += back[:, :, 3]
        centers = store.spheres.centers[spheres[round_ones]]
        radii = store.spheres.radii[spheres[round_ones]]
        squared, half = (d * d).sum(1), ((o - centers) * d).sum(1)
        rest = ((o - centers) ** 2).sum(1) - radii**2
        root = np.sqrt(half**2 - squared * rest)
        sides = np.stack([(-half - root) / squared, (-half + root) / squared])
        side = np.abs(sides - hits.t[round_ones]).argmin(axis=0)
        t = np.take_along_axis(sides, side[None], axis=0)[0]
        u, v = numbers_toward(o + t[:, None] * d - centers)
        points = world[0] + t[:, None] * world[1]
        found[round_ones] = np.column_stack([t, u, v, points])
    return found


def check_slopes_of_kind(kind: str, slopes: Callable[..., Any]) -> None:
    """Compare a library's derivatives.

    Parameters
    ----------
    kind : str
        A key of `KINDS`.
    slopes : callable
        ``slopes(tracer, origins, directions, vertices, weights)`` returns the derivatives, by the
        three arrays, of the sum of t, u, v and positions of first hits with weights of shape
        (N, 6), and leaves misses out; and the instance_ids.
    """
    tracer, origins, directions = tracer_and_rays(kind)
    vertices = np.concatenate([one.vertices for one in tracer.scene.meshes]).astype(float)
    hits, rng = tracer.first_hit(origins, directions), np.random.default_rng(7)
    assert 0.4 < hits.is_hit.mean() < 1.0
    if "primitives" in kind:
        assert len(np.unique(hits.mesh_id[hits.is_hit])) >= 3

    # Grazing rays have large derivatives, and rays near the folds of a sphere's u and v have
    # others on both sides.
    is_steep = np.abs(np.einsum("ij,ij->i", hits.normals, directions)) > 0.3
    held: Any = tracer.structure.triangles
    is_plain = np.abs([hits.normals, held.local_normals(hits)]).min(axis=(0, 2)) > 0.01
    is_sound = hits.is_hit & is_steep & is_plain
    assert is_sound.sum() > 80
    for k in range(6):
        weights = np.zeros((len(origins), 6))
        weights[is_sound, k] = rng.uniform(0.5, 1.0, is_sound.sum())
        by_origin, by_direction, by_vertex, ids = slopes(
            tracer, origins, directions, vertices, weights
        )
        np.testing.assert_array_equal(ids, hits.instance_id)
        ways = [rng.normal(size=one.shape) for one in (origins, directions, vertices)]
        for given, found in enumerate((by_origin, by_direction, by_vertex)):
            ends = []
            for sign in (1.0, -1.0):
                moved = [origins, directions, vertices]
                moved[given] = moved[given] + sign * _STEP * ways[given]
                ends.append(_outputs(tracer, hits, *moved)[:, k] * weights[:, k])
            expected, ours = (ends[0] - ends[1]) / (2 * _STEP), (found * ways[given]).sum(axis=-1)
            if given == 2:  # of all rays together
                expected, ours = expected.sum(), ours.sum()
                assert expected != 0.0
            error = np.abs(ours - expected).max() / np.abs(expected).max()
            limit = TOLERANCES[tracer.structure.precision]
            assert error < limit, (k, given, error)
