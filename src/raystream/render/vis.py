"""vis: what is visible, shaded by how squarely the viewer sees it (Rayforce 2013)."""

from __future__ import annotations

import numpy as np

from raystream.render.stages import Frame, RayStream, Renderer, find_first_hits

__all__ = ["VIS"]


def shade_by_view(stream: RayStream, frame: Frame) -> RayStream:
    """Stage: grey by the cosine between the normal and the direction to the viewer."""
    assert stream.hits is not None
    points = frame.surfaces.at(stream.hits, stream.directions)
    lengths = np.linalg.norm(stream.directions, axis=1)
    cosine = np.abs(np.einsum("nk,nk->n", points.normals, stream.directions)) / lengths
    frame.film.add(stream.pixels, stream.weights * cosine[:, None])
    return RayStream.none()


VIS = Renderer(
    "vis",
    "visible surfaces in grey, N.V shading (Rayforce 2013)",
    (find_first_hits, shade_by_view),
)
