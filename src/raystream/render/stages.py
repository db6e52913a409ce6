"""Streams of rays, and the stages that renderers are made of.

A renderer is a list of stages. Each takes a stream of rays and returns one, as the boxes of
Purcell 2002, Figure 3 do; what the last stage returns (reflected rays, say) goes back to the
first, until no ray is left. So there is no recursion: what a ray contributes to its pixel
is in its weight (Christen 2005, chapter 5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.render.environment import image_light
from raystream.render.film import Film
from raystream.render.lighting import PatchLight
from raystream.render.looks import Looks
from raystream.render.shading.sky import seen_sky
from raystream.render.surfaces import Surfaces
from raystream.scene.camera import Camera
from raystream.scene.lights import Light
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["Frame", "RayStream", "Renderer", "Stage", "find_first_hits", "run_stages"]


@dataclass(frozen=True)
class RayStream:
    """Rays on their way, one record each.

    Attributes
    ----------
    pixels : ndarray of shape (N,), int64
        The pixel that each ray works for: row times width plus column.
    origins, directions : ndarray of shape (N, 3)
        World space.
    weights : ndarray of shape (N, 3), float32
        What part of the light that a ray finds reaches its pixel.
    hits : Hits, optional
        The nearest hits, once they are known.
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    weights: NDArray[np.float32]
    hits: Hits | None = None

    def __len__(self) -> int:
        return len(self.pixels)

    def select(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> RayStream:
        """The rays at these places."""
        return RayStream(
            self.pixels[index],
            self.origins[index],
            self.directions[index],
            self.weights[index],
            None if self.hits is None else self.hits[index],
        )

    @classmethod
    def none(cls) -> RayStream:
        """The stream without rays, which ends a renderer."""
        vectors = np.empty((0, 3), np.float32)
        return cls(np.empty(0, np.int64), vectors.astype(np.float64), vectors, vectors)


@dataclass(frozen=True)
class Frame:
    """What the stages of one picture share.

    Attributes
    ----------
    tracer : Tracer
    scene : Scene
    camera : Camera
    surfaces : Surfaces
        Attributes of the triangles.
    looks : Looks
        The materials.
    lights : sequence of Light
        The scene's, and what `lighting.classic_lights` adds.
    patches : sequence of PatchLight
        The scene's area lights, for shading without sampling.
    film : Film
    """

    tracer: Tracer
    scene: Scene
    camera: Camera
    surfaces: Surfaces
    looks: Looks
    lights: Sequence[Light]
    patches: Sequence[PatchLight]
    film: Film


Stage = Callable[[RayStream, Frame], RayStream]


@dataclass(frozen=True)
class Renderer:
    """A mode of rendering.

    Attributes
    ----------
    name : str
    description : str
        One line, with the source.
    stages : tuple of Stage
    """

    name: str
    description: str
    stages: tuple[Stage, ...]


def run_stages(stages: Sequence[Stage], stream: RayStream, frame: Frame) -> None:
    """Send a stream of rays round the stages until none is left."""
    while len(stream):
        for stage in stages:
            stream = stage(stream, frame)


def find_first_hits(stream: RayStream, frame: Frame) -> RayStream:
    """Stage: trace the rays; those that miss bring the background to their pixels and end."""
    hits = frame.tracer.first_hit(stream.origins, stream.directions)
    is_hit = hits.is_hit
    if any(frame.scene.background) or image_light(frame.scene.lights):
        missed = ~is_hit
        light = stream.weights[missed] * seen_sky(frame.scene, stream.directions[missed])
        frame.film.add(stream.pixels[missed], light)
    found = np.flatnonzero(is_hit)
    return RayStream(
        stream.pixels[found],
        stream.origins[found],
        stream.directions[found],
        stream.weights[found],
        hits[found],
    )
