"""Packets of flat pictures: their rows are found, and each ray is in exactly one packet."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.packets.image_rows import (
    BatchOrder,
    Cut,
    _extent,
    find_order,
    order_of,
)
from raystream.structures.bvh.packets.rays import GROUPS, PacketOrder, group_rows


@kernel
def mark_rays(packet_count, order, seen):
    """Count how often each ray is in a group."""
    for packet in range(packet_count):
        for g in range(GROUPS):
            first, count = group_rows(order, np.uint64(packet), g)
            for ray in range(first, first + count):
                seen[ray] += 1


def is_each_ray_once(order, begin=0, end=None):
    """Of the packets from one cut to another."""
    count = int(order.packets.ray_count)
    seen = np.zeros(count + 16, np.int64)
    mark_rays(order.packets.packet_count, order.packets, seen)
    return bool((seen[:count] == 1).all() and (seen[count:] == 0).all())


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.load("spheres"))


def found_order(tracer, origins, directions):
    batch = RayBatch(origins, directions)
    source, _kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    return find_order(source, len(batch), tracer.structure.frame)


def points_of(tracer, width, height):
    """Points that the camera sees right of a bay, and the directions to a light."""
    hits = tracer.first_hit(*tracer.scene.camera.rays(width, height))
    light = np.array(tracer.scene.camera.eye) + [0.5, 1.0, 0.0]
    bay = 20.0 + 15.0 * np.sin(np.arange(height) / 20.0)
    is_kept = hits.is_hit & (np.arange(width) >= bay[:, None])
    origins = hits.positions[is_kept].astype(np.float32)
    return origins, (light - origins).astype(np.float32), is_kept


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", [200, 209])
def test_the_width_of_a_flat_picture_is_found(tracer, dtype, width):
    rays = np.array(np.broadcast_arrays(*tracer.scene.camera.rays(width, 150)), dtype)
    order = found_order(tracer, *rays.reshape(2, -1, 3))
    assert int(order.packets.width) == width
    assert is_each_ray_once(order)


def test_rows_of_a_picture_with_holes_are_found(tracer):
    origins, directions, is_hit = points_of(tracer, 256, 192)
    order = found_order(tracer, origins, directions)
    assert order.bands is not None
    starts = np.concatenate([[0], np.cumsum(is_hit.sum(1))])
    firsts = order.bands[:-1, 1]
    assert np.isin(firsts, starts).mean() > 0.5
    assert is_each_ray_once(order)


def test_tiles_and_unordered_rays_stay_as_they_are(tracer, rng):
    _, directions = tracer.scene.camera.rays(256, 192)
    tiles = directions.reshape(12, 16, 16, 16, 3).swapaxes(1, 2).reshape(-1, 3)
    for rays in (tiles, rng.permutation(directions.reshape(-1, 3))):
        order = found_order(tracer, tracer.scene.camera.eye, rays)
        assert int(order.packets.width) in (0, 16)
        assert order.bands is None
        assert is_each_ray_once(order)


@given(st.lists(st.integers(1, 70), min_size=1, max_size=60), st.integers(0, 3000))
@settings(max_examples=50)
def test_each_ray_is_in_one_group_whatever_the_rows(lengths, ray):
    starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.uint64)
    order = order_of(starts)
    count = int(starts[-1])
    assert is_each_ray_once(order)
    cut = order.cut(min(ray, count))
    assert cut.ray <= min(ray, count)
    seen = np.zeros(count + 16, np.int64)
    mark_rays(cut.packet, order.packets, seen)
    assert (seen[: cut.ray] == 1).all()
    assert (seen[cut.ray :] == 0).all()


@given(st.integers(0, 300), st.integers(1, 20_000), st.integers(0, 20_000))
@settings(max_examples=50)
def test_each_ray_is_in_one_group_whatever_the_width(width, count, ray):
    order = BatchOrder(PacketOrder.of_rows(width, count))
    assert is_each_ray_once(order)
    assert order.cut(count) == Cut(order.packets.packet_count, count)
    cut = order.cut(min(ray, count))
    seen = np.zeros(count + 16, np.int64)
    mark_rays(cut.packet, order.packets, seen)
    assert (seen[: cut.ray] == 1).all()
    assert (seen[cut.ray :] == 0).all()


def test_answers_do_not_depend_on_the_order(tracer):
    """By tiles of all kinds, with parts of groups and rays of the slow path, as one by one."""
    single = rs.Tracer(tracer.scene, kernel="single")
    packet = rs.Tracer(tracer.scene, kernel="packet")
    width = 203
    rays = np.array(np.broadcast_arrays(*tracer.scene.camera.rays(width, 160)), np.float32)
    flat = rays.reshape(2, -1, 3).copy()
    flat[1, width * 5 + 190 : width * 5 + width] = np.nan  # invalid, at the end of a row
    flat[0, width * 9 + 195 : width * 9 + width] += 1e6  # far away
    origins, directions, _ = points_of(tracer, 256, 192)
    for o, d in (tuple(flat), (origins, directions)):
        for t_max in (np.inf, 1.0):
            want, got = (t.first_hit(o, d, t_max=t_max) for t in (single, packet))
            for name in ("t", "u", "v", "prim_id", "status"):
                np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
            want, got = (t.any_hit(o, d, t_max=t_max) for t in (single, packet))
            np.testing.assert_array_equal(got, want)
        want, got = (t.multi_hit(o, d) for t in (single, packet))
        for name in ("t", "prim_id", "ray_splits"):
            np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
        np.testing.assert_array_equal(packet.count_hits(o, d), single.count_hits(o, d))


def test_filters_see_the_rays_of_tiles(tracer):
    """A filter that depends on its ray, and triangles to skip, in packets of rows and of holes."""
    single = rs.Tracer(tracer.scene, kernel="single")
    packet = rs.Tracer(tracer.scene, kernel="packet")
    width = 203
    rays = np.array(np.broadcast_arrays(*tracer.scene.camera.rays(width, 160)), np.float32)
    flat = rays.reshape(2, -1, 3).copy()
    flat[0, width * 9 + 195 : width * 9 + width] += 1e6  # far away
    origins, directions, _ = points_of(tracer, 256, 192)

    def odd(hit):
        return (hit.ray * 7 + hit.prim_id) % 3 != 0

    for o, d in (tuple(flat), (origins, directions)):
        skipped = single.first_hit(o, d).prim_id
        skipped[::2] = -1
        for options in ({"on_hit": odd}, {"skip_prim_ids": skipped}):
            want, got = (t.first_hit(o, d, **options) for t in (single, packet))
            for name in ("t", "u", "v", "prim_id"):
                np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
            want, got = (t.any_hit(o, d, **options) for t in (single, packet))
            np.testing.assert_array_equal(got, want)


def test_a_short_last_row_is_not_read_beyond_its_end(tracer):
    """Behind the rays there is no number: the extent of the packets would have none."""
    width, count = 1000, 16_100
    _, directions = tracer.scene.camera.rays(width, 40)
    behind = np.full((count + 2 * width, 3), np.nan, np.float32)
    behind[:count] = directions.reshape(-1, 3)[:count]
    batch = RayBatch(tracer.scene.camera.eye, behind[:count])
    source, kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    order = PacketOrder.of_rows(width, count)
    assert np.isfinite(_extent(order, source, tracer.structure.frame))
    assert int(find_order(source, count, tracer.structure.frame).packets.width) == width
    del kept
