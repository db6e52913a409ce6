"""path: path tracing, one path per sample (Purcell 2002, 3.1.4; Kajiya 1986).

With next-event estimation at each surface; without, and with two bounces of diffuse reflection, it
is Purcell's path tracer: the preset ``"arnold"``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from raystream.rendering.arguments import check_number, check_switch, check_whole
from raystream.rendering.integrator import (
    MAX_BOUNCES,
    Band,
    Integrator,
    PathStream,
    find_surfaces,
    sectors_of,
    trace_shadow_rays,
)
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.paths import PathOptions, shade_paths, shade_plain_paths
from raystream.rendering.shading.plain_scenes import kernel_for
from raystream.rendering.shading.shadow_rays import ShadowRays
from raystream.rendering.surfaces import surfaces_of

#: Russian roulette starts at this bounce: earlier ones carry nearly all of the light.
ROULETTE_BOUNCE = 3


def shade_surfaces(stream: PathStream, band: Band) -> PathStream:
    """Stage: add emitted light, sample the lights by shadow rays, and scatter the paths."""
    context, paths = band.context, stream.paths
    rays, sectors = ShadowRays.empty(len(stream)), sectors_of(stream, band)
    surfaces = surfaces_of(stream, band)
    shade = kernel_for(shade_paths, shade_plain_paths, context.tables, context.lights)
    path_count, ray_count = shade(
        surfaces.batch,
        surfaces.tables,
        context.lights,
        PixelSample(context.sampler, band.sample),
        stream.bounce,
        context.options["rules"],
        paths,
        rays,
    )
    left = paths.first(path_count)
    return PathStream(left, stream.bounce + 1, rays=rays.first(ray_count), sectors=sectors)


def check_path(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Path options, checked; ``light_samples`` and ``diffuse_only`` may be missing."""
    bounces = check_whole("max_bounces", options["max_bounces"], 0, MAX_BOUNCES)
    samples_lights = check_switch("light_samples", options.get("light_samples", True))
    diffuse_only = check_switch("diffuse_only", options.get("diffuse_only", False))
    clamp = check_number("clamp", options["clamp"])
    if not clamp > 0.0:
        raise ValueError(f"clamp: expected a number above 0, got {clamp}")
    with np.errstate(over="ignore", under="ignore"):
        most = np.float32(clamp)
    follows_last = bool(options.get("follows_last", True))
    rules = PathOptions(bounces, samples_lights, ROULETTE_BOUNCE, most, follows_last)
    return {"rules": rules, "diffuse_only": diffuse_only, "light_samples": samples_lights}


PATH_STAGES = (find_surfaces, shade_surfaces, trace_shadow_rays)

#: Purcell's path tracer, which "emulates the Arnold renderer" (2002, section 3.1.4): two bounces of
#: Lambert's reflection, until a ray hits a light.
PRESETS = {"arnold": {"max_bounces": 2, "light_samples": False, "diffuse_only": True}}

PATH = Integrator(
    "path",
    "global illumination, one path per sample (Kajiya 1986, Purcell 2002)",
    PATH_STAGES,
    {"max_bounces": 8, "light_samples": True, "clamp": math.inf, "diffuse_only": False},
    check_path,
    presets=PRESETS,
    default_samples=16,
)
