"""raycast: the nearest surface under the scene's lights, without shadows (Purcell 2002, 3.2).

The picture is what the standard graphics pipeline would show: vertex colours times the
material, matte and glossy light of every light, nothing in the way of any.
"""

from __future__ import annotations

from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    find_surfaces,
    take_no_options,
)
from raystream.rendering.shading.first import light_unblocked

__all__ = ["RAYCAST", "shade_by_lights"]


def shade_by_lights(stream: PathStream, band: Band) -> PathStream:
    """Stage: light the surfaces by every light; the paths end."""
    assert stream.hits is not None
    setting, hits = band.setting, stream.hits
    light_unblocked(
        stream.paths,
        (hits.t, hits.u, hits.v, hits.prim_id),
        setting.tables,
        setting.classic,
        band.first_pixel,
        band.radiance,
    )
    return PathStream(stream.paths.first(0))


RAYCAST = Integrator(
    "raycast",
    "nearest surface under the lights, no shadows (Purcell 2002)",
    (find_surfaces, shade_by_lights),
    {},
    take_no_options,
)
