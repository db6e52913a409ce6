"""Small kernels between a query and a program: open rays, room for hits, and status."""

from __future__ import annotations

import numpy as np

from raystream.core.rays import VALID
from raystream.jit.constants import NULL, SHIFT_32, SHIFT_64
from raystream.jit.cuda import gpu_kernel
from raystream.jit.simd import load, store
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, load_ray

_OPEN = np.uint8(1)
_MISS = np.int32(-1)


@gpu_kernel()
def open_all(i, open_rays):
    """Mark a ray as open."""
    store(open_rays + i, _OPEN)


@gpu_kernel(latest=np.int64, room=np.int64)
def want_room(i, open_rays, found, latest, room, wanted):
    """Request room for a ray that is open and has filled its last room."""
    wants = load(np.uint8, open_rays + i) == _OPEN
    if found != NULL:
        wants = wants and load(np.int64, found + (i << SHIFT_64)) == latest
    store(wanted + (i << SHIFT_64), room if wants else np.int64(0))


@gpu_kernel(out=HitAddresses)
def clear_ignored(i, open_rays, out):
    """Reset the hit of a ray that is still open to a miss."""
    if load(np.uint8, open_rays + i) == _OPEN:
        at = i << SHIFT_32
        store(out.t + at, np.float32(np.inf))
        store(out.u + at, np.float32(0.0))
        store(out.v + at, np.float32(0.0))
        store(out.prim_id + at, _MISS)


@gpu_kernel()
def note_hits(i, prim_ids, seen):
    """Write whether a ray has a hit."""
    store(seen + i, np.uint8(load(np.int32, prim_ids + (i << SHIFT_32)) != _MISS))


@gpu_kernel(source=RaySource, frame=SceneFrame)
def note_invalid(i, source, frame, status):
    """Write the status of a ray that is not valid."""
    ray = load_ray(source, i, frame)
    if ray.status != VALID:
        store(status + i, ray.status)


@gpu_kernel()
def narrow_ids(i, given, narrowed):
    """Convert int64 to int32; values outside its range become -1, which matches no triangle."""
    value = load(np.int64, given + (i << SHIFT_64))
    short = np.int32(value)
    store(narrowed + (i << SHIFT_32), short if np.int64(short) == value else _MISS)
