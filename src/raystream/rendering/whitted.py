"""whitted: shadows, mirrors and glass (Whitted 1980; Purcell 2002, 3.1.4).

Each hit spawns a shadow ray to each of L lights, a reflected and a refracted ray: L + 2 rays
(Purcell 2002, Figure 3). Only positions in the pixel are random.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from raystream.rendering.arguments import check_number, check_switch, check_whole
from raystream.rendering.integrator import (
    MAX_BOUNCES,
    Band,
    Integrator,
    PathStream,
    RenderContext,
    find_surfaces,
    trace_shadow_rays,
)
from raystream.rendering.shading.plain_scenes import kernel_for
from raystream.rendering.shading.shadow_rays import ShadowRays
from raystream.rendering.shading.streams import Paths
from raystream.rendering.shading.whitted import WhittedOptions, shade_plain_whitted, shade_whitted
from raystream.rendering.surfaces import surfaces_of


def sample_all_lights(stream: PathStream, band: Band) -> PathStream:
    """Stage: spawn a shadow ray to every light, and reflected and refracted rays."""
    context, count = band.context, len(stream)
    continues = stream.bounce < context.options["max_bounces"]
    rays = ShadowRays.empty(count * lights_per_pixel(context))
    onward = Paths.empty(2 * count if continues else 0)
    surfaces = surfaces_of(stream, band)
    shade = kernel_for(shade_whitted, shade_plain_whitted, context.tables, context.punctual)
    path_count, ray_count = shade(
        surfaces.batch,
        surfaces.tables,
        context.punctual,
        WhittedOptions(continues, context.options["min_weight"], context.options["casts_shadows"]),
        onward,
        rays,
    )
    return PathStream(onward.first(path_count), stream.bounce + 1, rays=rays.first(ray_count))


def lights_per_pixel(context: RenderContext) -> int:
    """Shadow rays of a pixel's first hit."""
    return int(context.punctual.light_count) if context.options.get("casts_shadows", True) else 0


def check_whitted(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Options, checked: ``max_bounces`` and ``min_weight`` [default: 0], ``shadows`` [True]."""
    bounces = check_whole("max_bounces", options.get("max_bounces", 0), 0, MAX_BOUNCES)
    weight = check_number("min_weight", options.get("min_weight", 0.0))
    if not (math.isfinite(weight) and weight >= 0.0):
        raise ValueError(f"min_weight: expected a number of at least 0, got {weight}")
    shadows = check_switch("shadows", options.get("shadows", True))
    return {"max_bounces": bounces, "min_weight": weight, "casts_shadows": shadows}


WHITTED_STAGES = (find_surfaces, sample_all_lights, trace_shadow_rays)

WHITTED = Integrator(
    "whitted",
    "shadows, mirrors and glass, without recursion (Whitted 1980, Christen 2005)",
    WHITTED_STAGES,
    {"max_bounces": 8, "min_weight": 1.0 / 512.0, "shadows": True},
    check_whitted,
    lights_per_pixel,
)
