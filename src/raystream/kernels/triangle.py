"""The triangle test: watertight, and the same bits on every device.

The ray's frame has the ray as its z axis. A vertex goes there by a translation and a shear,
whose result (its image) depends on the vertex and the ray alone; so triangles that share a
vertex or an edge see the same numbers, and no ray slips between them. The edge functions
U, V, W are the orientations of two images with the origin. Rounding is monotone, so the sign
that float32 gives to a difference of two products is right unless it gives exactly zero; that
culls most triangles. The barycentrics of the others are computed in float64, where products of
float32 numbers are exact: on a thin triangle the float32 differences keep their sign but not
their size. No multiply-add may be fused here: it would round the two products of an edge
differently, and the two triangles at the edge would disagree.

Sources: Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", Journal of Computer
Graphics Techniques 2(1), 2013. The sign argument, the float64 barycentrics and the clamp to the
triangle's own box are ours: see docs/decisions.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F32, ZERO_F32
from raystream.jit.cpu import device, device_call
from raystream.kernels.ray import component
from raystream.kernels.slab import box_interval


@device
def _edge(ax, ay, bx, by):
    """Twice the signed area of the triangle (origin, b, a), in the frame's x and y."""
    return ax * by - ay * bx


@device
def _top_left_sign(ax, ay, bx, by):
    """Sign of a zero edge function once the ray moves by (e, e*e), e to 0: the top-left rule."""
    return ay - by if ay != by else bx - ax


@device
def _own_interval(ray, a, b, c):
    """The padded slab interval of a triangle."""
    return box_interval(
        ray,
        min(a[0], b[0], c[0]),
        min(a[1], b[1], c[1]),
        min(a[2], b[2], c[2]),
        max(a[0], b[0], c[0]),
        max(a[1], b[1], c[1]),
        max(a[2], b[2], c[2]),
    )


@device
def _plane_distance(ray, a, b, c):
    """Distance to the plane of corners in the order of the frame, in float64.

    The corners' images would do for small triangles. But they are rounded at the size of the
    triangle: on a ground plane of many kilometres a distance of a metre would lose all digits.
    """
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    px, py, pz = b[0] - ax, b[1] - ay, b[2] - az
    qx, qy, qz = c[0] - ax, c[1] - ay, c[2] - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx
    along = (ax - ray.ox) * nx + (ay - ray.oy) * ny + (az - ray.oz) * nz
    return np.float32(along / (ray.dx * nx + ray.dy * ny + ray.dz * nz))


@device_call
def _owns_edge(ax, ay, bx, by, cx, cy, U, V, W):
    """Whether a ray through an edge or vertex crosses this one of the triangles there."""
    sign_u = U if U != 0.0 else _top_left_sign(cx, cy, bx, by)
    sign_v = V if V != 0.0 else _top_left_sign(ax, ay, cx, cy)
    sign_w = W if W != 0.0 else _top_left_sign(bx, by, ax, ay)
    return min(sign_u, sign_v, sign_w) > 0.0 or max(sign_u, sign_v, sign_w) < 0.0


@device
def intersect(ray, corners, i, surfaces):
    """Intersect a ray with a triangle.

    Parameters
    ----------
    ray : Ray
    corners : array of shape (A, 3, 3), float32
        Vertices of the triangles, local frame.
    i : int
        Row of `corners`.
    surfaces : bool
        Whether a ray exactly through an edge or a vertex hits every triangle there (False), or
        one per crossing of the surface (True).

    Returns
    -------
    hit : bool
        Whether the ray's line hits the triangle, at any t.
    t, u, v : float32
        Distance, clamped to the triangle's own padded slab interval, so that it lies in the
        interval of every box around the triangle; barycentric weights of vertices 1 and 2.
    """
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    in_frame = (
        (a[ray.kx], a[ray.ky], a[ray.kz]),
        (b[ray.kx], b[ray.ky], b[ray.kz]),
        (c[ray.kx], c[ray.ky], c[ray.kz]),
    )
    return _intersect(ray, a, b, c, in_frame, surfaces)


@device
def intersect_corners(ray, a, b, c, surfaces):
    """Like `intersect`, with the corners as tuples of three float32, local frame."""
    kx, ky, kz = ray.kx, ray.ky, ray.kz
    in_frame = (
        (component(kx, *a), component(ky, *a), component(kz, *a)),
        (component(kx, *b), component(ky, *b), component(kz, *b)),
        (component(kx, *c), component(ky, *c), component(kz, *c)),
    )
    return _intersect(ray, a, b, c, in_frame, surfaces)


@device
def _intersect(ray, a, b, c, in_frame, surfaces):
    """The test, with corners in the order of the axes and in the frame's."""
    p, q, r = in_frame
    az = p[2] - ray.oz
    bz = q[2] - ray.oz
    cz = r[2] - ray.oz
    ax = (p[0] - ray.ox) - ray.sx * az
    ay = (p[1] - ray.oy) - ray.sy * az
    bx = (q[0] - ray.ox) - ray.sx * bz
    by = (q[1] - ray.oy) - ray.sy * bz
    cx = (r[0] - ray.ox) - ray.sx * cz
    cy = (r[1] - ray.oy) - ray.sy * cz

    # Step 1: signs in float32. Those that differ, differ exactly too.
    U = _edge(cx, cy, bx, by)
    V = _edge(ax, ay, cx, cy)
    W = _edge(bx, by, ax, ay)
    if min(U, V, W) < ZERO_F32 and max(U, V, W) > ZERO_F32:
        return False, INF_F32, ZERO_F32, ZERO_F32

    # Step 2: edge functions in float64. All have one sign, so their sum does not cancel.
    ax, ay, bx = np.float64(ax), np.float64(ay), np.float64(bx)
    by, cx, cy = np.float64(by), np.float64(cx), np.float64(cy)
    U = _edge(cx, cy, bx, by)
    V = _edge(ax, ay, cx, cy)
    W = _edge(bx, by, ax, ay)
    low, high = min(U, V, W), max(U, V, W)
    if low <= 0.0 and high >= 0.0:
        if low < 0.0 and high > 0.0:
            return False, INF_F32, ZERO_F32, ZERO_F32
        if low == 0.0 and high == 0.0:  # seen edge-on
            return False, INF_F32, ZERO_F32, ZERO_F32
        if surfaces and not _owns_edge(ax, ay, bx, by, cx, cy, U, V, W):
            return False, INF_F32, ZERO_F32, ZERO_F32
    scale = 1.0 / (U + V + W)

    # Step 3: the distance to the plane, clamped. (Edge-on it is not finite; the clamp turns a NaN
    # into t_in.) Adding zero turns -0 into 0.
    t = _plane_distance(ray, p, q, r)
    t_in, t_out = _own_interval(ray, a, b, c)
    t = t if t > t_in else t_in
    t = (t if t < t_out else t_out) + ZERO_F32
    return t_in <= t_out, t, np.float32(V * scale) + ZERO_F32, np.float32(W * scale) + ZERO_F32
