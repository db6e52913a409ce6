"""Winding numbers by a tree of triangles: far groups by an expansion, with a bound of its error.

Barill et al. [1]_ sum the triangles of a group that is far away by the first three terms of the
expansion of its field about one point. Here each group also has a bound of the terms left out, so
a winding number comes with a bound of its error.

**The bound.** From a point q, a piece of surface at p + h with area vector V adds
``V . grad(1 / r) / 4 pi``, up to sign, where ``r = |p + h - q|``. The term of degree k of its
expansion in h is, by Legendre's polynomials, at most ``(k + 1) |h|**k / R**(k + 2) |V|``, where
``R = |p - q|``. With ``|h| <= a < R``, the terms from the third on are together at most
``|h|**3 |V| (4 - 3 x) / (R**5 (1 - x)**2)``, where ``x = a / R``. The integral of ``|h|**3`` over a
triangle is at most its area times the mean over its corners, since the cube is convex.

References
----------
.. [1] Barill, Dickson, Schmidt, Levin and Jacobson, "Fast Winding Numbers for Soups and Clouds",
   ACM Transactions on Graphics 37(4), 2018.
"""

from __future__ import annotations

import math
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, all_lanes, f64x8, load, scratch, square_root, store
from raystream.jit.threads import parallel_for
from raystream.kernels.morton import spread_numbers
from raystream.kernels.point_order import order_points
from raystream.kernels.vectors import corner_of, cross, dot, minus
from raystream.kernels.winding import LANES, add_triangle

#: Triangles of a leaf: at least half of it.
_LEAF = 8

#: Numbers of a node: its centre, its radius about that, the integral of the third power of the
#: distance from it and the area; the first three moments of the area vectors, of which only the
#: symmetric parts count: 3, 6 and 10 numbers.
_NUMBERS = 25

#: Work of a call of the kernel that makes nodes, in triangles: some milliseconds.
_WORK = 1 << 16

#: Bits of a Morton key along each axis.
_KEY_BITS = 21

#: The rounding of an expansion is less than this much of its largest term's bound, and that of the
#: exact part less than this much for each triangle.
_ROUNDING = 2.0**-44
_ROUNDING_EACH = 2.0**-50

_U8 = np.uint64(LANES)
_X, _Y, _Z, _E = np.uint64(0), np.uint64(64), np.uint64(128), np.uint64(192)
_0, _1 = np.float64(0.0), np.float64(1.0)


class WindingTree(NamedTuple):
    """A binary tree of a scene's triangles, in depth-first order.

    Attributes
    ----------
    corners : ndarray of shape (A, 3, 3), float32
        The triangles that count, along a Morton curve; local frame.
    nodes : ndarray of shape (M, 25), float64
    links : ndarray of shape (M, 3), int64
        First and after the last triangle, and the node after the subtree; a leaf's is the next one.
    """

    corners: NDArray[np.float32]
    nodes: NDArray[np.float64]
    links: NDArray[np.int64]


_known: WeakKeyDictionary[Triangles, WindingTree] = WeakKeyDictionary()


def winding_tree_of(triangles: Triangles) -> WindingTree:
    """Make the tree of a triangle store, once; it must have triangles that can be hit."""
    found = _known.get(triangles)
    if found is None:
        found = _known[triangles] = _make_tree(triangles)
    return found


def _make_tree(triangles: Triangles) -> WindingTree:
    corners = triangles.corners[triangles.prim_ids]
    corners = np.ascontiguousarray(corners[_morton_order(corners)])
    depth = max(math.ceil(math.log2(len(corners) / _LEAF)), 0)
    count = 2 ** (depth + 1) - 1
    tree = WindingTree(corners, np.empty((count, _NUMBERS)), np.empty((count, 3), np.int64))
    for level in range(depth + 1):

        def body(begin: int, end: int, level: int = level) -> None:
            _make_nodes(begin, end, level, depth, tree)

        parallel_for(body, 2**level, max(_WORK * 2**level // len(corners), 1))
    return tree


def _morton_order(corners: NDArray[np.float32]) -> NDArray[np.int64]:
    """The order of the triangles' centres along a Morton curve."""
    centers = corners.sum(axis=1, dtype=np.float64)
    low = centers.min(axis=0)
    size = float((centers.max(axis=0) - low).max()) or 1.0
    cells = ((centers - low) * ((2**_KEY_BITS - 1) / size)).astype(np.uint64)
    keys = np.zeros(len(cells), np.uint64)
    for axis in range(3):
        keys |= spread_numbers(cells[:, axis]) << np.uint64(axis)
    return np.argsort(keys, kind="stable")


@device
def _plus(p, q):
    return p[0] + q[0], p[1] + q[1], p[2] + q[2]


@device
def _scaled(p, by):
    return p[0] * by, p[1] * by, p[2] * by


@device
def _area_vector(a, b, c):
    return _scaled(cross(minus(b, a), minus(c, a)), 0.5)


@device
def _center_of(corners, first, last):
    """The centre of area of some triangles, and their area."""
    total, center = 0.0, (0.0, 0.0, 0.0)
    for k in range(first, last):
        a, b, c = corner_of(corners, k, 0), corner_of(corners, k, 1), corner_of(corners, k, 2)
        vector = _area_vector(a, b, c)
        area = math.sqrt(dot(vector, vector))
        total += area
        center = _plus(center, _scaled(_plus(_plus(a, b), c), area))
    if total > 0.0:
        return _scaled(center, 1.0 / (3.0 * total)), total
    return corner_of(corners, first, 0), total


@device
def _add_moments(node, a, b, c, vector):
    """Add a triangle's moments about the origin of its corners to a node's."""
    total = _plus(_plus(a, b), c)
    x, y, z = vector
    node[6] += x
    node[7] += y
    node[8] += z
    # The integral of h_i n_j, symmetric part.
    p, q, r = _scaled(total, 1.0 / 3.0)
    node[9] += p * x
    node[10] += q * y
    node[11] += r * z
    node[12] += 0.5 * (p * y + q * x)
    node[13] += 0.5 * (p * z + r * x)
    node[14] += 0.5 * (q * z + r * y)
    # The integral of h_i h_j n_k, symmetric part.
    xx = (a[0] * a[0] + b[0] * b[0] + c[0] * c[0] + total[0] * total[0]) / 12.0
    yy = (a[1] * a[1] + b[1] * b[1] + c[1] * c[1] + total[1] * total[1]) / 12.0
    zz = (a[2] * a[2] + b[2] * b[2] + c[2] * c[2] + total[2] * total[2]) / 12.0
    xy = (a[0] * a[1] + b[0] * b[1] + c[0] * c[1] + total[0] * total[1]) / 12.0
    xz = (a[0] * a[2] + b[0] * b[2] + c[0] * c[2] + total[0] * total[2]) / 12.0
    yz = (a[1] * a[2] + b[1] * b[2] + c[1] * c[2] + total[1] * total[2]) / 12.0
    node[15] += xx * x
    node[16] += yy * y
    node[17] += zz * z
    node[18] += (xx * y + 2.0 * xy * x) / 3.0
    node[19] += (xx * z + 2.0 * xz * x) / 3.0
    node[20] += (yy * x + 2.0 * xy * y) / 3.0
    node[21] += (yy * z + 2.0 * yz * y) / 3.0
    node[22] += (zz * x + 2.0 * xz * z) / 3.0
    node[23] += (zz * y + 2.0 * yz * z) / 3.0
    node[24] += (xy * z + xz * y + yz * x) / 3.0


@device
def _place_of(level, number, depth):
    """Where a node is in depth-first order."""
    place = np.int64(0)
    for k in range(level):
        is_right = (number >> (level - 1 - k)) & 1
        place += 1 + is_right * ((np.int64(1) << (depth - k)) - 1)
    return place


@kernel
def _make_nodes(begin, end, level, depth, tree):
    """Make the nodes begin to end of a level."""
    total = np.int64(len(tree.corners))
    for number in range(begin, end):
        first, last = (number * total) >> level, ((number + 1) * total) >> level
        place = _place_of(level, number, depth)
        tree.links[place, 0], tree.links[place, 1] = first, last
        tree.links[place, 2] = place + (np.int64(1) << (depth - level + 1)) - 1
        node = tree.nodes[place]
        node[:] = 0.0
        center, area = _center_of(tree.corners, first, last)
        radius, third = 0.0, 0.0
        for k in range(first, last):
            a = minus(corner_of(tree.corners, k, 0), center)
            b = minus(corner_of(tree.corners, k, 1), center)
            c = minus(corner_of(tree.corners, k, 2), center)
            vector = _area_vector(a, b, c)
            of_a, of_b, of_c = math.sqrt(dot(a, a)), math.sqrt(dot(b, b)), math.sqrt(dot(c, c))
            radius = max(radius, max(of_a, max(of_b, of_c)))
            cubes = of_a * of_a * of_a + of_b * of_b * of_b + of_c * of_c * of_c
            third += math.sqrt(dot(vector, vector)) * cubes / 3.0
            _add_moments(node, a, b, c, vector)
        node[0], node[1], node[2] = center
        node[3], node[4], node[5] = radius * (1.0 + _ROUNDING), third * (1.0 + _ROUNDING), area


@device
def _far(node, point, opening):
    """Whether a group is far from all eight points, its sum there, and the bound of its error.

    Both are to be divided by 4 pi.
    """
    d = node[0] - point[0], node[1] - point[1], node[2] - point[2]
    squared = dot(d, d)
    r = square_root(squared)
    if not all_lanes(r * opening > node[3]):
        return False, squared, squared
    inv = _1 / squared
    inv3 = inv / r
    beyond = r - node[3]
    error = node[4] * (np.float64(4.0) * r - np.float64(3.0) * node[3]) * inv * inv
    error = error / (beyond * beyond) + node[5] * inv * np.float64(_ROUNDING)
    x, y, z = d
    first = node[6] * x + node[7] * y + node[8] * z
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    trace = node[9] + node[10] + node[11]
    second = node[9] * xx + node[10] * yy + node[11] * zz
    second = second + np.float64(2.0) * (node[12] * xy + node[13] * xz + node[14] * yz)
    third = node[15] * (xx * x) + node[16] * (yy * y) + node[17] * (zz * z)
    mixed = node[18] * (xx * y) + node[19] * (xx * z) + node[20] * (yy * x)
    mixed = mixed + node[21] * (yy * z) + node[22] * (zz * x) + node[23] * (zz * y)
    third = third + np.float64(3.0) * mixed + np.float64(6.0) * node[24] * (xy * z)
    along = (node[15] + node[20] + node[22]) * x + (node[18] + node[16] + node[23]) * y
    along = along + (node[19] + node[21] + node[17]) * z
    total = first + trace - np.float64(3.0) * inv * second
    total = total + inv * (np.float64(7.5) * inv * third - np.float64(4.5) * along)
    return True, total * inv3, error


@kernel
def tree_winding_numbers(begin, end, points, tree, opening, numbers, errors, memory):
    """Compute the winding numbers of points begin to end, and bounds of their errors.

    Parameters
    ----------
    begin, end : int
    points : ndarray of shape (N, 3), float64
        Local frame, finite.
    tree : WindingTree
    opening : float64
        Below 1: a group whose radius is at most this much of its distance is expanded.
    numbers, errors : ndarray of shape (N,), float64
        Written.
    memory : int
        Address of `order_bytes` bytes.
    """
    lanes = scratch(256)
    first, last = np.uint64(begin), np.uint64(end)
    order = order_points(address(points), first, last, np.uint64(memory))
    node_count = len(tree.nodes)
    rounding = _ROUNDING_EACH * np.float64(len(tree.corners))
    at = first
    while at < last:
        for k in range(_U8):
            number = min(at + k, last - ONE_U64) - first
            i = first + np.uint64(load(np.uint32, order + (number << SHIFT_32)))
            to = lanes + (k << SHIFT_64)
            store(to + _X, points[i, 0])
            store(to + _Y, points[i, 1])
            store(to + _Z, points[i, 2])
        point = load(f64x8, lanes + _X), load(f64x8, lanes + _Y), load(f64x8, lanes + _Z)
        angle = f64x8(_1), f64x8(_0), f64x8(_0)
        total, error = f64x8(_0), f64x8(_0)
        place = 0
        while place < node_count:
            is_far, of_group, bound = _far(tree.nodes[place], point, opening)
            beyond = tree.links[place, 2]
            if is_far:
                total, error = total + of_group, error + bound
                place = beyond
                continue
            place += 1
            if place == beyond:
                own = place - 1
                for k in range(tree.links[own, 0], tree.links[own, 1]):
                    angle = add_triangle(angle, tree.corners, k, point)
        store(lanes + _X, angle[0])
        store(lanes + _Y, angle[1])
        store(lanes + _Z, angle[2] + total / np.float64(4.0 * math.pi))
        store(lanes + _E, error / np.float64(4.0 * math.pi))
        for k in range(min(_U8, last - at)):
            i = first + np.uint64(load(np.uint32, order + ((at + k - first) << SHIFT_32)))
            to = lanes + (k << SHIFT_64)
            # Adding zero turns -0 into 0: the argument of a negative number is pi.
            imaginary = load(np.float64, to + _Y) + _0
            part = math.atan2(imaginary, load(np.float64, to + _X)) / (2.0 * math.pi)
            numbers[i] = part + load(np.float64, to + _Z)
            errors[i] = load(np.float64, to + _E) + rounding
        at += _U8
