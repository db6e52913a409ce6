"""Query kernels in float64: the CPU's searches of single rays, one ray per CUDA thread.

The bits are the CPU's: products and sums are fused where the source says `fma`, and nowhere else.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.query_kernels import QueryKernels
from raystream.float64.queries import LANES_BYTES, Searches, write_nearest
from raystream.float64.ray import prepare_float64
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, scratch, store
from raystream.kernels.queries import note_status
from raystream.kernels.ray_source import load_direction, load_origin


@device
def _ray(scene, i):
    """Ray i, prepared; its status is written if it is invalid, unless there is none."""
    source = scene.source
    t_min = load(np.float64, source.t_min + i * source.t_min_step)
    t_max = load(np.float64, source.t_max + i * source.t_max_step)
    origin, direction = load_origin(source, i), load_direction(source, i)
    ray = prepare_float64(origin, direction, t_min, t_max, scene.frame)
    note_status(scene.status, i, ray.status)
    return ray


def make_float64_kernels(searches: Searches) -> QueryKernels:
    """Make the kernels of a structure in float64.

    Parameters
    ----------
    searches : Searches
        Of a single ray.

    Returns
    -------
    QueryKernels
        With the arguments of those of `cuda.query_kernels.make_kernels`. The limits of the
        `RaySource`, and t, u and v, are float64; `tallies` is None.
    """
    nearest, anything, count, keep = searches

    @kernel
    def first_hit(i, scene, hits):
        memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
        ray = _ray(scene, i)
        write_nearest(hits, i, nearest(scene.arrays, ray, memory), ray)

    @kernel
    def any_hit(i, scene, seen):
        memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
        store(seen + i, np.uint8(anything(scene.arrays, _ray(scene, i), memory)))

    @kernel
    def count_hits(i, scene, out):
        memory, limits = (scratch(STACK_BYTES), scratch(LANES_BYTES)), out.limits
        total = count(scene.arrays, _ray(scene, i), limits.most, limits.surfaces, memory)
        store(out.counts + (i << SHIFT_64), np.int64(total))

    @kernel
    def multi_hit(i, scene, out):
        first = np.uint64(load(np.int64, out.splits + (i << SHIFT_64)))
        capacity = np.uint64(load(np.int64, out.splits + ((i + ONE_U64) << SHIFT_64))) - first
        store(out.found + (i << SHIFT_64), np.int64(0))
        if capacity == ZERO_U64:
            return
        memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
        own = scene.arrays, _ray(scene, i)
        kept = keep(*own, capacity, out.hits, first, out.limits.surfaces, memory)
        store(out.found + (i << SHIFT_64), np.int64(kept))

    return QueryKernels(*(RangeKernel(one) for one in (first_hit, any_hit, count_hits, multi_hit)))
