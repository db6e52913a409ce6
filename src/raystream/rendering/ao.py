"""ao: ambient occlusion, the share of a white sky that each first hit sees (Rayforce 2013).

32 rays from each first hit, cosine-distributed around its normal: white where they hit nothing
within `distance`, so that closed rooms are not black. Pixels without a surface are black: white
models are seen against them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from raystream.rendering.arguments import check_number, check_whole
from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    RenderContext,
    find_surfaces,
    sectors_of,
    trace_shadow_rays,
)
from raystream.rendering.sampling.sampler import PixelSample, Sampler
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions, spawn_ao_rays
from raystream.rendering.shading.shadow_rays import ShadowRays
from raystream.rendering.surfaces import surfaces_of

#: Upper bound of the option `rays`.
MAX_RAYS = 4096

#: Default length of the rays, as a share of the diagonal of the scene's bounds.
REACH = 0.1


def spawn_ambient_rays(stream: PathStream, band: Band) -> PathStream:
    """Stage: spawn rays from the hits; the paths end."""
    context = band.context
    count = context.options["rays"]
    rays = ShadowRays.empty(len(stream) * count)
    surfaces = surfaces_of(stream, band)
    ray_count = spawn_ao_rays(
        surfaces.batch,
        surfaces.tables,
        PixelSample(sampler_of(context), band.sample),
        OcclusionOptions(count, distance_of(context)),
        rays,
    )
    sectors = sectors_of(stream, band)
    return PathStream(stream.paths.first(0), rays=rays.first(ray_count), sectors=sectors)


def sampler_of(context: RenderContext) -> Sampler:
    """The context's sampler, with a sample for each ray."""
    count = context.sampler.sample_count * context.options["rays"]
    return context.sampler._replace(sample_count=count)


def distance_of(context: RenderContext) -> float:
    """Length of the context's rays, world space."""
    distance = context.options["distance"]
    if distance is not None:
        return float(distance)
    low, high = context.tracer.scene.bounds
    return REACH * float(np.linalg.norm(high - low))


def _rays_per_pixel(context: RenderContext) -> int:
    return int(context.options["rays"])


def _check(options: Mapping[str, Any]) -> Mapping[str, Any]:
    rays = check_whole("rays", options["rays"], 1, MAX_RAYS)
    if options["distance"] is None:
        return {"rays": rays, "distance": None}
    distance = check_number("distance", options["distance"])
    if distance <= 0.0:
        raise ValueError(f"distance: expected a number above 0, or inf, got {distance}")
    return {"rays": rays, "distance": distance}


AO = Integrator(
    "ao",
    "ambient occlusion: 32 rays from the first hit (Rayforce 2013)",
    (find_surfaces, spawn_ambient_rays, trace_shadow_rays),
    {"rays": 32, "distance": None},
    _check,
    _rays_per_pixel,
)
