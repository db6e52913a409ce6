"""Kernels that shade one path per thread: the CPU's shading, with vectors of one lane.

Each thread writes to slots of its own, which are then compacted, in order, by a scan of their
counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import BYTES_32, BYTES_64, INF_F32, ONE_F32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import gpu_kernel
from raystream.jit.simd import load, store
from raystream.kernels.hits import HitAddresses
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions
from raystream.rendering.shading.camera_rays import View
from raystream.rendering.shading.light_tables import LightTables
from raystream.rendering.shading.paths import PathOptions
from raystream.rendering.shading.punctual_lights import PunctualLights
from raystream.rendering.shading.shadow_rays import add_if_unblocked
from raystream.rendering.shading.single_lanes import (
    ambient_rays,
    camera_ray,
    facing_ratio,
    shade_path,
    unshadowed,
)
from raystream.rendering.shading.streams import ShadingBatch, StreamAddresses, StreamCursor
from raystream.rendering.shading.tables import SceneTables
from raystream.rendering.shading.whitted import WhittedOptions, shade_whitted_path

#: Types of a batch in device memory.
_BATCH = ShadingBatch._make((int, StreamAddresses, HitAddresses, int, np.uint64))

#: Bytes of three numbers.
_3_X_32, _3_X_64 = np.uint64(12), np.uint64(24)


class SlotAddresses(NamedTuple):
    """Rows that threads write independently: thread i from row ``i * per_thread``.

    Attributes
    ----------
    columns : StreamAddresses
    counts : uint64
        Address of the number of rows that each thread wrote, uint32.
    per_thread : uint64
        Maximum of these numbers.
    """

    columns: StreamAddresses
    counts: np.uint64
    per_thread: np.uint64


@device
def _begin_slots(slots, i):
    return StreamCursor(slots.columns, i * slots.per_thread)


@device
def _end_slots(slots, i, end):
    store(slots.counts + i * BYTES_32, np.uint32(end.row - i * slots.per_thread))


@gpu_kernel(view=View, first_row=np.int64, sample=PixelSample, paths=StreamAddresses)
def generate_camera_rays(i, view, first_row, sample, paths):
    """Begin path i of a band."""
    width = np.uint64(view.width)
    row, column = np.int64(i // width), np.int64(i % width)
    camera_ray(view, first_row, row, column, sample.sampler, sample.number, paths)
    store(paths.numbers + i * BYTES_32, INF_F32)
    for k in range(3):
        store(paths.colors + i * _3_X_32 + np.uint64(k) * BYTES_32, ONE_F32)


@gpu_kernel(
    batch=_BATCH,
    tables=SceneTables,
    lights=LightTables,
    sample=PixelSample,
    bounce=np.int64,
    options=PathOptions,
    onward=SlotAddresses,
    rays=SlotAddresses,
)
def shade_paths(i, batch, tables, lights, sample, bounce, options, onward, rays):
    """Shade path i, see `shade_path_block`."""
    starts = _begin_slots(onward, i), _begin_slots(rays, i)
    path_end, ray_end = shade_path(i, batch, tables, lights, sample, bounce, options, *starts)
    _end_slots(onward, i, path_end)
    _end_slots(rays, i, ray_end)


@gpu_kernel(batch=_BATCH, tables=SceneTables, lights=PunctualLights)
def shade_unshadowed(i, batch, tables, lights):
    """Shade the hit of path i by all lights without shadows."""
    unshadowed(i, batch, tables, lights)


@gpu_kernel(batch=_BATCH, tables=SceneTables, lights=PunctualLights)
def shade_facing_ratio(i, batch, tables, lights):
    """Shade the hit of path i by its facing ratio."""
    facing_ratio(i, batch, tables, lights)


@gpu_kernel(batch=_BATCH, tables=SceneTables, lights=PunctualLights, rays=SlotAddresses)
def sample_all_lights(i, batch, tables, lights, rays):
    """Shade the hit of path i by all lights, and write shadow rays."""
    none = StreamCursor(batch.paths, ZERO_U64)
    start = _begin_slots(rays, i)
    options = WhittedOptions(False, 0.0, True)
    _, ray_end = shade_whitted_path(i, batch, tables, lights, options, none, start)
    _end_slots(rays, i, ray_end)


@gpu_kernel(
    batch=_BATCH,
    tables=SceneTables,
    sample=PixelSample,
    options=OcclusionOptions,
    rays=SlotAddresses,
)
def spawn_ao_rays(i, batch, tables, sample, options, rays):
    """Spawn ambient occlusion rays from the hit of path i."""
    _end_slots(rays, i, ambient_rays(i, batch, tables, sample, options, _begin_slots(rays, i)))


@device
def _row(rows, i):
    return np.uint64(load(np.uint32, rows + i * BYTES_32))


@device
def _copy_three(source, to):
    for k in range(3):
        at = np.uint64(k) * BYTES_32
        store(to + at, load(np.float32, source + at))


@gpu_kernel(slots=SlotAddresses, to=StreamAddresses)
def compact(slot, slots, to):
    """Move the row of a slot to a stream; `slots.counts` are the scanned counts."""
    i = slot // slots.per_thread
    row = _row(slots.counts, i) + slot - i * slots.per_thread
    if row >= _row(slots.counts, i + ONE_U64):
        return
    given = slots.columns
    store(to.pixels + row * BYTES_64, load(np.int64, given.pixels + slot * BYTES_64))
    for k in range(3):
        at = np.uint64(k) * BYTES_64
        origin = load(np.float64, given.origins + slot * _3_X_64 + at)
        store(to.origins + row * _3_X_64 + at, origin)
    _copy_three(given.directions + slot * _3_X_32, to.directions + row * _3_X_32)
    _copy_three(given.colors + slot * _3_X_32, to.colors + row * _3_X_32)
    store(to.numbers + row * BYTES_32, load(np.float32, given.numbers + slot * BYTES_32))


@gpu_kernel(rays=StreamAddresses, first_pixel=np.int64)
def add_unblocked(i, rows, rays, blocked, first_pixel, radiance):
    """Add the light of path i's unblocked shadow rays, in order."""
    for row in range(_row(rows, i), _row(rows, i + ONE_U64)):
        add_if_unblocked(row, rays, blocked, first_pixel, radiance)
