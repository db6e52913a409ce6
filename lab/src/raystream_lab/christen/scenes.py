"""Scenes A, B and C, and the rays of each bounce in them (Christen 2005, sections 5.2 and 6.2)."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from raystream.core.errors import RaystreamError
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.integrator import (
    Band,
    Integrator,
    PathStream,
    RenderContext,
)
from raystream.rendering.render import RENDERERS
from raystream.scene.load import load
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.frame_timing import render_context
from raystream_lab.published import published
from raystream_lab.recording_tracer import RecordingTracer
from raystream_lab.runner import Runner

#: Our versions of his scenes, and the known differences.
SCENES = {
    "A": (
        "three_boxes",
        (
            "his arrangement and mirrors are not known; ours are two boxes that reflect 0.6 of the "
            "light, on a flat box that reflects 0.3"
        ),
    ),
    "B": (
        "cubes",
        (
            "his positions and mirrors are not known; ours are 171 cubes that float in a room; a "
            "third are mirrors, the others reflect 0.1 of the light"
        ),
    ),
    "C": (
        "boxes",
        (
            "his has objects of many and of few triangles; ours has rounded boxes of 4,800 "
            "triangles among plain boxes, some of steel that reflects 0.7 of the light"
        ),
    ),
}

#: The teapot of about 60,000 triangles in his appendix, and the share of light that ours reflects:
#: his material is not known.
TEAPOT = "teapot"
_TEAPOT_MODEL, _STAND_IN = "teapot_bezier", "spheres"
_TEAPOT_REFLECTION = 0.3

#: Scene A with a flat box that is no mirror: his mirrors are not known.
MATTE_BASE = "A, matte base"


class Bounce(NamedTuple):
    """Rays that are traced together.

    Attributes
    ----------
    iteration : int
        Christen's term: 1 for camera rays, 2 for reflections from the first surfaces.
    origins, directions : ndarray of shape (N, 3)
    light_ray_count : int
        Shadow rays from their hits; Christen has none.
    """

    iteration: int
    origins: Any
    directions: Any
    light_ray_count: int


def christen_scene(letter: str) -> Scene:
    """Scene A, B, C, `TEAPOT` or `MATTE_BASE`; none refracts, which his renderer lacks."""
    if letter == TEAPOT:
        scene, _ = teapot_model()
        return scene
    if letter != MATTE_BASE:
        return load(SCENES[letter][0])
    scene = load(SCENES["A"][0])
    base, *boxes = scene.materials
    return scene.replace(materials=[replace(base, reflection=(0.0, 0.0, 0.0)), *boxes])


def teapot_model() -> tuple[Scene, str]:
    """His teapot, and how ours differs: another scene stands in where the model is missing."""
    try:
        scene = load(_TEAPOT_MODEL)
    except RaystreamError:
        scene = load(_STAND_IN)
        solid = [replace(one, transmission=(0.0, 0.0, 0.0)) for one in scene.materials]
        about = f"no model of a teapot was found: `{_STAND_IN}` replaces it, without glass"
        return scene.replace(materials=solid), about
    mirror = (_TEAPOT_REFLECTION,) * 3
    polished = [replace(one, reflection=mirror) for one in scene.materials]
    return scene.replace(materials=polished), (
        "his triangles are not known; ours are Newell's 32 patches in 31 x 31 cells, and reflect "
        f"{_TEAPOT_REFLECTION:g} of the light"
    )


def image_size(runner: Runner) -> int:
    """Width and height of his images, 256, or the user's size."""
    return runner.device_size(published("christen", "settings").values["size"])


def timed_iterations(
    context: RenderContext, tracer: Tracer, size: int, iterations: int, *, shadows: bool = False
) -> tuple[list[float], float]:
    """Render an image with ``whitted``, all pixels together, and time each bounce.

    Parameters
    ----------
    context : RenderContext
        Of the tracer's scene.
    tracer : Tracer
    size : int
        Width and height.
    iterations : int
        Maximum surfaces per path.
    shadows : bool
        Trace shadow rays, which his renderer does not.

    Returns
    -------
    seconds : list of float
        From the start to the end of each iteration; the last value repeats once no ray is left.
    light : float
        Mean radiance of the image, to compare two.
    """
    renderer = RENDERERS["whitted"]
    assert isinstance(renderer, Integrator)
    own_options = {"max_bounces": iterations - 1, "min_weight": 0.0, "shadows": shadows}
    options = renderer.check(renderer.complete(own_options))
    own = replace(context, tracer=tracer, width=size, height=size, options=options)
    radiance = np.zeros((size * size, 3), np.float32)
    band = Band(own, 0, 0, radiance)
    seconds: list[float] = []
    started = time.perf_counter()
    stream = PathStream(camera_paths(own.camera, (size, size), own.sampler, range(size), 0))
    while len(stream):
        for stage in renderer.stages:
            stream = stage(stream, band)
        seconds.append(time.perf_counter() - started)
    seconds += [seconds[-1]] * (iterations - len(seconds))
    return seconds, float(radiance.mean(dtype=np.float64))


def bounces_of(scene: Scene, size: int, iterations: int) -> list[Bounce]:
    """The rays that ``whitted`` traces for an image, by bounce."""
    tracer = RecordingTracer(scene, keep_rays=True)
    context = render_context(tracer, (size, size))
    timed_iterations(context, tracer, size, iterations, shadows=True)
    found: list[Bounce] = []
    for one in tracer.queries:
        if one.query == "first_hit":
            found.append(Bounce(len(found) + 1, one.origins, one.directions, 0))
        else:
            count = found[-1].light_ray_count + one.ray_count
            found[-1] = found[-1]._replace(light_ray_count=count)
    return found
