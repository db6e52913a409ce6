"""vis: visible surfaces, shaded by facing ratio (Rayforce 2013)."""

from __future__ import annotations

from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    find_surfaces,
    take_no_options,
)
from raystream.rendering.shading.local_shading import shade_facing_ratio
from raystream.rendering.surfaces import surfaces_of


def shade_by_facing_ratio(stream: PathStream, band: Band) -> PathStream:
    """Stage: shade in grey, by the cosine between normal and view; the paths end."""
    surfaces = surfaces_of(stream, band)
    shade_facing_ratio(surfaces.batch, surfaces.tables, band.context.punctual)
    return PathStream(stream.paths.first(0))


VIS = Integrator(
    "vis",
    "visible surfaces in grey, N.V shading (Rayforce 2013)",
    (find_surfaces, shade_by_facing_ratio),
    {},
    take_no_options,
)
