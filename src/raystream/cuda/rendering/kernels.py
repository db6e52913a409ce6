"""What a thread does for one path: the CPU's shading, with vectors of one lane.

Each thread writes to rows of its own. Those that were written are then moved together, in their
order, by a scan of their counts.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, single_lane, store
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions, spawn_path_ao_rays
from raystream.rendering.shading.camera_rays import camera_ray_block
from raystream.rendering.shading.local_shading import facing_ratio_block, unshadowed_block
from raystream.rendering.shading.paths import shade_path_block
from raystream.rendering.shading.rows import SINGLE_ROWS
from raystream.rendering.shading.shadow_rays import add_if_unblocked
from raystream.rendering.shading.streams import ShadingBatch, StreamCursor
from raystream.rendering.shading.whitted import shade_whitted_path

__all__ = ["ADD", "ASK_LIGHTS", "BEGIN", "FOLLOW", "KEEP", "LIGHT", "LOOK_AROUND", "VIEW"]

_NONE, _ONE = np.uint64(0), np.uint64(1)
_WHOLE, _INF = np.float32(1.0), np.float32(np.inf)

# Bytes: of a number, of a long one, and of three.
_WORD, _LONG, _3_WORDS, _3_LONGS = np.uint64(4), np.uint64(8), np.uint64(12), np.uint64(24)

_begin_path = single_lane(camera_ray_block)
_look_from = single_lane(spawn_path_ao_rays, SINGLE_ROWS)
_follow_path = single_lane(shade_path_block, SINGLE_ROWS)
_light_path = single_lane(unshadowed_block)
_view_path = single_lane(facing_ratio_block)


@kernel
def _begin(i, view, first_row, sampler, sample, paths):
    width = np.uint64(view.width)
    row, column = np.int64(i // width), np.int64(i % width)
    _begin_path(view, first_row, row, column, sampler, sample, paths)
    store(paths.numbers + i * _WORD, _INF)
    for k in range(3):
        store(paths.colors + i * _3_WORDS + np.uint64(k) * _WORD, _WHOLE)


@kernel
def _follow(
    i,
    count,
    paths,
    hits,
    tables,
    lights,
    sampler,
    sample,
    bounce,
    rules,
    first_pixel,
    radiance,
    onward,
    goes_on,
    rays,
    is_asked,
):
    path_end, ray_end = _follow_path(
        i,
        ShadingBatch(count, paths, hits, first_pixel, radiance),
        tables,
        lights,
        PixelSample(sampler, sample),
        bounce,
        rules,
        StreamCursor(onward, i),
        StreamCursor(rays, i),
    )
    store(goes_on + i * _WORD, np.uint32(path_end.row - i))
    store(is_asked + i * _WORD, np.uint32(ray_end.row - i))


@device
def _copy_three(source, to):
    for k in range(3):
        at = np.uint64(k) * _WORD
        store(to + at, load(np.float32, source + at))


@kernel
def _light(i, paths, hits, tables, lights, first_pixel, radiance):
    _light_path(i, ShadingBatch(i + _ONE, paths, hits, first_pixel, radiance), tables, lights)


@kernel
def _view(i, paths, hits, tables, lights, first_pixel, radiance):
    _view_path(i, ShadingBatch(i + _ONE, paths, hits, first_pixel, radiance), tables, lights)


@kernel
def _ask_lights(i, paths, hits, tables, lights, first_pixel, radiance, per_thread, rays, is_asked):
    first = i * per_thread
    batch = ShadingBatch(i + _ONE, paths, hits, first_pixel, radiance)
    none, ray_end = StreamCursor(paths, _NONE), StreamCursor(rays, first)
    _, ray_end = shade_whitted_path(i, batch, tables, lights, False, 0.0, none, ray_end)
    store(is_asked + i * _WORD, np.uint32(ray_end.row - first))


@kernel
def _look_around(
    i,
    paths,
    hits,
    tables,
    sampler,
    sample,
    count,
    distance,
    first_pixel,
    radiance,
    rays,
    is_asked,
):
    first = i * np.uint64(count)
    ray_end = _look_from(
        i,
        ShadingBatch(i + _ONE, paths, hits, first_pixel, radiance),
        tables,
        PixelSample(sampler, sample),
        OcclusionOptions(count, distance),
        StreamCursor(rays, first),
    )
    store(is_asked + i * _WORD, np.uint32(ray_end.row - first))


@device
def _row(rows, i):
    return np.uint64(load(np.uint32, rows + i * _WORD))


@kernel
def _keep(slot, per_thread, rows, given, kept):
    i = slot // per_thread
    row = _row(rows, i) + slot - i * per_thread
    if row >= _row(rows, i + _ONE):
        return
    store(kept.pixels + row * _LONG, load(np.int64, given.pixels + slot * _LONG))
    for k in range(3):
        at = np.uint64(k) * _LONG
        origin = load(np.float64, given.origins + slot * _3_LONGS + at)
        store(kept.origins + row * _3_LONGS + at, origin)
    _copy_three(given.directions + slot * _3_WORDS, kept.directions + row * _3_WORDS)
    _copy_three(given.colors + slot * _3_WORDS, kept.colors + row * _3_WORDS)
    store(kept.numbers + row * _WORD, load(np.float32, given.numbers + slot * _WORD))


@kernel
def _add(i, rows, rays, blocked, first_pixel, radiance):
    for row in range(_row(rows, i), _row(rows, i + _ONE)):
        add_if_unblocked(row, rays, blocked, first_pixel, radiance)


#: Begins path i of a band: ``(view, first_row, sampler, sample, paths)``.
BEGIN = RangeKernel(_begin)

#: Shades path i, see `shade_path_block`, and counts the rows that it wrote to `onward` and to
#: `rays`: two uint32.
FOLLOW = RangeKernel(_follow)

#: Lights the surface that path i meets, or shows it in grey.
LIGHT, VIEW = RangeKernel(_light), RangeKernel(_view)

#: Lights the surface that path i meets, by rays to lights, and how many these are.
ASK_LIGHTS = RangeKernel(_ask_lights)

#: Sends rays from the surface that path i meets, and how many these are.
LOOK_AROUND = RangeKernel(_look_around)

#: Moves what a thread wrote to a slot to where the scan of the threads' counts says.
KEEP = RangeKernel(_keep)

#: Adds what the rays of path i bring, one after the other.
ADD = RangeKernel(_add)
