"""A pixel's rays in a loop of the multipass machine, see `machines.ray_loop`: which is the next.

They are traced one after another, in the order in which a renderer's stages add their light, so
that images have the bits of the stages: the paths of a bounce, each shaded once its ray is traced;
then their shadow rays; then the paths of the next bounce. Only glass makes more than one path per
pixel and bounce.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import BYTES_32, BYTES_64, INF_F32, ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import gather, load, store
from raystream.kernels.hits import HitAddresses
from raystream.machines.ray_loop import NextRay
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.camera_rays import View
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.single_lanes import (
    ambient_rays,
    camera_ray,
    facing_ratio,
    shade_path,
    unshadowed,
)
from raystream.rendering.shading.streams import (
    ShadingBatch,
    StreamAddresses,
    StreamCursor,
    add_light,
)
from raystream.rendering.shading.tables import SceneTables
from raystream.rendering.shading.whitted import WhittedOptions, shade_whitted_path

#: The record of a pixel between passes: its bounce; which half of its rows has the bounce's paths;
#: of these, the one that is traced, and their number; the number for the next bounce; the shadow
#: ray that is traced once all paths are shaded, and the number of shadow rays.
PIXEL = np.dtype(
    [
        ("bounce", np.int32),
        ("half", np.uint32),
        ("path", np.uint32),
        ("path_count", np.uint32),
        ("onward_count", np.uint32),
        ("shadow", np.uint32),
        ("shadow_count", np.uint32),
    ]
)

_3_X_32, _3_X_64 = np.uint64(12), np.uint64(24)
_WHOLE = np.float32(1.0)
_WHITE = (1.0, 1.0, 1.0)


class Rows(NamedTuple):
    """Where a pixel's rays are, and what they add to.

    Attributes
    ----------
    paths : StreamAddresses
        Of `Paths`: for each pixel two halves, of one bounce and of the next, with `path_room` rows.
    hits : HitAddresses
        The nearest hit of each path.
    shadows : StreamAddresses
        Of `ShadowRays`: `shadow_room` rows for each pixel.
    path_room, shadow_room : uint64
    spawned : uint64
        Most paths that a path spawns.
    last_bounce : int
        At which paths spawn none.
    path_count : int
        Rows of `paths`.
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : uint64
        Address of shape (P, 3), float32.
    """

    paths: StreamAddresses
    hits: HitAddresses
    shadows: StreamAddresses
    path_room: np.uint64
    shadow_room: np.uint64
    spawned: np.uint64
    last_bounce: int
    path_count: int
    first_pixel: int
    radiance: np.uint64


class LoopShading(NamedTuple):
    """Constants of a loop.

    Attributes
    ----------
    camera : View
    first_row : int
        Of the band.
    sample : PixelSample
    rows : Rows
    tables : SceneTables
    more : tuple
        The other arguments of the mode's shading.
    """

    camera: View
    first_row: int
    sample: PixelSample
    rows: Rows
    tables: SceneTables
    more: Any


@device
def _path_row(rows, number, half, k):
    return (number * TWO_U64 + np.uint64(half)) * rows.path_room + np.uint64(k)


@device
def _next_ray(row, columns, at, t_max):
    """The ray in row `at` of columns, with its hit in row `row`."""
    here = columns.origins + at * _3_X_64
    x, y, z = (
        load(np.float64, here),
        load(np.float64, here + BYTES_64),
        load(np.float64, here + BYTES_64 + BYTES_64),
    )
    return NextRay(True, row, (x, y, z), vector_at(columns.directions, np.int32(at)), t_max)


@device
def _path_ray(rows, number, half, k):
    row = _path_row(rows, number, half, k)
    return _next_ray(row, rows.paths, row, INF_F32)


@device
def _ended(ray):
    """A ray that is not traced."""
    return NextRay(False, ray.row, ray.origin, ray.direction, ray.t_max)


@device
def begin_pixel(number, shading):
    """A pixel's record, and its eye ray (Purcell 2002, section 3.1.1)."""
    rows, view = shading.rows, shading.camera
    row, width = _path_row(rows, number, ZERO_U64, ZERO_U64), np.uint64(view.width)
    # The ray is written to row `number` of these columns.
    moved = row - number
    paths = StreamAddresses(
        rows.paths.pixels + moved * BYTES_64,
        rows.paths.origins + moved * _3_X_64,
        rows.paths.directions + moved * _3_X_32,
        rows.paths.colors,
        rows.paths.numbers,
    )
    camera_ray(
        view,
        shading.first_row,
        np.int64(number // width),
        np.int64(number % width),
        shading.sample.sampler,
        shading.sample.number,
        paths,
    )
    store(rows.paths.numbers + row * BYTES_32, INF_F32)
    for k in range(3):
        store(rows.paths.colors + row * _3_X_32 + np.uint64(k) * BYTES_32, _WHOLE)
    return _record(
        np.int32(0), ZERO_U64, ZERO_U64, ONE_U64, ZERO_U64, ZERO_U64, ZERO_U64
    ), _path_ray(rows, number, ZERO_U64, ZERO_U64)


@device
def _record(bounce, half, path, path_count, onward_count, shadow, shadow_count):
    """A record of `PIXEL`."""
    return (
        bounce,
        np.uint32(half),
        np.uint32(path),
        np.uint32(path_count),
        np.uint32(onward_count),
        np.uint32(shadow),
        np.uint32(shadow_count),
    )


@device
def has_room(pixel, shading):
    """Whether there are rows for the paths that shading a pixel's path may spawn."""
    rows = shading.rows
    is_last = pixel.path == pixel.path_count or pixel.bounce >= rows.last_bounce
    return is_last or np.uint64(pixel.onward_count) + rows.spawned <= rows.path_room


@device
def _next_of(number, pixel, rows, onward_count, path, shadow, shadow_count):
    """A pixel's record after a ray, and its next one."""
    bounce, half, path_count = pixel.bounce, np.uint64(pixel.half), np.uint64(pixel.path_count)
    row = _path_row(rows, number, half, ZERO_U64)
    new = _next_ray(row, rows.paths, row, INF_F32)  # for its types
    is_active = True
    if path < path_count:
        new = _path_ray(rows, number, half, path)
    elif shadow < shadow_count:
        at = number * rows.shadow_room + shadow
        t_max = load(np.float32, rows.shadows.numbers + at * BYTES_32)
        new = _next_ray(row, rows.shadows, at, t_max)
    else:
        bounce += np.int32(1)
        half ^= ONE_U64
        path_count, onward_count, path = onward_count, ZERO_U64, ZERO_U64
        shadow = shadow_count = ZERO_U64
        is_active = path_count != ZERO_U64
        if is_active:
            new = _path_ray(rows, number, half, ZERO_U64)
    new = new if is_active else _ended(new)
    return _record(bounce, half, path, path_count, onward_count, shadow, shadow_count), new


def _shade_pixel(shade_hit: Callable[..., Any]) -> Callable[..., Any]:
    """`RayLoop.shade` of a mode.

    `shade_hit` is a device function ``(row, bounce, batch, shading, onward, shadows)``: it shades
    a path, and returns the cursors behind the rows that it wrote.
    """

    def shade(number, pixel, fits, is_hit, shading):
        rows = shading.rows
        if not fits:
            same = _record(
                pixel.bounce,
                pixel.half,
                pixel.path,
                pixel.path_count,
                pixel.onward_count,
                pixel.shadow,
                pixel.shadow_count,
            )
            return same, _ended(_path_ray(rows, number, pixel.half, ZERO_U64))
        path, onward_count = np.uint64(pixel.path), np.uint64(pixel.onward_count)
        shadow, shadow_count = np.uint64(pixel.shadow), np.uint64(pixel.shadow_count)
        first_shadow = number * rows.shadow_room
        if pixel.path < pixel.path_count:
            row = _path_row(rows, number, pixel.half, path)
            first = _path_row(rows, number, ONE_U64 - np.uint64(pixel.half), ZERO_U64)
            batch = ShadingBatch(
                rows.path_count, rows.paths, rows.hits, rows.first_pixel, rows.radiance
            )
            onward, shadows = shade_hit(
                row,
                pixel.bounce,
                batch,
                shading,
                StreamCursor(rows.paths, first + onward_count),
                StreamCursor(rows.shadows, first_shadow + shadow_count),
            )
            onward_count, shadow_count = onward.row - first, shadows.row - first_shadow
            path += ONE_U64
        else:
            if not is_hit:
                at = first_shadow + shadow
                place = gather(np.int64, rows.shadows.pixels, at) - rows.first_pixel
                light = vector_at(rows.shadows.colors, np.int32(at))
                add_light(rows.radiance, place, light, _WHITE, 1.0)
            shadow += ONE_U64
        return _next_of(number, pixel, rows, onward_count, path, shadow, shadow_count)

    return device(shade)


@device
def _shade_path(row, bounce, batch, shading, onward, shadows):
    """Purcell's path tracer, and Kajiya's; see `path.shade_surfaces`."""
    lights, options = shading.more
    return shade_path(
        row,
        batch,
        shading.tables,
        lights,
        shading.sample,
        np.int64(bounce),
        options,
        onward,
        shadows,
    )


@device
def _shade_whitted(row, bounce, batch, shading, onward, shadows):
    """Shadow, reflected and refracted rays; see `whitted.sample_all_lights`."""
    lights, min_weight, casts_shadows = shading.more
    options = WhittedOptions(bounce < shading.rows.last_bounce, min_weight, casts_shadows)
    return shade_whitted_path(row, batch, shading.tables, lights, options, onward, shadows)


@device
def _shade_by_lights(row, _, batch, shading, onward, shadows):
    """See `raycast.shade_by_lights`."""
    unshadowed(row, batch, shading.tables, shading.more[0])
    return onward, shadows


@device
def _shade_by_facing_ratio(row, _, batch, shading, onward, shadows):
    """See `vis.shade_by_facing_ratio`."""
    facing_ratio(row, batch, shading.tables, shading.more[0])
    return onward, shadows


@device
def _spawn_ambient_rays(row, _, batch, shading, onward, shadows):
    """See `ao.spawn_ambient_rays`."""
    sample, options = shading.more
    return onward, ambient_rays(row, batch, shading.tables, sample, options, shadows)


#: `RayLoop.shade` by the modes' shading.
SHADE_PATH = _shade_pixel(_shade_path)
SHADE_WHITTED = _shade_pixel(_shade_whitted)
SHADE_LIGHTS = _shade_pixel(_shade_by_lights)
SHADE_FACING_RATIO = _shade_pixel(_shade_by_facing_ratio)
SHADE_AMBIENT = _shade_pixel(_spawn_ambient_rays)
