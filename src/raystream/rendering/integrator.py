"""Integrators: stages over streams of paths, one sample of every pixel at a time.

A renderer is a list of stages. Each takes a stream of paths and returns one, as the boxes of
Purcell 2002, Figure 3 do; what the last stage returns (reflected rays, say) goes back to the
first, until no path is left. There is no recursion: a path's weight holds its contribution to its
pixel (Christen 2005, chapter 5). A stage is a query, or a compiled kernel over the whole stream;
random numbers come from a sampler, and a sample's light is accumulated for the pixels of a band
before it is added to the film.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.jit.threads import Progress
from raystream.programs.filters import Bound
from raystream.rendering.arguments import check_samples
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.device_bands import DeviceBands
from raystream.rendering.opacity import Opacity, filter_of
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.aovs import AovBuffers, write_aovs
from raystream.rendering.shading.light_tables import LightTables
from raystream.rendering.shading.placed_tables import ObjectTables
from raystream.rendering.shading.primitive_tables import MeshTables
from raystream.rendering.shading.punctual_lights import PunctualLights
from raystream.rendering.shading.shadow_rays import ShadowRays, add_unblocked
from raystream.rendering.shading.streams import Paths
from raystream.rendering.shading.tables import SceneTables
from raystream.rendering.surfaces import surfaces_of
from raystream.scene.camera import Camera
from raystream.tracer import Tracer

#: Upper bound of the option `max_bounces`.
MAX_BOUNCES = 1000

#: Samples per pixel, at most, where noise or time end an image and no number is given.
MOST_SAMPLES = 1 << 16


@dataclass(frozen=True)
class RenderContext:
    """Scene, camera, sampler and options that the stages of one image share.

    Attributes
    ----------
    tracer : Tracer
    camera : Camera
    width, height : int
    tables : SceneTables
    lights : LightTables
    punctual : PunctualLights
        The same for modes that take each light as one position.
    sampler : Sampler
    opacity : Opacity, optional
        The filter for cut-outs and transparent surfaces.
    options : mapping
        Of the integrator, such as ``max_bounces``.
    kept : object
        The arrays at the tables' addresses, to keep them alive.
    layers : sequence of str
        Names in `LAYERS` to render.
    chosen_lights : {"auto", "file", "added"}
        See `lighting.needs_light`, and `view_light.lit`.
    is_light_added : bool
        Whether the scene needs light, see `lighting.needs_light`.
    bands : DeviceBands, optional
        Renders samples on the tracer's device, or in loops of its machine, if it can.
    """

    tracer: Tracer
    camera: Camera
    width: int
    height: int
    tables: SceneTables
    lights: LightTables
    punctual: PunctualLights
    sampler: Sampler
    opacity: Opacity | None
    options: Mapping[str, Any]
    kept: tuple[object, object, object]
    layers: Sequence[str] = ()
    chosen_lights: str = "auto"
    is_light_added: bool = False
    bands: DeviceBands | None = None
    objects: ObjectTables | MeshTables | None = None

    def filter(self, origins: NDArray[np.float64], directions: NDArray[np.float32]) -> Bound | None:
        """The filter (``on_hit``) of the tracer's queries for rays of shape (N, 3)."""
        return filter_of(self.opacity, origins, directions)


@dataclass(frozen=True)
class Band:
    """One sample of some rows of the image.

    Attributes
    ----------
    context : RenderContext
    sample : int
    first_pixel : int
    radiance : ndarray of shape (P, 3), float32
        Linear RGB of its pixels; stages add to it.
    """

    context: RenderContext
    sample: int
    first_pixel: int
    radiance: NDArray[np.float32]


@dataclass(frozen=True)
class PathStream:
    """Paths between two stages.

    Attributes
    ----------
    paths : Paths
    bounce : int
        Number of surfaces that have scattered them.
    hits : Hits, optional
        Of their rays, once traced.
    rays : ShadowRays, optional
        To be traced.
    sectors : ndarray of shape (P,), int32, optional
        For each pixel of the band, the sector of the hit that its rays leave, -1 for none; in a
        graph. See `Hits.sectors`.
    """

    paths: Paths
    bounce: int = 0
    hits: Hits | None = None
    rays: ShadowRays | None = None
    sectors: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.paths.pixels)


PathStage = Callable[[PathStream, Band], PathStream]


@dataclass(frozen=True)
class Integrator:
    """A render mode.

    Attributes
    ----------
    name : str
    description : str
        One line, with the source.
    stages : tuple of PathStage
    options : mapping
        Names and defaults; checked by `check`.
    check : callable
        Returns the options as stages take them; raises ValueError if one is invalid.
    rays_per_pixel : callable
        Largest number of rays per pixel that a stage makes at once, for a context: the more,
        the smaller are bands.
    presets : mapping of str to mapping
        Named sets of options.
    default_samples : int
        Samples per pixel of an image for which neither they nor other limits are given.
    """

    name: str
    description: str
    stages: Sequence[PathStage]
    options: Mapping[str, Any]
    check: Callable[[Mapping[str, Any]], Mapping[str, Any]]
    rays_per_pixel: Callable[[RenderContext], int] = lambda _: 1
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    default_samples: int = 1

    def complete(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """All options: those given, then those of the preset that is given, then defaults.

        Raises
        ------
        ValueError
            If the mode has no such preset.
        """
        chosen = dict(given)
        preset = chosen.pop("preset", None)
        if preset is None:
            return {**self.options, **chosen}
        if preset not in self.presets:
            known = " or ".join(map(repr, self.presets)) or f"none, in mode {self.name!r}"
            raise ValueError(f"preset: expected {known}, got {preset!r:.40}")
        return {**self.options, **self.presets[preset], **chosen}

    def samples(
        self,
        given: int | None,
        noise: float | None = None,
        time_limit: float | None = None,
        sampler: str = "sobol",
    ) -> int:
        """Samples per pixel: those given, checked; or `MOST_SAMPLES` with limits; or the default.

        Raises
        ------
        ValueError
            If the number is below 1; or not given to the sampler "stratified", with limits.
        """
        if given is not None:
            return check_samples(given)
        if noise is None and time_limit is None:
            return self.default_samples
        if sampler == "stratified":
            raise ValueError(
                "samples: required by the sampler 'stratified', also with noise or time_limit: "
                "it divides each pixel into this number of parts"
            )
        return MOST_SAMPLES

    def bands_of(self, context: RenderContext) -> DeviceBands | None:
        """The renderer of its samples on a device; None if the host renders, as for layers."""
        bands = context.bands
        return bands if bands and not context.layers and bands.takes(self.stages) else None

    def trace(
        self,
        context: RenderContext,
        rows: range,
        sample: int,
        aovs: AovBuffers | None = None,
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Render one sample of each pixel of some rows.

        Parameters
        ----------
        context : RenderContext
        rows : range
        sample : int
        aovs : AovBuffers, optional
            Receives the first hits of the sample, if layers are rendered.
        progress : callable, optional
            Called with (pixels done, pixels), where bands are serial.

        Returns
        -------
        ndarray of shape (rows * width, 3), float32
            Linear RGB.
        """
        bands = self.bands_of(context)
        if bands is not None and aovs is None:
            return bands.trace(self.stages, rows, sample, progress)
        size = context.width, context.height
        paths = camera_paths(context.camera, size, context.sampler, rows, sample)
        radiance = np.zeros((len(rows) * context.width, 3), np.float32)
        band = Band(context, sample, rows.start * context.width, radiance)
        stream = PathStream(paths)
        if aovs is not None:
            stream = find_surfaces(stream, band)
            surfaces = surfaces_of(stream, band)
            write_aovs(surfaces.batch, surfaces.tables, aovs)
            if context.objects is not None and stream.hits is not None:  # tables of the hits
                aovs.prim_id[stream.paths.pixels - band.first_pixel] = stream.hits.prim_id
        while len(stream):
            for stage in self.stages:
                stream = stage(stream, band)
                if aovs is not None and stage is not find_surfaces:
                    aovs.emission[:] = radiance  # before any secondary ray
                    aovs = None
        return radiance


def take_no_options(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """For `Integrator.check` of modes without options."""
    return options


def sectors_of(stream: PathStream, band: Band) -> NDArray[np.int32] | None:
    """The sectors of a stream's hits, by pixel, for the rays that shading spawns.

    To be called before shading, which writes other paths to the same rows.
    """
    hits = stream.hits
    if hits is None or hits.sectors is None:
        return None
    sectors = np.full(len(band.radiance), -1, np.int32)
    sectors[stream.paths.pixels - band.first_pixel] = hits.sectors
    return sectors


def _starts(stream: PathStream, pixels: NDArray[np.int64], band: Band) -> NDArray[np.int32] | None:
    """The sectors in which rays of some pixels begin, as far as they are known."""
    return None if stream.sectors is None else stream.sectors[pixels - band.first_pixel]


def find_surfaces(stream: PathStream, band: Band) -> PathStream:
    """Stage: trace the paths' rays, unless their hits are known."""
    if stream.hits is not None:
        return stream
    context, rays = band.context, (stream.paths.origins, stream.paths.directions)
    near, filter_ = _starts(stream, stream.paths.pixels, band), context.filter(*rays)
    if stream.bounce == 0:  # all pixels of some rows
        # Nothing need look for the rows: two kernels less for a first image to compile.
        shape = -1, context.width, 3
        rows = (values.reshape(shape) for values in rays)
        hits = context.tracer.first_hit(*rows, on_hit=filter_)
        return replace(stream, hits=hits.ravel())
    hits = context.tracer.first_hit(*rays, on_hit=filter_, near=near)
    return replace(stream, hits=hits)


def trace_shadow_rays(stream: PathStream, band: Band) -> PathStream:
    """Stage: trace the shadow rays, and add the light of those that nothing blocks."""
    rays = stream.rays
    assert rays is not None
    if len(rays.pixels):
        context, asked = band.context, (rays.origins, rays.directions)
        blocked = context.tracer.any_hit(
            *asked,
            t_max=rays.t_max,
            on_hit=context.filter(*asked),
            near=_starts(stream, rays.pixels, band),
        )
        add_unblocked(rays, blocked, band.first_pixel, band.radiance)
    return replace(stream, rays=None)
