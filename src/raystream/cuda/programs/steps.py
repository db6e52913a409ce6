"""Small kernels between a query and a program: open rays, room for hits, and status."""

from __future__ import annotations

import numpy as np

from raystream.core.rays import VALID
from raystream.jit.constants import NULL, SHIFT_32, SHIFT_64
from raystream.jit.cpu import kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, store
from raystream.kernels.ray_source import load_ray

_OPEN = np.uint8(1)
_MISS = np.int32(-1)


@kernel
def _open(i, open_rays):
    store(open_rays + i, _OPEN)


@kernel
def _want(i, open_rays, found, latest, room, wanted):
    """Request room for a ray that is open and has filled its last room."""
    wants = load(np.uint8, open_rays + i) == _OPEN
    if found != NULL:
        wants = wants and load(np.int64, found + (i << SHIFT_64)) == latest
    store(wanted + (i << SHIFT_64), room if wants else np.int64(0))


@kernel
def _clear_ignored(i, open_rays, out):
    """Reset the hit of a ray that is still open to a miss."""
    if load(np.uint8, open_rays + i) == _OPEN:
        at = i << SHIFT_32
        store(out.t + at, np.float32(np.inf))
        store(out.u + at, np.float32(0.0))
        store(out.v + at, np.float32(0.0))
        store(out.prim_id + at, _MISS)


@kernel
def _is_hit(i, prim_ids, seen):
    store(seen + i, np.uint8(load(np.int32, prim_ids + (i << SHIFT_32)) != _MISS))


@kernel
def _note_invalid(i, source, frame, status):
    ray = load_ray(source, i, frame)
    if ray.status != VALID:
        store(status + i, ray.status)


@kernel
def _narrow(i, given, narrowed):
    """Convert int64 to int32; values outside its range become -1, which matches no triangle."""
    value = load(np.int64, given + (i << SHIFT_64))
    short = np.int32(value)
    store(narrowed + (i << SHIFT_32), short if np.int64(short) == value else _MISS)


OPEN = RangeKernel(_open)
WANT = RangeKernel(_want)
CLEAR_IGNORED = RangeKernel(_clear_ignored)
IS_HIT = RangeKernel(_is_hit)
NOTE_INVALID = RangeKernel(_note_invalid)
NARROW = RangeKernel(_narrow)
