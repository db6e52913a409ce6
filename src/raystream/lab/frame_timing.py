"""Frames: whole pictures without display, timed; smaller ones where whole ones take too long."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from raystream.lab.results import Picture
from raystream.lab.runner import Runner
from raystream.rendering.integrator import RenderContext, make_context
from raystream.rendering.progressive import trace_sample
from raystream.rendering.render import RENDERERS, render
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["Size", "affordable_size", "frame_seconds", "picture", "render_context"]

Size = tuple[int, int]


def render_context(tracer: Tracer, size: Size) -> RenderContext:
    """What all modes need of a tracer's scene, through its own camera, for one sample a pixel.

    Tables of materials and lights are made here, once for a scene and not for each frame.
    """
    width, height = size
    camera = tracer.scene.camera_for(width / height)
    return make_context(tracer, camera, size, Sampler.of("sobol", 0, 1), {})


def frame_seconds(
    context: RenderContext, tracer: Tracer, mode: str, size: Size, **options: Any
) -> float:
    """Time a frame: rays from the eye, traversal, shading; not display.

    Parameters
    ----------
    context : RenderContext
        See `render_context`; of the tracer's scene, with any size.
    tracer : Tracer
    mode : str
        A key of `RENDERERS`, whose usual options hold unless others are given.
    size : (int, int)
    **options
    """
    renderer = RENDERERS[mode]
    chosen = renderer.check({**renderer.options, **options})
    width, height = size
    own = replace(context, tracer=tracer, width=width, height=height, options=chosen)
    started = time.perf_counter()
    trace_sample(renderer, own, 0)
    return time.perf_counter() - started


def affordable_size(seconds_a_pixel: float, size: Size, limit: float, least: Size) -> Size:
    """Halve a picture's sides until it takes no more than some seconds, or would be too small.

    Parameters
    ----------
    seconds_a_pixel : float
        As measured, in a small picture.
    size : (int, int)
        The one that is wanted.
    limit : float
        Seconds.
    least : (int, int)
        No side gets shorter than this picture's.
    """
    width, height = size
    while seconds_a_pixel * width * height > limit:
        if width // 2 < least[0] or height // 2 < least[1]:
            break
        width, height = width // 2, height // 2
    return width, height


def picture(
    runner: Runner, name: str, title: str, scene: Scene, mode: str, size: Size, **options: Any
) -> Picture:
    """Draw a scene for the report, unless the picture is there already.

    Parameters
    ----------
    runner : Runner
    name : str
        Of the file, without its suffix.
    title : str
    scene : Scene
    mode, size, **options
        See `render`.
    """
    path = runner.folder / f"{name.replace(' ', '_')}.png"
    if not path.exists():
        render(scene, mode, size, **options).save(path)
    return Picture(title, path)
