"""Clipping boxes to a triangle's plane, compared with the plane in float64."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.structures.clip import clip_to_plane


@kernel
def tightened(corners, bound, box):
    return clip_to_plane(address(corners), bound, address(box))


def tighten_box(corners, bound, low, high):
    """Whether the plane overlaps the box, and the clipped box."""
    box = np.array([low, high], np.float32)
    meets = tightened(np.array(corners, np.float32), np.float64(bound), box)
    return meets, box.tolist()


@pytest.mark.parametrize("axis", range(3))
def test_a_plane_beside_a_box_is_as_near_as_the_bound_says(axis):
    """A box from 0 to 1 along an axis, and a triangle across the axis beside it."""
    corners = np.roll([[0, 0, 0], [0, 4, 0], [0, 0, 4]], axis, axis=1).astype(float)
    for place in (-0.25, -0.125, 0.5, 1.125, 1.25):
        moved = corners.copy()
        moved[:, axis] = place
        meets, box = tighten_box(moved, 0.125, np.zeros(3), np.ones(3))
        assert meets == (-0.125 <= place <= 1.125)
        if meets:
            assert box[0][axis] == max(place - 0.125, 0.0)
            assert box[1][axis] == min(place + 0.125, 1.0)


def test_what_is_left_holds_all_that_is_near_the_plane(rng):
    """The plane is grown by the bound along each axis."""
    near_count = left_out = 0
    for _ in range(300):
        corners = rng.normal(size=(3, 3)).astype(np.float32)
        bound = 10.0 ** rng.uniform(-4, -0.5)
        low = rng.normal(size=3).astype(np.float32)
        high = low + (10.0 ** rng.uniform(-3, 0, 3)).astype(np.float32)
        a, b, c = corners.astype(np.float64)
        normal = np.cross(b - a, c - a)
        reach = bound * np.abs(normal).sum()
        ends = np.array(list(itertools.product(*zip(low, high, strict=True))), np.float64)
        off = (ends - a) @ normal
        meets, box = tighten_box(corners, bound, low, high)
        if abs(np.abs(off).min() - reach) > 1e-9 * reach or off.min() * off.max() < 0.0:
            assert meets == (off.min() <= reach and off.max() >= -reach)
        if not meets:
            left_out += 1
            continue
        points = rng.uniform(low, high, (400, 3))
        near = points[np.abs((points - a) @ normal) <= reach]
        near_count += len(near)
        assert (near >= np.array(box[0]) - 1e-6).all()
        assert (near <= np.array(box[1]) + 1e-6).all()
    assert near_count > 1000
    assert left_out > 50


def test_a_triangle_without_a_plane_keeps_its_box():
    meets, box = tighten_box([[0, 0, 0], [1, 1, 1], [2, 2, 2]], 0.01, np.full(3, 5), np.full(3, 6))
    assert meets
    assert box == [[5.0] * 3, [6.0] * 3]
