"""Overlap of a triangle and a box, exactly, for structures built as the papers build them.

Such lists are shorter than those of `clip` and `grid.overlap`, and may lack the triangle of a hit
beyond an edge, which rounding accepts; see docs/decisions/0010-grid and 0011-kdtree.

References
----------
Akenine-Möller, "Fast 3D Triangle-Box Overlap Testing", Journal of Graphics Tools 6(1), 2001: the
13 axes (Christen 2005, section 5.1.1). Havran and Bittner, "On improving kd-trees for ray
shooting", WSCG 2002, and Wald and Havran, "On building fast kd-Trees for Ray Tracing, and on doing
that in O(N log N)", 2006: "split clipping" and "perfect splits".
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load, store
from raystream.structures.clip import HIGH, SLIVER, WORD, corner_at

_SECOND, _THIRD = np.uint64(12), np.uint64(24)

#: Below this share of the normal, a component's reciprocal is too uncertain to find where a line
#: along its axis meets the plane; and the share of the bound within which such a line then counts
#: as part of the plane.
_PARALLEL, _NEAR = 2.0**-28, 2.0**-8


@device
def _is_between(p, q, reach):
    return min(p, q) <= reach and max(p, q) >= -reach


@device
def _edge_overlaps(start, end, other, half):
    """Whether no axis across an edge separates a triangle from a box around the origin.

    On an axis perpendicular to the edge, both its ends have one projection.
    """
    ex, ey, ez = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return (
        _is_between(
            ez * start[1] - ey * start[2],
            ez * other[1] - ey * other[2],
            abs(ez) * half[1] + abs(ey) * half[2],
        )
        and _is_between(
            ex * start[2] - ez * start[0],
            ex * other[2] - ez * other[0],
            abs(ex) * half[2] + abs(ez) * half[0],
        )
        and _is_between(
            ey * start[0] - ex * start[1],
            ey * other[0] - ex * other[1],
            abs(ey) * half[0] + abs(ex) * half[1],
        )
    )


@device
def edges_overlap(a, b, c, half):
    """Test the nine axes across the edges of a triangle and of a box.

    Parameters
    ----------
    a, b, c : triple of float64
        Corners, relative to the middle of the box.
    half : triple of float64
        Half the lengths of the box.

    Returns
    -------
    bool
        False if one of them separates the two. If it is true, they overlap if the box also
        overlaps the triangle's bounding box and its plane, the other four of the 13 axes.
    """
    return (
        _edge_overlaps(a, b, c, half)
        and _edge_overlaps(b, c, a, half)
        and _edge_overlaps(c, a, b, half)
    )


@device
def _joined(found, x, y, z):
    """Bounds, extended by a point."""
    return (
        (min(found[0][0], x), min(found[0][1], y), min(found[0][2], z)),
        (max(found[1][0], x), max(found[1][1], y), max(found[1][2], z)),
    )


@device
def _with_edge(found, p, q, low, high):
    """Bounds, extended by the part of an edge in a box."""
    begin, end = 0.0, 1.0
    step = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
    for k in range(3):
        if step[k] == 0.0:
            if p[k] < low[k] or p[k] > high[k]:
                end = -1.0
        else:
            one, other = (low[k] - p[k]) / step[k], (high[k] - p[k]) / step[k]
            begin, end = max(begin, min(one, other)), min(end, max(one, other))
    if begin <= end:
        for share in (begin, end):
            found = _joined(
                found, p[0] + share * step[0], p[1] + share * step[1], p[2] + share * step[2]
            )
    return found


@device
def _side(p, q, u, v, x, y):
    """Twice the area of the edge from p to q and the point (x, y), seen along an axis."""
    return (q[u] - p[u]) * (y - p[v]) - (q[v] - p[v]) * (x - p[u])


@device
def _with_line(found, k, x, y, corners, normal, box, bound):
    """Bounds, extended by where an edge of a box, at (x, y) along axis k, meets a triangle."""
    (a, b, c), (low, high) = corners, box
    u, v = (k + 1) % 3, (k + 2) % 3
    least = max(low[k], min(a[k], b[k], c[k]))
    most = min(high[k], max(a[k], b[k], c[k]))
    off = normal[u] * (x - a[u]) + normal[v] * (y - a[v])
    sides = abs(normal[u]) + abs(normal[v])
    begin, end = np.inf, -np.inf
    if abs(normal[k]) <= _PARALLEL * sides:
        is_beside = min(a[u], b[u], c[u]) <= x <= max(a[u], b[u], c[u]) and min(
            a[v], b[v], c[v]
        ) <= y <= max(a[v], b[v], c[v])
        if is_beside and abs(off) <= _NEAR * bound * sides:
            begin, end = least, most
    else:
        sign = 1.0 if normal[k] > 0.0 else -1.0
        is_inside = (
            sign * _side(a, b, u, v, x, y) >= 0.0
            and sign * _side(b, c, u, v, x, y) >= 0.0
            and sign * _side(c, a, u, v, x, y) >= 0.0
        )
        if is_inside:
            begin = end = a[k] - off / normal[k]
    if begin > most or end < least or not begin <= end:
        return found
    for at in (max(begin, least), min(end, most)):
        if k == 0:
            found = _joined(found, at, x, y)
        elif k == 1:
            found = _joined(found, y, at, x)
        else:
            found = _joined(found, x, y, at)
    return found


@device
def _shrink(box, found, k, bound):
    """Clip one axis of a box to bounds."""
    at = box + np.uint64(k) * WORD
    low = max(load(np.float32, at), np.float32(found[0][k] - bound))
    high = min(load(np.float32, at + HIGH), np.float32(found[1][k] + bound))
    if low <= high:
        store(at, low)
        store(at + HIGH, high)


@device_call
def clip_to_triangle(triangle, bound, box):
    """Shrink a reference's box to its overlap with the triangle itself.

    Parameters
    ----------
    triangle, bound, box
        See `clip.clip_to_plane`.

    Returns
    -------
    bool
        Whether the triangle overlaps the box, grown by the bound.

    Notes
    -----
    The overlap is a convex polygon. Its corners are the ends of the parts of edges in the box, and
    the points at which edges of the box meet the triangle.
    """
    a, b, c = corner_at(triangle), corner_at(triangle + _SECOND), corner_at(triangle + _THIRD)
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    normal = (py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx)
    longest = (abs(px) + abs(py) + abs(pz)) * (abs(qx) + abs(qy) + abs(qz))
    if not abs(normal[0]) + abs(normal[1]) + abs(normal[2]) > SLIVER * longest:
        return True
    low, high = corner_at(box), corner_at(box + HIGH)
    low = (low[0] - bound, low[1] - bound, low[2] - bound)
    high = (high[0] + bound, high[1] + bound, high[2] + bound)
    found = ((np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf))
    found = _with_edge(found, a, b, low, high)
    found = _with_edge(found, b, c, low, high)
    found = _with_edge(found, c, a, low, high)
    for k in range(3):
        u, v = (k + 1) % 3, (k + 2) % 3
        for x in (low[u], high[u]):
            for y in (low[v], high[v]):
                found = _with_line(found, k, x, y, (a, b, c), normal, (low, high), bound)
    if found[0][0] > found[1][0]:
        return False
    for k in range(3):
        _shrink(box, found, k, bound)
    return True
