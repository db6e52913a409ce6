"""Masks: the bits of the same scene without the parts that a ray's mask leaves out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from raystream.core.masks import ALL_BITS, MaskRuns
from meshes import cube, icosphere, soup

COLUMNS = ("t", "u", "v")
STRUCTURES = ("bvh", "kdtree", "grid", "graph", "brute")
KERNELS = ("packet", "groups", "wavefront", "single")
MASKS = np.array([1, 2, 4, 1 | 2, ALL_BITS])


def _rays(count: int, seed: int, coherent: bool) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    if coherent:
        side = int(count**0.5)
        axis = np.linspace(-0.4, 0.4, side)
        directions = np.stack(np.broadcast_arrays(axis, axis[:, None], 1.0), axis=-1)
        return np.array([0.1, 0.2, -5.0]), directions.reshape(-1, 3)
    return rng.uniform(-3.0, 3.0, (count, 3)), rng.normal(size=(count, 3))


def _meshes() -> list[rs.Mesh]:
    rng = np.random.default_rng(7)
    parts = [soup(80, 1), icosphere(2), cube(), icosphere(2), soup(40, 2)]
    return [
        rs.Mesh(np.asarray(points) + rng.uniform(-1.0, 1.0, 3), faces, mask=int(mask))
        for (points, faces), mask in zip(parts, MASKS, strict=True)
    ]


def _only(mesh: rs.Mesh) -> rs.Mesh:
    """The mesh without anything to hit, with as many triangles."""
    return mesh.moved(np.full(mesh.vertices.shape, np.nan))


def _without(scene: rs.Scene, mask: int) -> rs.Scene:
    """The same scene, where what the mask leaves out cannot be hit; ids are the same."""
    return rs.Scene([one if one.mask & mask else _only(one) for one in scene.meshes])


def assert_same(found: Any, expected: Any, rows: Any = slice(None)) -> None:
    for name in (*COLUMNS, "prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(found, name)[rows], getattr(expected, name)[rows])


def check(
    tracer: rs.Tracer, left: dict[int, rs.Tracer], rays: Any, masks: Any, **more: Any
) -> None:
    """Compare all queries of rays with a mask each with those of scenes without the parts."""
    given = {"mask": masks, **more}
    first, seen = tracer.first_hit(*rays, **given), tracer.any_hit(*rays, **given)
    count, many = tracer.count_hits(*rays, **given), tracer.multi_hit(*rays, **given)
    few = tracer.multi_hit(*rays, **given, max_hits=2)
    rows = np.broadcast_to(masks, first.t.shape)
    for mask, other in left.items():
        mine = np.flatnonzero(rows == mask)
        some = [np.broadcast_to(part, (*first.t.shape, 3))[mine] for part in rays]
        others = {key: value[mine] for key, value in more.items()}
        expected = other.first_hit(*some, **others)
        for name in (*COLUMNS, "prim_id", "instance_id"):
            np.testing.assert_array_equal(getattr(first, name)[mine], getattr(expected, name))
        np.testing.assert_array_equal(seen[mine], other.any_hit(*some, **others))
        np.testing.assert_array_equal(count[mine], other.count_hits(*some, **others))
        for found, limit in ((many, None), (few, 2)):
            reference = other.multi_hit(*some, **others, max_hits=limit)
            chosen = np.isin(found.ray_id, mine)
            for name in (*COLUMNS, "prim_id", "instance_id"):
                wanted = getattr(reference, name)
                np.testing.assert_array_equal(getattr(found, name)[chosen], wanted)


@pytest.mark.parametrize("coherent", [True, False])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_each_structure(structure: str, coherent: bool) -> None:
    scene = rs.Scene(_meshes())
    rays = _rays(400, 1, coherent)
    masks = np.random.default_rng(2).choice([0, 1, 2, 5, ALL_BITS], 400)
    left = {int(m): rs.Tracer(_without(scene, int(m)), "brute") for m in np.unique(masks)}
    check(rs.Tracer(scene, structure), left, rays, masks)
