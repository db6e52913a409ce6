"""vis: what is visible, shaded by how squarely the viewer sees it (Rayforce 2013)."""

from __future__ import annotations

from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    find_surfaces,
    take_no_options,
)
from raystream.rendering.shading.first import shade_by_view

__all__ = ["VIS", "show_facing"]


def show_facing(stream: PathStream, band: Band) -> PathStream:
    """Stage: grey by the cosine between the normal and the direction to the viewer."""
    assert stream.hits is not None
    setting, hits = band.setting, stream.hits
    shade_by_view(
        stream.paths,
        (hits.t, hits.u, hits.v, hits.prim_id),
        setting.tables,
        setting.classic,
        band.first_pixel,
        band.radiance,
    )
    return PathStream(stream.paths.first(0))


VIS = Integrator(
    "vis",
    "visible surfaces in grey, N.V shading (Rayforce 2013)",
    (find_surfaces, show_facing),
    {},
    take_no_options,
)
