"""Scenes of all kinds on a cluster: one process's bits, of queries and of images."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("dask", "distributed")

import dask.array as da

import raystream as rs
from conftest import assert_same_bits
from meshes import icosphere
from raystream.cluster.bundles import Manifest
from raystream.cluster.errors import ClusterError
from raystream.cluster.tracer_bundles import pack_tracer, unpack_tracer

RAYS = (
    np.array([[278.0, 273.0, -800.0]]),
    np.random.default_rng(1).normal(size=(400, 3)) + [0, 0, 4],
)
HITS = ("t", "u", "v", "prim_id", "instance_id", "status", "mesh_id", "positions", "normals")


def box() -> rs.Scene:
    return rs.load("cornell")


def instances() -> rs.Scene:
    places = np.tile(np.eye(3, 4), (3, 1, 1))
    places[1:, 0, 3], places[2, 0, 0] = (300.0, -400.0), -1.0
    ball = rs.Scene.from_arrays(200.0 * icosphere(1)[0], icosphere(1)[1])
    return rs.Scene.instances(
        [box(), ball], places, [0, 1, 0], camera=box().camera, lights=box().lights
    )


def primitives() -> rs.Scene:
    ground = rs.Scene.height_field(np.eye(4) * 30.0, origin=(100, 100, 50), spacing=80.0)
    balls = rs.Scene.spheres([[278, 273, 280], [100, 400, 200]], [60.0, 40.0])
    return rs.Scene.combine([box(), ground, balls], camera=box().camera, lights=box().lights)


def placed() -> rs.Scene:
    """Instances of spheres and a height field beside those of meshes, with masks."""
    inner = rs.Scene.combine([primitives(), rs.Scene.spheres([[0, 0, 0]], 50.0, mask=4)])
    scene = instances()
    places = np.concatenate([scene.placements.transforms, [[[1.0, 0, 0, 500], *np.eye(4)[1:3]]]])
    places[3, 1, 1] = 0.5
    ball = scene.geometry.objects[1].meshes[0].with_mask(2)
    return rs.Scene.instances(
        [box(), ball, inner],
        places,
        [2, 1, 0, 2],
        masks=[0, 0, 8, 0],
        camera=box().camera,
        lights=box().lights,
    )


KINDS = {
    "instances": (instances, "float32"),
    "primitives": (primitives, "float32"),
    "float64": (box, "float64"),
    "instances of primitives": (placed, "float32"),
    "instances in float64": (instances, "float64"),
}


def received(bundle):
    """What a worker makes of a bundle."""
    return unpack_tracer(Manifest.read(bundle.manifest().text).header, bundle.arrays)


@pytest.mark.parametrize("kind", KINDS)
def test_workers_have_the_same_tracer(kind) -> None:
    make, precision = KINDS[kind]
    tracer = rs.Tracer(make(), precision=precision)
    expected = tracer.first_hit(*RAYS)
    seen = {"size": (16, 12), "camera": box().camera}
    image = rs.render(tracer, "raycast", **seen).pixels
    for given, options in ((tracer, {}), (tracer.scene, {"precision": precision})):
        for for_rendering in (False, True):
            bundle = pack_tracer(given, "bvh", "cpu", options, for_rendering=for_rendering)
            found = received(bundle)
            hits = found.first_hit(*RAYS)
            for name in HITS:
                assert_same_bits(getattr(hits, name), getattr(expected, name))
            for mask in (2, 4, 8):
                found_there, there = (x.count_hits(*RAYS, mask=mask) for x in (found, tracer))
                np.testing.assert_array_equal(found_there, there)
            if for_rendering:
                assert_same_bits(rs.render(found, "raycast", **seen).pixels, image)


def test_workers_build_for_their_devices() -> None:
    """Of other kinds, they get the scene itself."""
    pytest.importorskip("numba_cuda")
    for make, precision in KINDS.values():
        bundle = pack_tracer(make(), "bvh", "cuda", {"precision": precision}, for_rendering=False)
        assert not bundle.header["is_built"]
        assert "scene" in bundle.header
        assert not any(name.startswith(("triangles", "structure")) for name in bundle.arrays)


def test_damaged_geometry_is_named() -> None:
    bundle = pack_tracer(primitives(), "bvh", "cpu", {}, for_rendering=False)
    arrays = {**bundle.arrays, "triangles.spheres.radii": np.zeros(2)}
    with pytest.raises(ClusterError, match="damaged geometry: radii"):
        unpack_tracer(bundle.header, arrays)


@pytest.mark.parametrize("kind", KINDS)
def test_bits_are_those_of_one_process(client, kind) -> None:
    make, precision = KINDS[kind]
    scene = make()
    local = rs.Tracer(scene, precision=precision)
    lazy = RAYS[0], da.from_array(RAYS[1], chunks=(150, 3))
    with rs.cluster.Tracer(scene, client, precision=precision) as tracer:
        for query, names in (("first_hit", HITS), ("multi_hit", (*HITS, "ray_splits", "counts"))):
            found, expected = getattr(tracer, query)(*lazy), getattr(local, query)(*RAYS)
            whole = found.compute()
            for name in names:
                column = getattr(found, name)
                assert column.dtype == getattr(expected, name).dtype
                assert_same_bits(column.compute(), getattr(expected, name))
                assert_same_bits(getattr(whole, name), getattr(expected, name))
        assert_same_bits(tracer.count_hits(*lazy).compute(), local.count_hits(*RAYS))


def test_worlds_are_refused(client) -> None:
    scene = rs.Scene.instances(box(), np.eye(3, 4)[None], worlds=[0])
    with pytest.raises(rs.RaystreamError, match="worlds"):
        rs.cluster.Tracer(scene, client)
