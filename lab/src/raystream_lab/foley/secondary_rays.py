"""Secondary rays: shadow rays to a light, and diffuse bounces."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.scene.lights import PointLight
from raystream.structures import Structure
from raystream.tracer import Tracer
from raystream_lab.diffuse_bounces import cosine_directions
from raystream_lab.views import View

_SEED = 20050731


class RayKind(NamedTuple):
    """Rays of an image, one row per pixel with a ray.

    Attributes
    ----------
    name : str
    origins, directions : ndarray of shape (N, 3)
        NaN where the camera ray misses.
    t_max : float
    any_hit : bool
        Whether to find any hit.
    pixels : ndarray of shape (N,), int64
        Index of each ray's pixel, row by row.
    """

    name: str
    origins: NDArray[Any]
    directions: NDArray[Any]
    t_max: float
    any_hit: bool
    pixels: NDArray[np.int64]

    def part(self, rows: NDArray[np.int64]) -> RayKind:
        """A subset of the rays."""
        return self._replace(
            origins=self.origins[rows], directions=self.directions[rows], pixels=self.pixels[rows]
        )


def ray_kinds(view: View, structure: Structure, size: int) -> list[RayKind]:
    """Primary rays, and from their hits shadow rays to the first light and diffuse bounces.

    Parameters
    ----------
    view : View
    structure : Structure
        Of the scene; finds the visible surfaces.
    size : int
        Width and height of the image.
    """
    origins, directions = (np.reshape(a, (-1, 3)) for a in np.broadcast_arrays(*view.rays(size)))
    primary = RayKind("primary", origins, directions, np.inf, False, np.arange(size**2))
    kinds = [primary]
    hits = first_hits(structure, primary)
    seen = np.flatnonzero(hits.is_hit)
    hits = hits[seen]
    lights = [one for one in view.scene.lights if isinstance(one, PointLight)]
    if lights:
        toward = np.asarray(lights[0].position) - hits.positions
        kinds.append(RayKind("shadow", *hits.spawn(toward), 1.0, True, seen))
    normals = np.asarray(hits.normals, np.float64)
    bounced = cosine_directions(normals, directions[seen], np.random.default_rng(_SEED))
    kinds.append(RayKind("diffuse", *hits.spawn(bounced), np.inf, False, seen))
    return kinds


def first_hits(structure: Structure, rays: RayKind) -> Hits:
    """First hits up to t_max."""
    tracer = Tracer.of_structure(structure)
    return tracer.first_hit(rays.origins, rays.directions, t_max=rays.t_max)
