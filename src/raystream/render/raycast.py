"""raycast: the nearest surface under the scene's lights, without shadows (Purcell 2002, 3.2).

The picture is what the standard graphics pipeline would show: vertex colours times the
material, diffuse and Phong terms of every light, nothing in the way of any light.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.render.lighting import arriving_light
from raystream.render.stages import Frame, RayStream, Renderer, find_first_hits

__all__ = ["RAYCAST"]


def shade_by_lights(stream: RayStream, frame: Frame) -> RayStream:
    """Stage: emitted light, and what each light adds by Lambert's and Phong's terms."""
    assert stream.hits is not None
    points = frame.surfaces.at(stream.hits, stream.directions)
    looks = frame.looks
    diffuse = looks.diffuse.at(points.material_ids, points.texcoords) * points.colors
    specular = looks.specular.at(points.material_ids, points.texcoords)
    radiance = looks.emission.at(points.material_ids, points.texcoords) * points.front[:, None]

    lengths = np.linalg.norm(stream.directions, axis=1, keepdims=True)
    view = stream.directions / lengths
    mirrored = view - 2.0 * _dot(view, points.normals) * points.normals
    for toward, irradiance in arriving_light(points.positions, frame.lights, frame.patches):
        received = irradiance / np.float32(math.pi)
        if toward is None:
            radiance += diffuse * received
            continue
        cosine = np.maximum(_dot(points.normals, toward), 0.0)
        radiance += diffuse * (cosine * received)
        if not looks.specular.is_black:
            highlight = np.maximum(_dot(mirrored, toward), 0.0)
            exponent = looks.shininess[points.material_ids]
            lit = np.where(cosine > 0.0, highlight**exponent, 0.0)
            radiance += specular * (lit * received)
    frame.film.add(stream.pixels, stream.weights * radiance)
    return RayStream.none()


def _dot(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Row by row, shape (N, 1)."""
    result: NDArray[np.float32] = np.einsum("nk,nk->n", a, b)[:, None]
    return result


RAYCAST = Renderer(
    "raycast",
    "nearest surface under the lights, no shadows (Purcell 2002)",
    (find_first_hits, shade_by_lights),
)
