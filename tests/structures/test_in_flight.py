"""All hits of many incoherent rays: those in flight, and in float64 those in groups."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from instanced import random_transforms
from meshes import soup
from raystream.structures.bvh.packets import multi_hit
from raystream.structures.bvh.walks import all_hits

#: Scenes, and the kernel that collects hits of incoherent rays through them.
SCENES = {
    "triangles": (lambda rng: rs.Scene.from_arrays(*soup(500, 5)), "wavefront", {}),
    "instances": (
        lambda rng: rs.Scene.instances(
            rs.Scene.from_arrays(*soup(200, 5)), random_transforms(rng, 30, 2.0)
        ),
        "wavefront",
        {},
    ),
    "spheres": (lambda rng: rs.Scene.spheres(rng.random((500, 3)), 0.1), "wavefront", {}),
    "float64": (
        lambda rng: rs.Scene.from_arrays(*soup(500, 5)),
        "groups",
        {"precision": "float64"},
    ),
}


@pytest.mark.parametrize("capacity", [17, 300])
@pytest.mark.parametrize("name", SCENES)
def test_buffers_grow(name, capacity, rng, monkeypatch) -> None:
    """Calls that find more hits than fit are repeated, and no hit is lost or told twice."""
    make, kernel, options = SCENES[name]
    scene = make(rng)
    rays = rng.uniform(*scene.bounds, (3000, 3)), rng.normal(size=(3000, 3))
    rays[1][5] = np.nan
    wanted = rs.Tracer(scene, kernel="single", **options).multi_hit(*rays)
    for module in (multi_hit, all_hits):
        monkeypatch.setattr(module, "FIRST_CAPACITY", capacity)
    tracer = rs.Tracer(scene, kernel=kernel, **options)
    found = tracer.multi_hit(*rays)
    assert found.counts.max() > 5
    for column in ("ray_splits", "t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(found, column), getattr(wanted, column))
    assert_same_bits(tracer.count_hits(*rays), wanted.counts)
