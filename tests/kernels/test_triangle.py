"""The triangle test by hand-computed cases; agreement and watertightness are tested elsewhere."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

import raystream as rs

CORNERS = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


def tracer_of(corners):
    return rs.Tracer(rs.Scene.from_arrays(corners, [[0, 1, 2]]), "brute")


def test_distance_and_weights_by_hand():
    hits = tracer_of(CORNERS).first_hit([1, 2, 6], [0, 0, -3])
    assert (hits.t, hits.u, hits.v, hits.prim_id) == (2.0, 0.25, 0.5, 0)


@pytest.mark.parametrize("winding", list(itertools.permutations(range(3))))
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [1, -1])
def test_both_sides_all_axes_all_orders(winding, axis, side):
    corners = np.roll(np.array(CORNERS, float)[list(winding)], axis, axis=1)
    origin = np.roll([1.0, 2.0, 6.0 * side], axis)
    direction = np.roll([0.0, 0.0, -2.0 * side], axis)
    hits = tracer_of(corners).first_hit(origin, direction)
    assert hits.t == 3.0
    weights = {0: 0.25, 1: 0.25, 2: 0.5}
    assert hits.u == weights[winding[1]]
    assert hits.v == weights[winding[2]]


@pytest.mark.parametrize(
    ("target", "u", "v"),
    [
        ((0, 0), 0, 0),
        ((4, 0), 1, 0),
        ((0, 4), 0, 1),
        ((2, 0), 0.5, 0),
        ((0, 2), 0, 0.5),
        ((2, 2), 0.5, 0.5),
    ],
)
def test_corners_and_edges_belong_to_the_triangle(target, u, v):
    hits = tracer_of(CORNERS).first_hit([*target, 1], [0, 0, -1])
    assert (hits.t, hits.u, hits.v) == (1.0, u, v)
    assert not np.signbit(hits.u)
    assert not np.signbit(hits.v)


@pytest.mark.parametrize("target", [(-1, 1), (1, -1), (3, 3), (-1, -1), (5, 0), (0, 5)])
def test_outside(target):
    assert not tracer_of(CORNERS).any_hit([*target, 1], [0, 0, -1])


def test_edge_on_rays_miss():
    """In the triangle's plane there is no crossing, in any direction."""
    tracer = tracer_of(CORNERS)
    for origin in ([-1, 1, 0], [1, 1, 0], [0, 0, 0], [-1, 0, 0]):
        for direction in ([1, 0, 0], [1, 1, 0], [-1, 2, 0]):
            assert not tracer.any_hit(origin, direction, t_min=-np.inf)


def test_behind_the_origin():
    tracer = tracer_of(CORNERS)
    assert not tracer.any_hit([1, 1, -1], [0, 0, -1])
    assert tracer.first_hit([1, 1, -1], [0, 0, -1], t_min=-5).t == -1.0


def test_an_origin_on_the_triangle_hits_at_zero():
    hits = tracer_of(CORNERS).first_hit([1, 1, 0], [0.3, -0.2, 1])
    assert hits.t == 0.0
    assert not np.signbit(hits.t)


def exact_inside(corners, origin, direction):
    """Sign of each edge function, in rational numbers."""
    p = [
        [Fraction(float(x)) - Fraction(float(y)) for x, y in zip(c, origin, strict=True)]
        for c in corners
    ]
    d = [Fraction(float(x)) for x in direction]

    def volume(a, b):
        cross = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
        return sum(x * y for x, y in zip(cross, d, strict=True))

    signs = [volume(p[i], p[(i + 1) % 3]) for i in range(3)]
    return all(s >= 0 for s in signs) or all(s <= 0 for s in signs), 0 in signs


def test_signs_are_exact_where_the_frame_is():
    """Axis-parallel rays at lattice points: the shear is exact, so the answer must be too."""
    rng = np.random.default_rng(8)
    decided = zeros = 0
    for _ in range(400):
        corners = rng.integers(-40, 40, (3, 3)) / 8.0
        if not np.cross(corners[1] - corners[0], corners[2] - corners[0])[2]:
            continue
        origin = np.append(rng.integers(-40, 40, 2) / 8.0, 100.0)
        if rng.random() < 0.5:  # exactly through an edge
            share = rng.integers(0, 5) / 4
            origin[:2] = (corners[0] * (1 - share) + corners[1] * share)[:2]
        inside, on_edge = exact_inside(corners, origin, (0, 0, -1))
        assert tracer_of(corners).any_hit(origin, [0, 0, -1]) == inside
        decided += 1
        zeros += on_edge and inside
    assert decided > 300
    assert zeros > 100


def test_exactly_one_of_two_neighbours_owns_their_edge():
    """The top-left rule, for an edge turned all the way round, between two triangles."""
    for angle in np.arange(0, 360, 7.5):
        turn = np.radians(angle)
        x, y = np.float32(np.cos(turn)), np.float32(np.sin(turn))
        corners = [[0, 0, 0], [x, y, 0], [-y, x, 0], [y, -x, 0]]
        tracer = rs.Tracer(rs.Scene.from_arrays(corners, [[0, 1, 2], [0, 3, 1]]), "brute")
        ray = [x / 2, y / 2, 1], [0, 0, -1]  # halves are exact, and so is the image
        assert tracer.count_hits(*ray) == 2
        assert tracer.count_hits(*ray, crossings="surfaces") == 1
