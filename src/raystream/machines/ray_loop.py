"""A whole renderer on the multipass machine: rays are made, traced and shaded in one loop.

The streaming ray tracer of Purcell 2002, section 3 and Figure 2: a kernel generates eye rays, the
kernels of a structure traverse and intersect, and shading gives its pixel the next ray, which goes
back to set-up in the same loop. A pixel has one ray at a time, so its records have a fixed size,
and nothing recurses (Christen 2005, section 5.2). The renderer hands over three functions,
and records and constants that only they know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32, ONE_U64, ZERO_F32
from raystream.jit.cpu import device
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import WorldRay, world_t
from raystream.kernels.ray_source import local_ray
from raystream.kernels.search import get_hit, put_hit
from raystream.machines.records import DONE, NO_ROOM, RayState
from raystream.machines.steps.base import StepKernel, Steps

#: World t = local t * scale + offset, see `kernels.ray.LocalRay`.
SPAN = np.dtype([("scale", np.float64), ("offset", np.float64)])

_STARTING = np.uint8(RayState.STARTING)
_MISS = np.int32(-1)


class NextRay(NamedTuple):
    """The next ray of a pixel, world space.

    Attributes
    ----------
    is_active : bool
        False if the pixel is finished: the rest is then ignored.
    row : uint64
        The row of the hits in which the ray's nearest hit is kept.
    origin : tuple of three float64
    direction : tuple of three float32
    t_max : float32
    """

    is_active: bool
    row: np.uint64
    origin: tuple[np.float64, np.float64, np.float64]
    direction: tuple[np.float32, np.float32, np.float32]
    t_max: np.float32


class RayLoop(NamedTuple):
    """A renderer, as the kernels of a loop need it.

    Attributes
    ----------
    begin : callable
        Device function ``(number, shading)``: the record of pixel `number`, and its eye ray as a
        `NextRay`.
    has_room : callable
        Device function ``(pixel, shading)``: whether there is room for the rays that shading
        this pixel may spawn. Otherwise it waits until all others are finished, for `grow`.
    shade : callable
        Device function ``(number, pixel, has_room, is_hit, shading)``: shades the hit of a
        pixel's ray, in the row that it named (prim_id is -1 for a miss), and returns the same as
        `begin`. Without room it returns the record as it was.
    spawns : bool
        Whether shading spawns rays; otherwise all pixels are shaded in one pass.
    pixel : dtype
        The record of a pixel between passes.
    shading : NamedTuple
        Constants of these functions: numbers and addresses.
    hits : HitAddresses
        Rows for the nearest hits, world t.
    grow : callable
        ``grow(wanted)`` makes more room for pixels, in parts that fit in memory: writes new
        numbers and rows of hits to `wanted`, and yields each part, a slice, with its loop.
    """

    begin: Callable[..., Any]
    has_room: Callable[..., Any]
    shade: Callable[..., Any]
    spawns: bool
    pixel: np.dtype[Any]
    shading: Any
    hits: HitAddresses
    grow: Callable[[NDArray[Any]], Iterator[tuple[slice, RayLoop]]]


@device
def _unchanged(ray, wanted, span):
    """Records as they are."""
    o, d = ray.origin, ray.direction
    return (
        ((o[0], o[1], o[2]), (d[0], d[1], d[2]), ray.t_min, ray.t_max),
        (wanted.first, wanted.capacity, wanted.number),
        (span.scale, span.offset),
    )


@device
def _start(new, ray, wanted, span, frame, hits):
    """The records of a pixel's next ray, and its state."""
    if not new.is_active:
        ray, wanted, span = _unchanged(ray, wanted, span)
        return ray, wanted, span, DONE
    dx, dy, dz = new.direction
    direction = np.float64(dx), np.float64(dy), np.float64(dz)
    local = local_ray(WorldRay(new.origin, direction, ZERO_F32, new.t_max), frame)
    put_hit(hits, new.row, INF_F32, ZERO_F32, ZERO_F32, _MISS)
    return (
        (local.origin, local.direction, local.t_min, local.t_max),
        (new.row, ONE_U64, wanted.number),
        (local.t_scale, local.t_offset),
        _STARTING,
    )


def _eye_rays(begin: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that gives each pixel its eye ray."""

    def eye_rays(ray, wanted, span, query, frame, shading):
        pixel, new = begin(np.uint64(wanted.number), shading)
        ray_, wanted_, span_, state = _start(new, ray, wanted, span, frame, query.hits)
        return ray_, wanted_, span_, pixel, state

    return device(eye_rays)


def _shade(has_room: Callable[..., Any], shade: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel that shades a pixel's hit, and gives it its next ray."""

    def shade_hit(ray, wanted, found, span, pixel, query, frame, shading):
        fits, is_hit = has_room(pixel, shading), found.count != np.uint32(0)
        if fits and is_hit:
            t, u, v, prim_id = get_hit(query.hits, wanted.first)
            put_hit(query.hits, wanted.first, world_t(t, span.scale, span.offset), u, v, prim_id)
        shaded, new = shade(np.uint64(wanted.number), pixel, fits, is_hit, shading)
        ray_, wanted_, span_, state = _start(new, ray, wanted, span, frame, query.hits)
        return ray_, wanted_, span_, shaded, state if fits else NO_ROOM

    return device(shade_hit)


_OUTPUTS = ("ray", "wanted", "span", "pixel")


def loop_steps(steps: Steps, loop: RayLoop) -> Steps:
    """A traversal whose shading is a renderer's."""
    function = _shade(loop.has_room, loop.shade)
    shading = StepKernel("shade", RayState.SHADING, function, _OUTPUTS)
    return steps._replace(kernels=(*steps.kernels[:-1], shading))


def eye_ray_steps(steps: Steps, loop: RayLoop) -> Steps:
    """The kernel of eye rays, alone."""
    function = _eye_rays(loop.begin)
    return steps._replace(kernels=(StepKernel("eye rays", RayState.STARTING, function, _OUTPUTS),))


def loop_arrays(count: int, pixel: np.dtype[Any]) -> dict[str, NDArray[Any]]:
    """The records of a loop's rays beside those of a query."""
    return {"span": np.zeros(count, SPAN), "pixel": np.zeros(count, pixel)}
