"""Renderers as loops of the multipass machine: their shading and memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.machines import MultipassBackend
from raystream.machines.ray_loop import RayLoop
from raystream.rendering.ao import distance_of, sampler_of, spawn_ambient_rays
from raystream.rendering.integrator import PathStage, RenderContext
from raystream.rendering.path import shade_surfaces
from raystream.rendering.raycast import shade_by_lights
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions
from raystream.rendering.shading.camera_rays import view_of
from raystream.rendering.shading.pixel_rays import (
    PIXEL,
    SHADE_AMBIENT,
    SHADE_FACING_RATIO,
    SHADE_LIGHTS,
    SHADE_PATH,
    SHADE_WHITTED,
    LoopShading,
    Rows,
    begin_pixel,
    has_room,
)
from raystream.rendering.shading.shadow_rays import ShadowRays
from raystream.rendering.shading.streams import Paths, StreamAddresses
from raystream.rendering.shading.tables import HAS_TRANSMISSION
from raystream.rendering.shading_stages import shading_of
from raystream.rendering.vis import shade_by_facing_ratio
from raystream.rendering.whitted import lights_per_pixel, sample_all_lights

#: Memory for the rows of a band, beside the machine's.
MAX_BYTES = 1 << 28

#: Bytes of a path with its hit, and of a shadow ray.
_PATH_BYTES, _SHADOW_BYTES = 76, 60

#: Columns of a path and its hit.
_PATH_COLUMNS = len(Paths._fields) + len(HitArrays._fields)


class _Mode(NamedTuple):
    """A renderer's shading in a loop.

    Attributes
    ----------
    shade : callable
        See `RayLoop.shade`.
    more : callable
        ``more(context, sample)``: `LoopShading.more`.
    spawned : callable
        ``spawned(context)``: most paths and shadow rays that a path spawns.
    last_bounce : callable
        ``last_bounce(context)``: at which paths spawn no paths.
    """

    shade: Callable[..., Any]
    more: Callable[[RenderContext, int], tuple[Any, ...]]
    spawned: Callable[[RenderContext], tuple[int, int]]
    last_bounce: Callable[[RenderContext], int] = lambda _: 0

    def room(self, context: RenderContext) -> tuple[int, int]:
        """Rows of a pixel at first: paths of a bounce, and shadow rays of each."""
        paths, shadows = self.spawned(context)
        return (paths if self.last_bounce(context) > 0 else 0) or 1, shadows


def _ambient_arguments(context: RenderContext, sample: int) -> tuple[Any, ...]:
    options = OcclusionOptions(int(context.options["rays"]), distance_of(context))
    return PixelSample(sampler_of(context), sample), options


def _whitted_spawns(context: RenderContext) -> tuple[int, int]:
    """Two paths behind glass, which reflects and refracts; a shadow ray to each light."""
    return (2 if context.tables.kinds & HAS_TRANSMISSION else 1), lights_per_pixel(context)


def _punctual_lights(context: RenderContext, _: int) -> tuple[Any, ...]:
    return (context.punctual,)


def _whitted_arguments(context: RenderContext, _: int) -> tuple[Any, ...]:
    options = context.options
    return context.punctual, float(options["min_weight"]), bool(options["casts_shadows"])


#: The modes, by the stage that shades.
_MODES: MappingProxyType[PathStage, _Mode] = MappingProxyType(
    {
        shade_by_lights: _Mode(SHADE_LIGHTS, _punctual_lights, lambda _: (0, 0)),
        shade_by_facing_ratio: _Mode(SHADE_FACING_RATIO, _punctual_lights, lambda _: (0, 0)),
        shade_surfaces: _Mode(
            SHADE_PATH,
            lambda context, _: (context.lights, context.options["rules"]),
            lambda _: (1, 1),
            lambda context: int(context.options["rules"].max_bounces),
        ),
        sample_all_lights: _Mode(
            SHADE_WHITTED,
            _whitted_arguments,
            _whitted_spawns,
            lambda context: int(context.options["max_bounces"]),
        ),
        spawn_ambient_rays: _Mode(
            SHADE_AMBIENT,
            _ambient_arguments,
            lambda context: (0, int(context.options["rays"])),
        ),
    }
)


class MultipassBands:
    """Renders samples of rows by loops of a multipass machine; see `device_bands.DeviceBands`.

    Parameters
    ----------
    context : RenderContext
    machine : MultipassBackend
    """

    is_serial = True

    def __init__(self, context: RenderContext, machine: MultipassBackend) -> None:
        self._context, self._machine = context, machine
        self._passes: Counter[str] = Counter()

    def pixels_at_once(self, stages: Sequence[PathStage], _: int) -> int:
        """Upper bound for a band: of the memory for its rays and the machine's."""
        room, shadows = _MODES[stages[1]].room(self._context)
        return max(MAX_BYTES // (_row_bytes(room, shadows) + self._machine.loop_bytes(PIXEL)), 1)

    def takes(self, stages: Sequence[PathStage]) -> bool:
        """Whether a renderer's stages can be one loop.

        Not with surfaces that are not opaque, whose hits a filter takes from a query, nor with
        other cameras than perspective ones.
        """
        context = self._context
        if context.opacity is not None or context.camera.projection != "perspective":
            return False
        return shading_of(stages) is not None

    def trace(
        self,
        stages: Sequence[PathStage],
        rows: range,
        sample: int,
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows; see `Integrator.trace`."""
        context, mode = self._context, _MODES[stages[1]]
        count = len(rows) * context.width
        radiance = np.zeros((count, 3), np.float32)
        more = self._machine.loop_bytes(PIXEL)
        band = _Band(context, mode, rows.start, sample, radiance, more)
        columns = _Columns.empty(count, *mode.room(context))
        self._machine.run_loop(band.loop(columns), count, self._passes, progress)
        return radiance

    def start(self) -> None:
        """Count passes from here."""
        self._passes.clear()

    def figures(self) -> Mapping[str, Any]:
        """The number of passes of each kernel since `start`, if there were any."""
        return {"passes": dict(self._passes)} if self._passes else {}


def _row_bytes(room: int, shadows: int) -> int:
    """Memory of a pixel's rows."""
    return room * (2 * _PATH_BYTES + shadows * _SHADOW_BYTES)


class _Columns(NamedTuple):
    """The rows of some pixels, see `Rows`."""

    paths: Paths
    hits: HitArrays
    shadows: ShadowRays
    room: int

    @classmethod
    def empty(cls, count: int, room: int, shadows: int) -> _Columns:
        """Rows for `room` paths of each pixel, and their shadow rays."""
        paths = Paths.empty(count * 2 * room)
        return cls(
            paths,
            HitArrays.empty(count * 2 * room),
            ShadowRays.empty(count * room * shadows),
            room,
        )

    def grown(self, numbers: NDArray[np.int64], room: int, shadows: int) -> _Columns:
        """The rows of some pixels, with more room."""
        made = _Columns.empty(len(numbers), room, shadows)
        count = len(self.paths.pixels) // (2 * self.room)
        for k, (old, new) in enumerate(zip(self._arrays(), made._arrays(), strict=True)):
            _copy_rows(old, new, count, numbers, 2 if k < _PATH_COLUMNS else 1)
        return made

    def _arrays(self) -> list[NDArray[Any]]:
        """The columns of paths with their hits, then those of shadow rays."""
        return [*self.paths, *self.hits, *self.shadows]


def _copy_rows(
    old: NDArray[Any], new: NDArray[Any], count: int, numbers: NDArray[np.int64], parts: int
) -> None:
    """Copy some of `count` pixels' rows, in parts of equal length, to the begin of longer parts."""
    length, longer = len(old) // (count * parts), len(new) // (len(numbers) * parts)
    rows = old.reshape(count, parts, length, *old.shape[1:])[numbers]
    new.reshape(len(numbers), parts, longer, *new.shape[1:])[:, :, :length] = rows


class _Band(NamedTuple):
    """One sample of some rows of an image."""

    context: RenderContext
    mode: _Mode
    first_row: int
    sample: int
    radiance: NDArray[np.float32]
    machine_bytes: int

    def loop(self, columns: _Columns) -> RayLoop:
        """The loop over pixels with these rows."""
        context, mode = self.context, self.mode
        shadows = mode.room(context)[1]
        hits = HitAddresses.of(columns.hits)
        rows = Rows(
            _addresses(columns.paths),
            hits,
            _addresses(columns.shadows),
            np.uint64(columns.room),
            np.uint64(columns.room * shadows),
            np.uint64(mode.spawned(context)[0]),
            mode.last_bounce(context),
            len(columns.paths.pixels),
            self.first_row * context.width,
            np.uint64(self.radiance.ctypes.data),
        )
        shading = LoopShading(
            view_of(context.camera, context.width, context.height),
            self.first_row,
            PixelSample(context.sampler, self.sample),
            rows,
            context.tables,
            mode.more(context, self.sample),
        )

        def grow(wanted: NDArray[Any]) -> Iterator[tuple[slice, RayLoop]]:
            room = 2 * columns.room
            each = _row_bytes(room, shadows) + self.machine_bytes
            size = max(1, MAX_BYTES // each)
            for first in range(0, len(wanted), size):
                part = slice(first, min(first + size, len(wanted)))
                mine = wanted[part]
                numbers = mine["number"].astype(np.int64)
                at = mine["first"].astype(np.int64) - numbers * 2 * columns.room
                half, k = divmod(at, columns.room)
                mine["number"] = np.arange(len(mine))
                mine["first"] = (np.arange(len(mine)) * 2 + half) * room + k
                yield part, self.loop(columns.grown(numbers, room, shadows))

        return RayLoop(
            begin_pixel,
            has_room,
            mode.shade,
            any(mode.spawned(context)),
            PIXEL,
            shading,
            hits,
            grow,
        )


def _addresses(columns: Paths | ShadowRays) -> StreamAddresses:
    return StreamAddresses(*(np.uint64(array.ctypes.data) for array in columns))
