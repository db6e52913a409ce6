"""whitted and shadow: light from every light where nothing blocks it (Purcell 2002, 3.2).

`shadow` is Purcell's shadow caster: the first visible surface, and one shadow ray for each
light. `whitted` adds rays to mirrors and through glass, L + 2 for each surface (Purcell 2002,
Figure 3). Neither draws samples but for the places in the pixel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from raystream.render.arguments import check_number, check_whole
from raystream.render.path import MAX_BOUNCES, reach_lights
from raystream.render.sampled import Band, PathStream, SampledRenderer, find_surfaces
from raystream.render.shading.paths import LightRays, Paths
from raystream.render.shading.whitted import light_surfaces

__all__ = ["SHADOW", "WHITTED"]


def ask_every_light(stream: PathStream, band: Band) -> PathStream:
    """Stage: light the surfaces, by rays that are to be tested, and reflect and refract."""
    assert stream.hits is not None
    setting, hits, count = band.setting, stream.hits, len(stream)
    goes_on = stream.bounce < setting.options["max_bounces"]
    rays = LightRays.empty(count * int(setting.classic.light_count))
    onward = Paths.empty(2 * count if goes_on else 0)
    path_count, ray_count = light_surfaces(
        stream.paths,
        (hits.t, hits.u, hits.v, hits.prim_id),
        setting.tables,
        setting.classic,
        goes_on,
        setting.options["min_weight"],
        band.first_pixel,
        band.radiance,
        onward,
        rays,
    )
    return PathStream(onward.first(path_count), stream.bounce + 1, rays=rays.first(ray_count))


def _check(options: Mapping[str, Any]) -> Mapping[str, Any]:
    bounces = check_whole("max_bounces", options.get("max_bounces", 0), 0, MAX_BOUNCES)
    weight = check_number("min_weight", options.get("min_weight", 0.0))
    if not (math.isfinite(weight) and weight >= 0.0):
        raise ValueError(f"min_weight: expected a number of at least 0, got {weight}")
    return {"max_bounces": bounces, "min_weight": weight}


_STAGES = (find_surfaces, ask_every_light, reach_lights)

SHADOW = SampledRenderer(
    "shadow",
    "the nearest surface under the lights, with shadows (Purcell 2002)",
    _STAGES,
    {},
    _check,
)

WHITTED = SampledRenderer(
    "whitted",
    "shadows, mirrors and glass, without recursion (Whitted 1980, Christen 2005)",
    _STAGES,
    {"max_bounces": 8, "min_weight": 1.0 / 512.0},
    _check,
)
