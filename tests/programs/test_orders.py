"""Order-independent programs get the same hits from every structure."""

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere
from programs.layers import layers_scene
from raystream.structures import single_kernels
from raystream.structures.bvh.packets import multi_hit as packet_multi_hit

RECORD = np.dtype([("hits", "i4"), ("ids", "i8"), ("rays", "i8"), ("near", "f4"), ("far", "f4")])

VERTICES, FACES = dented_sphere(3)

WAYS = {
    "packets": {"kernel": "packet"},
    "chosen": {},
    "single rays": {"kernel": "single"},
    "kdtree": {"structure": "kdtree"},
}


def gather(hit, payload):
    if payload.hits == 0 or hit.t < payload.near:
        payload.near = hit.t
    if payload.hits == 0 or hit.t > payload.far:
        payload.far = hit.t
    payload.hits += 1
    payload.ids += (hit.prim_id + 7) ** 2
    payload.rays += hit.ray + 1


def count_sides(hit, payload):
    payload[0] += 1 if hit.is_entering else -1


def is_odd(hit):
    return hit.prim_id % 2 == 1


def until_third(hit):
    return rs.Decision.STOP if hit.prim_id % 3 == 0 else rs.Decision.CONTINUE


def picture(kind):
    """An image of rays at a sphere; those of some kinds take the long way to the scene."""
    low, high = VERTICES.min(axis=0), VERTICES.max(axis=0)
    x, y = np.meshgrid(
        *(np.linspace(low[k] - 0.1, high[k] + 0.1, n) for k, n in ((0, 70), (1, 50)))
    )
    origins = np.stack([x, y, np.full_like(x, low[2] - 5.0)], axis=-1)
    directions = np.zeros_like(origins)
    directions[..., 2] = 1.0
    if kind == "float32":
        return origins.astype(np.float32), directions.astype(np.float32)
    directions[..., :2] = np.random.default_rng(1).normal(size=(*x.shape, 2)) * 0.01
    if kind == "far away":
        origins[20:] -= 1e7 * directions[20:]
    if kind == "long and short":
        directions[:, ::3] *= 1e-200
        directions[7:9] *= 3e38
    return origins, directions


@pytest.mark.parametrize("kind", ["float32", "float64", "far away", "long and short"])
@pytest.mark.parametrize("way", WAYS)
def test_every_hit_comes_once_with_its_ray_and_its_distance(way, kind):
    tracer = rs.Tracer(rs.Scene.from_arrays(VERTICES, FACES), **WAYS[way])
    rays = picture(kind)
    many = tracer.multi_hit(*rays)
    assert len(many.t) > 1000
    found = tracer.trace(*rays, on_hit=gather, payload=RECORD, order="any").ravel()
    np.testing.assert_array_equal(found["hits"], many.counts.ravel())
    squares = np.bincount(many.ray_id, (many.prim_id + 7.0) ** 2, minlength=len(found))
    np.testing.assert_array_equal(found["ids"], squares.astype(np.int64))
    hit = np.flatnonzero(found["hits"])
    np.testing.assert_array_equal(found["rays"][hit], (hit + 1) * found["hits"][hit])
    assert_same_bits(found["near"][hit], many.t[many.ray_splits[hit]])
    assert_same_bits(found["far"][hit], many.t[many.ray_splits[hit + 1] - 1])


@pytest.mark.parametrize("way", WAYS)
def test_directions_are_the_rays_own(way):
    tracer = rs.Tracer(rs.Scene.from_arrays(VERTICES, FACES), **WAYS[way])
    options = {"on_hit": count_sides, "payload": int, "crossings": "surfaces", "order": "any"}
    assert not tracer.trace(*picture("float64"), **options).any()


@pytest.mark.parametrize("way", WAYS)
def test_a_count_that_stops_depends_on_the_order(way):
    tracer = rs.Tracer(layers_scene(), **WAYS[way])
    rng = np.random.default_rng(4)
    rays = rng.uniform([0, 0, -1], [1, 1, 0], (6000, 3)), [0.0, 0.0, 0.5]
    many = tracer.multi_hit(*rays)
    ends = many.prim_id % 3 == 0
    before = np.cumsum(ends) - ends
    starts = np.append(before, ends.sum())[many.ray_splits[:-1]]
    kept = before == starts[many.ray_id]
    expected = np.bincount(many.ray_id[kept], minlength=6000)
    np.testing.assert_array_equal(tracer.count_hits(*rays, on_hit=until_third), expected)
    odd = np.bincount(many.ray_id[many.prim_id % 2 == 1], minlength=6000)
    np.testing.assert_array_equal(tracer.count_hits(*rays, on_hit=is_odd), odd)


@pytest.mark.parametrize("way", WAYS)
def test_buffers_grow(way, monkeypatch):
    tracer = rs.Tracer(layers_scene(), **WAYS[way])
    rng = np.random.default_rng(6)
    rays = rng.uniform([-0.5, -0.5, -1], [1, 1, 0], (3000, 3)), [0.0, 0.0, 0.5]
    expected = tracer.multi_hit(*rays)
    nearest = tracer.multi_hit(*rays, max_hits=7)
    assert expected.counts.max() == 90
    monkeypatch.setattr(single_kernels, "FIRST_CAPACITY", 1)
    monkeypatch.setattr(packet_multi_hit, "FIRST_CAPACITY", 16)
    for most, wanted in ((None, expected), (7, nearest)):
        found = tracer.multi_hit(*rays, max_hits=most)
        assert_same_bits(found.ray_splits, wanted.ray_splits)
        for name in ("t", "u", "v", "prim_id"):
            assert_same_bits(getattr(found, name), getattr(wanted, name))
    found = tracer.trace(*rays, on_hit=gather, payload=RECORD, order="any")
    np.testing.assert_array_equal(found["hits"], expected.counts)
