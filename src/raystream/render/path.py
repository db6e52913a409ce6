"""path: paths of light from surface to surface, one for each sample (Purcell 2002, 3.2).

With two bounces it is Purcell's path tracer ("one path per sample"); with many it is the
rendering equation's (Kajiya 1986), with samples of the lights at each surface. `kajiya` is the
Rayforce poster's: the first surface and two diffuse bounces, with a shadow ray at each.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from raystream.render.arguments import check_whole
from raystream.render.sampled import Band, PathStream, SampledRenderer, find_surfaces
from raystream.render.shading.paths import LightRays, PathRules, add_unblocked, follow_paths

__all__ = ["KAJIYA", "PATH"]

#: Most surfaces on a path, for `max_bounces`.
MAX_BOUNCES = 1000

#: From so many bounces on, dim paths end by chance: before, nearly all of the light comes.
ROULETTE_BOUNCE = 3


def meet_surfaces(stream: PathStream, band: Band) -> PathStream:
    """Stage: add light that surfaces emit, ask for that of lights, and scatter the paths."""
    assert stream.hits is not None
    setting, paths, hits = band.setting, stream.paths, stream.hits
    rays = LightRays.empty(len(stream))
    path_count, ray_count = follow_paths(
        paths,
        (hits.t, hits.u, hits.v, hits.prim_id),
        setting.tables,
        setting.lights,
        setting.sampler,
        band.sample,
        stream.bounce,
        setting.options["rules"],
        band.first_pixel,
        band.radiance,
        paths,
        rays,
    )
    return PathStream(paths.first(path_count), stream.bounce + 1, rays=rays.first(ray_count))


def reach_lights(stream: PathStream, band: Band) -> PathStream:
    """Stage: add what the lights send where nothing is in the way."""
    rays = stream.rays
    assert rays is not None
    if len(rays.pixels):
        blocked = band.setting.tracer.any_hit(rays.origins, rays.directions, t_max=rays.t_max)
        add_unblocked(rays, blocked, band.first_pixel, band.radiance)
    return replace(stream, rays=None)


def _check(options: Mapping[str, Any]) -> Mapping[str, Any]:
    bounces = check_whole("max_bounces", options["max_bounces"], 0, MAX_BOUNCES)
    samples_lights = options.get("light_samples", True)
    if not isinstance(samples_lights, bool):
        raise ValueError(f"light_samples: expected True or False, got {samples_lights!r:.40}")
    return {"rules": PathRules(bounces, samples_lights, ROULETTE_BOUNCE)}


_STAGES = (find_surfaces, meet_surfaces, reach_lights)

PATH = SampledRenderer(
    "path",
    "light by any way, one path for each sample (Kajiya 1986, Purcell 2002)",
    _STAGES,
    {"max_bounces": 8, "light_samples": True},
    _check,
)

KAJIYA = SampledRenderer(
    "kajiya",
    "the first surface and two bounces, a shadow ray at each (Rayforce 2013)",
    _STAGES,
    {"max_bounces": 3},
    _check,
)
