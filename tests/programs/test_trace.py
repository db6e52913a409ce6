import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, icosphere
from programs.layers import enters, layers_rays, layers_scene, ranks, sums
from raystream.jit.threads import set_thread_count
from raystream.programs import rounds
from strategies import scenes_and_rays

RECORD = np.dtype(
    [("hits", "i4"), ("depth", "f8"), ("inside", "i8"), ("mesh", "u1", 3), ("wrong", "?")]
)
LAST = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4"), ("ray", "i8")])


def count(hit, payload):
    payload[0] += 1


def describe(hit, payload):
    if hit.t < payload.depth:
        payload.wrong = True
    payload.hits += 1
    payload.depth = hit.t
    payload.inside += 1 if hit.is_entering else -1
    payload.mesh[hit.mesh_id] += 1


def third(hit, payload):
    payload.t = hit.t
    payload.u = hit.u
    payload.v = hit.v
    payload.prim_id = hit.prim_id
    payload.ray += 1
    if payload.ray == 3:
        payload.ray = hit.ray
        return rs.Decision.STOP
    return rs.Decision.IGNORE


def up_to(hit, payload):
    payload[0] += 1
    payload[1] = payload[1] * 7 + hit.prim_id
    if payload[0] == payload[2]:
        return rs.Decision.STOP
    return None


def nothing(hit, payload):
    return rs.Decision.CONTINUE


@pytest.fixture
def small_pieces(monkeypatch):
    """A few rays at a time, and a few hits of each."""
    monkeypatch.setattr(rounds, "FIRST_RAYS", 32)
    monkeypatch.setattr(rounds, "RAYS_PER_BLOCK", 50)
    monkeypatch.setattr(rounds, "FEW_HITS", 0)
    monkeypatch.setattr(rounds, "SEEN_SHARE", 1.0)


def test_every_tracer_gives_programs_the_hits_of_multi_hit_in_order(make_tracer):
    tracer = make_tracer(layers_scene())
    origins, directions = layers_rays()
    many = tracer.multi_hit(origins, directions)
    record = tracer.trace(origins, directions, on_hit=describe, payload=RECORD)
    assert record.shape == many.status.shape
    np.testing.assert_array_equal(record["hits"], many.counts)
    assert not record["wrong"].any()
    last = sums(many, many.t.astype(float), ranks(many) == many.counts.ravel()[many.ray_id] - 1)
    np.testing.assert_array_equal(record["depth"], last)
    inside = sums(many, np.where(enters(tracer, many, directions), 1.0, -1.0))
    np.testing.assert_array_equal(record["inside"], inside)
    for mesh in range(3):
        expected = sums(many, (many.mesh_id == mesh).astype(float))
        np.testing.assert_array_equal(record["mesh"][..., mesh], expected)
    counted = tracer.trace(origins, directions, on_hit=count, payload=int, order="any")
    np.testing.assert_array_equal(counted, many.counts)


def test_a_ray_that_stops_sees_no_more(make_tracer, small_pieces):
    tracer = make_tracer(layers_scene())
    origins, directions = layers_rays()
    many = tracer.multi_hit(origins, directions, max_hits=3)
    record = tracer.trace(origins, directions, on_hit=third, payload=LAST)
    rows = ranks(many) == 2
    rays = many.ray_id[rows]
    picked = record.reshape(-1)[rays]
    for name in ("t", "u", "v", "prim_id"):
        assert_same_bits(np.ascontiguousarray(picked[name]), getattr(many, name)[rows])
    np.testing.assert_array_equal(picked["ray"], rays)
    others = np.setdiff1d(np.arange(record.size), rays)
    assert not record.reshape(-1)[others]["t"].any()


@pytest.mark.parametrize("crossings", ["triangles", "surfaces"])
@pytest.mark.parametrize("structure", ["bvh", "grid"])
def test_pieces_give_each_hit_once_and_in_order(small_pieces, crossings, structure):
    tracer = rs.Tracer(layers_scene(), structure)
    origins, directions = layers_rays()
    origins[5, 7:11] = [[0.5, 0.5, -1], [1, 1, -1], [0, 0, -1], [0.25, 0.25, -1]]  # on edges
    many = tracer.multi_hit(origins, directions, crossings=crossings)
    rng = np.random.default_rng(8)
    limits = rng.choice([1, 2, 5, 16, 17, 40, 64, 10**6], origins.shape[:2])
    payload = np.zeros((*limits.shape, 3), np.int64)
    payload[..., 2] = limits
    tracer.trace(origins, directions, on_hit=up_to, payload=payload, crossings=crossings)
    np.testing.assert_array_equal(payload[..., 0], np.minimum(many.counts, limits))
    hashed = np.zeros(many.status.size, np.int64)
    with np.errstate(over="ignore"):
        for row, rank in enumerate(ranks(many)):
            ray = many.ray_id[row]
            if rank < limits.flat[ray]:
                hashed[ray] = hashed[ray] * 7 + many.prim_id[row]
    np.testing.assert_array_equal(payload[..., 1].ravel(), hashed)


@settings(max_examples=40)
@given(scenes_and_rays(), st.integers(1, 4), st.sampled_from(["triangles", "surfaces"]))
def test_any_scene(case, most, crossings):
    vertices, faces, origins, directions = case
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    payload = np.zeros((len(origins), 3))
    payload[:, 2] = most
    tracer.trace(origins, directions, on_hit=up_to, payload=payload, crossings=crossings)
    many = tracer.multi_hit(origins, directions, max_hits=most, crossings=crossings)
    np.testing.assert_array_equal(payload[:, 0], many.counts)


def test_a_closed_mesh_is_entered_as_often_as_it_is_left(rng):
    vertices, faces = dented_sphere(3)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    directions = rng.normal(size=(4000, 3))
    away = directions / np.linalg.norm(directions, axis=1)[:, None]
    origins = vertices.mean(axis=0) - 2 * np.ptp(vertices, axis=0).max() * away
    directions += 0.1 * rng.normal(size=directions.shape)
    record = tracer.trace(
        origins, directions, on_hit=describe, payload=RECORD, crossings="surfaces"
    )
    assert record["hits"].sum() > 4000
    assert not record["inside"].any()


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e18])
@pytest.mark.parametrize("length", [1e-200, 1e-30, 1.0, 1e30, 1e200])
def test_entering_does_not_depend_on_lengths(scale, length):
    vertices, faces = icosphere(1)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices * scale, faces))
    origins = np.array([[-3.0, 0.1, 0.2], [0.0, 0.1, 0.2]]) * scale
    record = tracer.trace(origins, [length, 0.0, 0.0], on_hit=describe, payload=RECORD)
    assert record["hits"].tolist() == [2, 1]
    assert record["inside"].tolist() == [0, -1]


def test_blocks_of_a_large_batch(rng, monkeypatch):
    monkeypatch.setattr(rounds, "RAYS_PER_BLOCK", 9_000)
    tracer = rs.Tracer(rs.Scene.from_arrays(*dented_sphere(3)))
    x, y = np.meshgrid(np.linspace(-2, 2, 211), np.linspace(-2, 2, 153))
    origins = np.stack([x, y, np.full_like(x, -5)], axis=-1).astype(np.float32)
    t_max = rng.uniform(3, 7, x.shape).astype(np.float32)
    for shape in (x.shape, (-1,), (51, 3, 211)):
        rays = origins.reshape(*shape, 3), [0, 0, 1]
        limit = t_max.reshape(shape)
        seen: list[tuple[int, int]] = []
        counts = tracer.trace(
            *rays,
            on_hit=count,
            payload=int,
            t_max=limit,
            progress=lambda *steps, seen=seen: seen.append(steps),
        )
        np.testing.assert_array_equal(counts, tracer.count_hits(*rays, t_max=limit))
        assert seen == sorted(seen)
        assert seen[-1] == (x.size, x.size)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_threads_does_not_matter(threads, rng):
    tracer = rs.Tracer(layers_scene())
    rays = rng.uniform(-1, 2, (40_000, 3)), rng.normal(size=(40_000, 3))
    expected = tracer.trace(*rays, on_hit=describe, payload=RECORD)
    set_thread_count(threads)
    try:
        assert_same_bits(tracer.trace(*rays, on_hit=describe, payload=RECORD), expected)
    finally:
        set_thread_count(None)


def test_payloads():
    tracer = rs.Tracer(layers_scene())
    origins, directions = layers_rays()
    shape = origins.shape[:2]
    counts = tracer.count_hits(origins, directions)
    for dtype in ("u1", "i2", "f4", "f8", "c16", np.dtype(("i8", 2))):
        made = tracer.trace(origins, directions, on_hit=count, payload=dtype)
        assert made.dtype == np.dtype(dtype).base
        np.testing.assert_array_equal(made[..., 0] if made.ndim == 3 else made, counts)
    given = np.ones((2 * shape[0], shape[1], 3))[::2, :, 1:]  # scattered
    assert tracer.trace(origins, directions, on_hit=count, payload=given) is given
    np.testing.assert_array_equal(given[..., 0], counts + 1)
    assert (given[..., 1] == 1).all()
    records = np.zeros(shape, RECORD)[:, ::-1]
    assert tracer.trace(origins, directions, on_hit=describe, payload=records) is records
    np.testing.assert_array_equal(records["hits"], counts)
    assert tracer.trace(origins, directions, on_hit=nothing) is None
    single = tracer.trace(origins[5, 5], directions[5, 5], on_hit=count, payload=int)
    assert single.shape == ()
    assert single == counts[5, 5]
    none = np.empty((0, 3))
    assert tracer.trace(none, none, on_hit=count, payload=int).shape == (0,)


def test_empty_scene():
    tracer = rs.Tracer(rs.Scene.from_arrays(np.empty((0, 3)), np.empty((0, 3), int)))
    assert tracer.trace(np.zeros((5, 3)), [0, 0, 1], on_hit=count, payload=int).tolist() == [0] * 5
