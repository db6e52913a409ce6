"""Ray sets: the same rays or points for all contenders, generated from a scene and its camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import Points, Query, Rays
from raystream.bench.point_sets import diagonal_of, grid_points, near_points, points_around
from raystream.core.hits import Hits
from raystream.scene.camera import Camera
from raystream.tracer import Tracer

#: Length of ambient occlusion rays, relative to the scene's diagonal.
AO_LENGTH = 0.1

#: Distance of the light from the eye, relative to the median distance of visible points; limited
#: to half of the free distance in its direction.
LIGHT_SHIFT = 0.25


class RaySet(NamedTuple):
    """Rays, and the query to run on them.

    Parameters
    ----------
    name : str
        A key of `RAY_SETS`.
    query : {"first", "any", "multi", "closest"}
    rays : Rays or Points
    """

    name: str
    query: Query
    rays: Any


class _View(NamedTuple):
    """Inputs of the ray generators."""

    tracer: Tracer
    camera: Camera
    primary: Rays
    hits: Hits  # of the primary rays that hit, in the order of the pixels
    generator: np.random.Generator


class _RaySetSpec(NamedTuple):
    query: Query
    title: str
    stream: int  # of random numbers: sets that are added leave the others as they are
    make: Callable[[_View], Rays | Points]


def make_ray_sets(
    tracer: Tracer, camera: Camera, size: tuple[int, int], names: Sequence[str], seed: int = 0
) -> Iterator[RaySet]:
    """Make ray sets, one at a time.

    Parameters
    ----------
    tracer : Tracer
        Finds where the camera's rays hit.
    camera : Camera
    size : (int, int)
        Image width and height, in pixels.
    names : sequence of str
        Keys of `RAY_SETS`.
    seed : int
        Seed of each set's random numbers: a set does not depend on which others are made.

    Yields
    ------
    RaySet
        All arrays are float32 and C-contiguous, of shape (N, 3), in the order of the pixels;
        those of ``image`` have the shape (height, width, 3). Rays that start at hits leave out
        pixels that miss. If no hits remain, or the scene has no extent, there are 0 rays. There
        are as many points as pixels, or at most as many in a grid.
    """
    width, height = size
    origins, directions = camera.rays(width, height)
    primary = Rays(np.ascontiguousarray(origins, np.float32), directions, np.inf)
    found = tracer.first_hit(primary.origins, primary.directions)
    hits = found[found.is_hit]
    for name, recipe in RAY_SETS.items():
        if name in names:
            generator = np.random.default_rng([seed, recipe.stream])
            rays = recipe.make(_View(tracer, camera, primary, hits, generator))
            yield RaySet(name, recipe.query, rays)


def _image(view: _View) -> Rays:
    return view.primary


def _primary(view: _View) -> Rays:
    """The camera's rays as a list, as most programs keep them."""
    return Rays(*view.primary.rows(), np.inf)


def _shadow(view: _View) -> Rays:
    """Rays to the light, which is at t = 1."""
    toward = _light(view) - view.hits.positions
    return _spawn(view, toward, 1.0)


def _light(view: _View) -> NDArray[np.float64]:
    """Place a light above the eye and to its right, in free space."""
    right, up, _ = view.camera.basis()
    away = (right + up) / np.sqrt(2.0)
    eye = np.asarray(view.camera.eye)
    seen = view.hits.t
    free = float(view.tracer.first_hit(eye, away).t)
    distance = LIGHT_SHIFT * float(np.median(seen)) if len(seen) else 1.0
    return eye + min(distance, 0.5 * free) * away


def _ao(view: _View) -> Rays:
    low, high = view.tracer.structure.triangles.world_bounds
    return _spawn(view, _cosine(view), AO_LENGTH * float(np.linalg.norm(high - low)))


def _bounce(view: _View) -> Rays:
    return _spawn(view, _cosine(view), np.inf)


def _cosine(view: _View) -> NDArray[np.float64]:
    """Cosine-distributed directions around each hit's normal, on the visible side."""
    normals = view.hits.normals.astype(np.float64)
    toward_eye = np.asarray(view.camera.eye) - view.hits.positions
    behind = np.einsum("ij,ij->i", normals, toward_eye) < 0.0
    normals[behind] *= -1.0
    # A point on the unit sphere around the normal's tip, as seen from its foot.
    directions = normals + _unit_vectors(view.generator, len(normals))
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    result: NDArray[np.float64] = np.where(lengths > 1e-6, directions, normals)
    return result / np.linalg.norm(result, axis=1, keepdims=True)


def _random(view: _View) -> Rays:
    """Uniform origins in the scene's box, uniform directions."""
    low, high = view.tracer.structure.triangles.world_bounds
    count = len(view.primary)
    origins = view.generator.uniform(low, high, (count, 3)).astype(np.float32)
    directions = _unit_vectors(view.generator, count).astype(np.float32)
    return Rays(origins, directions, np.inf)


def _around(view: _View) -> Points:
    """Uniform points in the scene's box, grown by half."""
    bounds = view.tracer.structure.triangles.world_bounds
    made = points_around(bounds, len(view.primary), view.generator)
    return Points(made, diagonal_of(bounds))


def _near(view: _View) -> Points:
    """Points near the surface."""
    triangles = view.tracer.structure.triangles
    made = near_points(triangles, len(view.primary), view.generator)
    return Points(made, diagonal_of(triangles.world_bounds))


def _grid(view: _View) -> Points:
    """A grid of points in the scene's box, in order."""
    bounds = view.tracer.structure.triangles.world_bounds
    return Points(grid_points(bounds, len(view.primary)), diagonal_of(bounds))


def _unit_vectors(generator: np.random.Generator, count: int) -> NDArray[np.float64]:
    vectors = generator.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _spawn(view: _View, directions: NDArray[np.float64], t_max: float) -> Rays:
    origins, directions = view.hits.spawn(directions)
    return Rays(
        np.ascontiguousarray(origins, np.float32),
        np.ascontiguousarray(directions, np.float32),
        t_max,
    )


#: The ray sets by name, in the order of the tables' rows.
RAY_SETS: Mapping[str, _RaySetSpec] = MappingProxyType(
    {
        "primary": _RaySetSpec("first", "primary, (N, 3)", 0, _primary),
        "image": _RaySetSpec("first", "primary, (H, W, 3)", 0, _image),
        "shadow": _RaySetSpec("any", "shadow", 1, _shadow),
        "ao": _RaySetSpec("any", "ambient occlusion", 2, _ao),
        "bounce": _RaySetSpec("first", "bounce", 3, _bounce),
        "random": _RaySetSpec("first", "random", 4, _random),
        "multi": _RaySetSpec("multi", "all hits, primary", 5, _primary),
        "random_multi": _RaySetSpec("multi", "all hits, random", 6, _random),
        "closest": _RaySetSpec("closest", "closest, around", 7, _around),
        "closest_near": _RaySetSpec("closest", "closest, near", 8, _near),
        "closest_grid": _RaySetSpec("closest", "closest, grid", 9, _grid),
    }
)

#: The ray sets traced by default.
DEFAULT_SETS = ("primary", "image", "shadow", "ao", "bounce", "random", "multi")
