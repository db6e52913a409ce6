"""raycast: the nearest surface under the scene's lights, without shadows (Purcell 2002, 3.1.4).

The image that the standard graphics pipeline renders: vertex colours times the material, diffuse
and glossy reflection of every light, and no shadows.
"""

from __future__ import annotations

from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    find_surfaces,
    take_no_options,
)
from raystream.rendering.shading.local_shading import shade_plain_unshadowed, shade_unshadowed
from raystream.rendering.shading.plain_scenes import kernel_for
from raystream.rendering.surfaces import surfaces_of


def shade_by_lights(stream: PathStream, band: Band) -> PathStream:
    """Stage: shade the hits by every light; the paths end."""
    surfaces, lights = surfaces_of(stream, band), band.context.punctual
    shade = kernel_for(shade_unshadowed, shade_plain_unshadowed, surfaces.tables, lights)
    shade(surfaces.batch, surfaces.tables, lights)
    return PathStream(stream.paths.first(0))


RAYCAST = Integrator(
    "raycast",
    "nearest surface under the lights, no shadows (Purcell 2002)",
    (find_surfaces, shade_by_lights),
    {},
    take_no_options,
)
