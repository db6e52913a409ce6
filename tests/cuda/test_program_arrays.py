"""Programs and filters for rays in arrays on the device: answers stay there."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from programs.layers import layers_rays, layers_scene
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.jit.cuda import DeviceArray
from raystream.programs import Bound

RECORD = np.dtype([("hits", "i4"), ("depth", "f8")])
COLUMNS = ("t", "u", "v", "prim_id", "status")


def fold(hit, payload):
    payload.hits += 1
    payload.depth += hit.t * payload.hits
    return rs.Decision.STOP if payload.hits == 10 else rs.Decision.CONTINUE


def add_up(hit, payload):
    payload[0] = 3 * payload[0] + hit.prim_id


def one_in_five(hit):
    return hit.prim_id % 5 == 0


def is_other(hit, constants):
    return hit.mesh_id != constants[0]


@pytest.fixture
def rays():
    return layers_rays(5, 4)


@pytest.fixture
def there(gpu, rays):
    """The same rays on the device."""
    return tuple(gpu.upload("rays", array) for array in rays)


@pytest.fixture
def tracer(gpu):
    return rs.Tracer(layers_scene(), "brute", "cuda")


@pytest.fixture
def oracle():
    return rs.Tracer(layers_scene(), "brute")


def assert_same_hits(ours, theirs):
    for name in COLUMNS:
        assert_same_bits(getattr(ours.host(), name), getattr(theirs, name))


def test_filtered_answers_stay_on_the_device(tracer, oracle, rays, there):
    filtered = {"on_hit": one_in_five}
    hits = tracer.first_hit(*there, **filtered)
    assert isinstance(hits, DeviceHits)
    assert_same_hits(hits, oracle.first_hit(*rays, **filtered))
    seen, counts = tracer.any_hit(*there, **filtered), tracer.count_hits(*there, **filtered)
    assert_same_bits(seen.host(), oracle.any_hit(*rays, **filtered))
    assert_same_bits(counts.host(), oracle.count_hits(*rays, **filtered))
    for most in (None, 3, 0):
        many = tracer.multi_hit(*there, max_hits=most, **filtered)
        assert isinstance(many, DeviceMultiHits)
        expected = oracle.multi_hit(*rays, max_hits=most, **filtered)
        assert_same_bits(many.ray_splits.host(), expected.ray_splits)
        assert_same_hits(many, expected)


@pytest.mark.parametrize("kind", ["host", "int32", "int64", "several"])
def test_triangles_are_skipped(gpu, tracer, oracle, rays, there, kind):
    nearest = oracle.first_hit(*rays).prim_id
    skipped = (
        np.stack([nearest, np.full_like(nearest, -1)], axis=-1) if kind == "several" else nearest
    )
    given = skipped
    if kind != "host":
        given = gpu.upload("skips", skipped.astype("int32" if kind == "int32" else "int64"))
    hits = tracer.first_hit(*there, skip_prim_ids=given)
    assert_same_hits(hits, oracle.first_hit(*rays, skip_prim_ids=skipped))
    assert (hits.host().prim_id != nearest)[nearest >= 0].all()


def test_numbers_beyond_int32_are_no_triangles(gpu, tracer, oracle, rays, there):
    nearest = oracle.first_hit(*rays)
    given = gpu.upload("skips", nearest.prim_id.astype(np.int64) + 2**32)
    assert_same_hits(tracer.first_hit(*there, skip_prim_ids=given), nearest)


def test_a_payload_is_made_or_changed_where_it_is(gpu, tracer, oracle, rays, there):
    made = tracer.trace(*there, on_hit=fold, payload=RECORD)
    expected = oracle.trace(*rays, on_hit=fold, payload=RECORD)
    assert isinstance(made, DeviceArray)
    assert (made.host() == expected).all()
    assert tracer.trace(*there, on_hit=fold, payload=made) is made  # continues from its tenth hit
    again = oracle.trace(*rays, on_hit=fold, payload=expected)
    assert (made.host() == again).all()
    own = np.arange(20.0).reshape(4, 5, 1)
    placed, on_host = gpu.upload("payload", own), own.copy()
    assert tracer.trace(*there, on_hit=add_up, payload=placed) is placed
    assert tracer.trace(*there, on_hit=add_up, payload=on_host) is on_host
    expected = oracle.trace(*rays, on_hit=add_up, payload=own)
    assert_same_bits(placed.host(), expected)
    assert_same_bits(on_host, expected)
    assert tracer.trace(*there, on_hit=lambda hit, payload: None) is None


def test_no_rays_at_all(gpu, tracer):
    none = gpu.upload("rays", np.zeros((0, 3), np.float32))
    assert tracer.first_hit(none, none, on_hit=one_in_five).host().t.shape == (0,)
    assert len(tracer.multi_hit(none, none, on_hit=one_in_five).t) == 0
    assert tracer.trace(none, none, on_hit=add_up, payload=int).host().shape == (0,)


def test_what_cannot_be(gpu, tracer, there):
    shape = (4, 5)
    with pytest.raises(TypeError, match=r"^is_other: cannot run on the GPU.*addresses on the host"):
        tracer.first_hit(*there, on_hit=Bound(is_other, (1,), np.zeros(1)))
    with pytest.raises(TypeError, match=r"^skip_prim_ids: expected int32 or int64 on a GPU"):
        tracer.first_hit(*there, skip_prim_ids=gpu.upload("skips", np.zeros(shape)))
    with pytest.raises(ValueError, match=r"^skip_prim_ids: expected the rays' shape \(4, 5\)"):
        tracer.first_hit(*there, skip_prim_ids=gpu.upload("skips", np.zeros(4, np.int32)))
    with pytest.raises(ValueError, match=r"^payload: expected the rays' shape \(4, 5\)"):
        tracer.trace(*there, on_hit=add_up, payload=gpu.upload("payload", np.zeros(4)))
    with pytest.raises(TypeError, match=r"^payload: programs cannot compute with dtype float16"):
        tracer.trace(
            *there, on_hit=add_up, payload=gpu.upload("payload", np.zeros(shape, np.float16))
        )
    with pytest.raises(TypeError, match=r"^add_up: takes \(hit, payload\); expected \(hit\)"):
        tracer.first_hit(*there, on_hit=add_up)
    with pytest.raises(ValueError, match=r"^order: expected"):
        tracer.trace(*there, on_hit=add_up, payload=int, order="back")
