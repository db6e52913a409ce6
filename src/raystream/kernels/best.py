"""The nearest hits of rays that are traced together, and the rule by which a hit is kept.

Those of single rays are kept by the same order: `kernels.search`.

A hit is kept by its reported t, then by the number of its triangle; `told` is a reported t. In a
scene without instances, that is t in the tree's space; in an instance, t in world space.
`Best.first_id` says which, when a kernel is compiled: see there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    count_trailing_zeros,
    f32x16,
    i32x16,
    mask_bits,
    maximum,
    minimum,
    narrow,
    select,
    widen,
)
from raystream.jit.views import view
from raystream.kernels.hit_filter import RayFilter, keeps
from raystream.kernels.ray import local_limit, world_t
from raystream.kernels.search import is_before

_LARGEST = np.float32(np.finfo(np.float32).max)


class LanesFilter(NamedTuple):
    """The filter of the hits of 16 rays.

    Attributes
    ----------
    kept : device function
        ``kept(filter, taken, t, u, v, number, group, g)`` is the mask of the lanes whose hits with
        a triangle exist.
    filter : NamedTuple
    group : view of Group
        The rays.
    g : uint64
        The group's index, as the filter counts groups.
    """

    kept: Any
    filter: Any
    group: Any
    g: np.uint64


class Best(NamedTuple):
    """Where the nearest hits of 16 rays so far are: for all at once, or with a lane index.

    Attributes
    ----------
    ray : view
        See `best_views`. With ``limit``: beyond this t, in the tree's space, no hit is wanted. In
        an instance also with ``t_scale`` and ``t_offset``, which give the reported t.
    hit : view
        With the reported ``t``, ``prim_id``, ``u`` and ``v``. In a scene without instances, ``t``
        and ``limit`` are one field.
    first_id : int32 or None
        In an instance, the number of the object's first triangle, see `search.InstanceRay`. None
        in a scene without instances.
    filter : LanesFilter, RayFilter or None
        Decides which hits exist: of 16 rays, or of one.
    wants_any : bool
        Any hit ends the search of its ray.
    """

    ray: Any
    hit: Any
    first_id: np.int32 | None
    filter: LanesFilter | RayFilter | None
    wants_any: bool


def best_views(record: np.dtype[Any], **names: str) -> tuple[Any, Any]:
    """Make the views of a record that a `Best` has: of vectors, and with a lane index.

    Parameters
    ----------
    record : dtype
        With ``prim_id``, ``u`` and ``v``; each is a vector, or one number.
    **names : str
        The fields that are ``limit``, ``t`` and, in an instance, ``t_scale`` and ``t_offset``;
        also others by another name. One may have several names.
    """
    names |= {"prim_id": "prim_id", "u": "u", "v": "v"}
    fields = [record[name] for name in names.values()]
    offsets = [record.fields[name][1] for name in names.values()]  # type: ignore[index]
    own = {"names": list(names), "offsets": offsets, "itemsize": record.itemsize}
    lanes = [(field.base, (*(field.shape or (1,)), 1)) for field in fields]
    return view({**own, "formats": fields}), view({**own, "formats": lanes})


@device
def _told_lanes(first_id, ray, t):
    if first_id is None:
        return t
    # As `kernels.ray.world_t`.
    world = narrow(widen(t) * ray.t_scale + ray.t_offset)
    return minimum(maximum(world, f32x16(-_LARGEST)), f32x16(_LARGEST))


@device
def _told(first_id, ray, k, t):
    if first_id is None:
        return t
    return world_t(t, ray.t_scale[k], ray.t_offset[k])


@device
def _number(first_id, prim_id):
    if first_id is None:
        return prim_id
    return np.int32(prim_id + first_id)


@device
def far_limits(told, t_scale, t_offset):
    """Distances in object space beyond which every reported t is more than `told`.

    Not the least ones, as of `kernels.ray.local_limit`: reported distances decide what is kept.
    """
    t = widen(told)
    slack = absolute(t) * 2.0**-22 + absolute(t_offset) * 2.0**-48 + 2.0**-147
    near = narrow((t + slack - t_offset) / t_scale)
    far = near + absolute(near) * np.float32(2.0**-22) + np.float32(2.0**-140)
    return select(told >= _LARGEST, f32x16(INF_F32), far)


@device
def shorten_lanes(first_id, ray, taken, told, wants_any):
    """End the searches of some lanes at hits with a reported t; see `Best` for the rest."""
    limit = ray.limit
    if wants_any:
        far = f32x16(-INF_F32)
    elif first_id is None:
        far = told
    else:
        far = minimum(far_limits(told, ray.t_scale, ray.t_offset), limit)
    ray.limit = select(taken, far, limit)


@device
def shorten_ray(first_id, ray, k, told, wants_any):
    """The same for ray k."""
    if wants_any:
        ray.limit[k] = -INF_F32
    elif first_id is None:
        ray.limit[k] = told
    else:
        ray.limit[k] = min(local_limit(told, ray.t_scale[k], ray.t_offset[k]), ray.limit[k])


@device
def _kept_lanes(filter_, taken, t, u, v, number):
    if filter_ is None:
        return taken
    return filter_.kept(filter_.filter, taken, t, u, v, number, filter_.group, filter_.g)


@device
def offer_lanes(best, taken, t, u, v, prim_id):
    """Offer the hits of 16 rays with a triangle.

    Parameters
    ----------
    best : Best
        Its views have a vector for each attribute.
    taken : mask16
        The rays that hit it, before their limits.
    t, u, v : f32x16
    prim_id : int32

    Returns
    -------
    uint64
        Bits of the rays whose hits are kept.
    """
    hit, number = best.hit, _number(best.first_id, prim_id)
    told, numbers = _told_lanes(best.first_id, best.ray, t), i32x16(number)
    nearest, kept = hit.t, hit.prim_id
    taken = taken & ((told < nearest) | ((told == nearest) & (numbers < kept)))
    if mask_bits(taken) == ZERO_U64:
        return ZERO_U64
    taken = _kept_lanes(best.filter, taken, t, u, v, number)
    bits = mask_bits(taken)
    if bits == ZERO_U64:
        return ZERO_U64
    hit.prim_id = select(taken, numbers, kept)
    if not best.wants_any:
        hit.t = select(taken, told, nearest)
        hit.u, hit.v = select(taken, u, hit.u), select(taken, v, hit.v)
    shorten_lanes(best.first_id, best.ray, taken, told, best.wants_any)
    return bits


@device
def reported_lanes(best, taken, t, u, v, prim_id):
    """Hits of 16 rays with a triangle as they are reported, for rays that take all of them.

    Parameters
    ----------
    best : Best
        Its views have a vector for each attribute; ``hit.t`` is the end of the rays' intervals.
    taken, t, u, v, prim_id
        See `offer_lanes`.

    Returns
    -------
    taken : mask16
        The rays that hit it within their intervals, unless a filter ignores the hit.
    t : f32x16
    number : int32
    """
    told, number = _told_lanes(best.first_id, best.ray, t), _number(best.first_id, prim_id)
    taken = taken & (told <= best.hit.t)
    return _kept_lanes(best.filter, taken, t, u, v, number), told, number


@device
def reported_hit(best, k, t, u, v, prim_id):
    """The same for a hit of ray k, whose `Best` has a lane index."""
    told, number = _told(best.first_id, best.ray, k, t), _number(best.first_id, prim_id)
    return told <= best.hit.t[k] and keeps(best.filter, t, u, v, number), told, number


@device
def offer_hits(best, k, bits, found, prim_ids):
    """Offer the hits of a ray with some triangles of a block; returns whether one is kept.

    Parameters
    ----------
    best : Best
        Its views have a lane index.
    k : uint64
        The ray's lane.
    bits : uint64
        Bits of the triangles that it hits, before its limit.
    found : view of leaf_block.HitLanes
    prim_ids : rows of int32
        Those of the block.
    """
    hit, is_kept = best.hit, False
    nearest, kept = hit.t[k], hit.prim_id[k]
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        t, u, v = found.t[lane], found.u[lane], found.v[lane]
        told = _told(best.first_id, best.ray, k, t)
        number = _number(best.first_id, prim_ids[lane])
        if is_before(told, number, nearest, kept) and keeps(best.filter, t, u, v, number):
            nearest, kept, is_kept = told, number, True
            if best.wants_any:
                break
            hit.u[k], hit.v[k] = u, v
    if is_kept:
        hit.prim_id[k] = kept
        if not best.wants_any:
            hit.t[k] = nearest
        shorten_ray(best.first_id, best.ray, k, nearest, best.wants_any)
    return is_kept
