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

from raystream.jit.constants import INF_F32, ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import maximum, minimum
from raystream.kernels.ray import component
from raystream.kernels.slab import box_interval
from raystream.kernels.triangle_lanes import (
    barycentrics,
    plane_distance,
    shear_vertices,
    signs_agree,
)


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
    origin, direction = (ray.ox, ray.oy, ray.oz), (ray.dx, ray.dy, ray.dz)
    sheared = shear_vertices(*in_frame, origin, (ray.sx, ray.sy))

    # Step 1: signs in float32. Those that differ, differ exactly too.
    if not signs_agree(sheared):
        return False, INF_F32, ZERO_F32, ZERO_F32

    # Step 2: edge functions in float64. All have one sign, so their sum does not cancel.
    hit, u, v = barycentrics(sheared, surfaces)
    if not hit:
        return False, INF_F32, ZERO_F32, ZERO_F32

    # Step 3: the distance to the plane, clamped. (Edge-on it is not finite; the clamp turns a NaN
    # into t_in.) Adding zero turns -0 into 0.
    t_in, t_out = _own_interval(ray, a, b, c)
    t = minimum(maximum(plane_distance(*in_frame, origin, direction), t_in), t_out) + ZERO_F32
    return t_in <= t_out, t, u, v
