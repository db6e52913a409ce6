"""A ray in float64, prepared for the tests of boxes and triangles.

Triangles are tested in world space with the numbers that the caller gave. Boxes are in the scene's
local frame, in float32; their distances are computed in float64, with bounds of the rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import INVALID, VALID
from raystream.jit.constants import INF_F64, ONE_F64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    maximum,
    minimum,
    select,
)
from raystream.kernels.ray import (
    MOST_COORDINATE,
    WorldRay,
    are_within,
    is_valid,
    largest,
    length_power,
    scaled,
    scaled_slowly,
    slab_constants,
    to_frame,
)
from raystream.structures.bvh.node_layout import BOX_FLIP, NODE_AXIS

#: Coordinates of smaller magnitude, and components of directions smaller than this part of the
#: largest one, count as 0: products of their rounding errors would leave float64.
LEAST = 2.0**-200

#: Boxes are padded by this part of the scene's and the origin's largest coordinates together:
#: the origin is rounded twice, the reciprocal direction twice, and the distance twice, which is
#: less than 8 units of 2**-53; and clamped directions, see below.
_PAD = 2.0**-49

#: Direction components are clamped to this in tests of boxes, where the largest is at least 1: over
#: the distance to the scene's far end such a ray moves by less than the padding.
_TINY = 2.0**-56

#: Limits are widened by this part for boxes: a distance that is rounded to the limit may exceed it.
_SLACK = 2.0**-50

#: Biased exponents of direction lengths that one product scales to [1, 2).
LEAST_EXPONENT, MOST_EXPONENT = np.int64(1023 - 900), np.int64(1023 + 900)

_LARGEST = np.float64(np.finfo(np.float64).max)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)

#: An axis of `Float64Ray.inv`, `near` and `far`, and of a node's planes.
_Triple = tuple[np.float64, np.float64, np.float64]


class Line(NamedTuple):
    """What the tests of triangles take of a ray.

    Attributes
    ----------
    origin : triple of float64
        World space.
    direction : triple of float64
        The largest component is in [1, 2): a power of two times the given one.
    t_min, t_max : float64
        Closed interval in lengths of `direction`; empty for an invalid ray.
    """

    origin: _Triple
    direction: _Triple
    t_min: np.float64
    t_max: np.float64


class Lengths(NamedTuple):
    """The length of a `Line.direction` in given lengths, as of `Float64Ray`."""

    half: np.float64
    rest: np.float64


class Float64Ray(NamedTuple):
    """A ray, all along the world's axes.

    Attributes
    ----------
    line : Line
    half, rest : float64
        Powers of two whose product is the length of `direction` in given lengths.
    planes : triple of uint64
        Offsets of the planes that the ray enters by in a node.
    inv, near, far : triple of float64
        The distance to a plane is fma(plane, inv, near), and to one behind fma(plane, inv, far).
    status : uint8
        A `RayStatus`.
    """

    line: Line
    half: np.float64
    rest: np.float64
    planes: tuple[np.uint64, np.uint64, np.uint64]
    inv: _Triple
    near: _Triple
    far: _Triple
    status: np.uint8


@device
def reported(t, ray):
    """Distances in the lengths of the given directions, of a ray or a group of rays."""
    # A distance beyond float64 is still a hit: only a miss is infinite.
    return minimum(maximum(t * ray.half * ray.rest, -_LARGEST), _LARGEST)


@device
def widened_near(t):
    """The limit below which boxes are left out, for the limit `t` of hits."""
    return t - abs(t) * _SLACK


@device
def widened_far(t):
    """The limit above which boxes are left out, for the limit `t` of hits."""
    return t + abs(t) * _SLACK


@device
def _kept(x):
    return select(absolute(x) >= LEAST, x, ZERO_F64)


@device
def without_least(x):
    """A triple of numbers or vectors, with 0 for the smallest, see `LEAST`; also for NaN."""
    return _kept(x[0]), _kept(x[1]), _kept(x[2])


@device
def _first_planes(axis, inv):
    """Offset of the planes of an axis that a ray enters by; see `node_layout.plane_offset`."""
    return axis * NODE_AXIS + (BOX_FLIP if inv < ZERO_F64 else ZERO_U64)


@device
def usual_line(ray):
    """The line of a `WorldRay`, or of sixteen, if one product scales it.

    Returns
    -------
    is_so : bool or mask
    line : Line
    half : float64
        See `Float64Ray`, where `rest` is 1.
    """
    is_usual, half, inverse = length_power(ray.direction, LEAST_EXPONENT, MOST_EXPONENT)
    # Written so that a NaN fails.
    is_usual = is_usual & are_within(ray.origin, MOST_COORDINATE)
    is_usual = is_usual & (ray.t_min == ray.t_min) & (ray.t_max == ray.t_max)
    direction = without_least(scaled(ray.direction, half))
    limits = ray.t_min * inverse, ray.t_max * inverse
    return is_usual, Line(without_least(ray.origin), direction, *limits), half


@device_call
def _unusual_line(ray):
    """The line of a ray that is not valid, or whose length one product does not scale."""
    no_inline()
    status = VALID
    if not is_valid(ray):
        status = INVALID
        no_origin, some = (ZERO_F64, ZERO_F64, ZERO_F64), (ONE_F64, ONE_F64, ONE_F64)
        ray = WorldRay(no_origin, some, INF_F64, -INF_F64)
    half, rest, direction = scaled_slowly(ray.direction)
    limits = ray.t_min / half / rest, ray.t_max / half / rest
    line = Line(without_least(ray.origin), without_least(direction), *limits)
    return line, half, rest, status


@device
def make_line(ray):
    """Make the line of a ray.

    Parameters
    ----------
    ray : WorldRay
        With limits in float64.

    Returns
    -------
    line : Line
    half, rest : float64
        See `Float64Ray`.
    status : uint8
    """
    is_so, line, half = usual_line(ray)
    if is_so:
        return line, half, ONE_F64, VALID
    return _unusual_line(ray)


@device_call
def prepare_float64(ray, frame):
    """Prepare a ray.

    Parameters
    ----------
    ray : WorldRay
        With limits in float64.
    frame : SceneFrame

    Returns
    -------
    Float64Ray
    """
    no_inline()
    line, half, rest, status = make_line(ray)
    return ray_of_line(line, half, rest, status, frame)


@device
def ray_of_line(line, half, rest, status, frame):
    """The ray of a line; see `make_line` for the arguments."""
    local = to_frame(line.origin, frame)
    pad = _PAD * (np.float64(frame.max_coordinate) + largest(local))
    inv, near, far = slab_constants(local, line.direction, _TINY, pad, frame.inverse_scale)
    return Float64Ray(
        line,
        half,
        rest,
        (_first_planes(_X, inv[0]), _first_planes(_Y, inv[1]), _first_planes(_Z, inv[2])),
        inv,
        near,
        far,
        status,
    )
