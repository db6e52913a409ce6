"""Timing of whole frames without display, at a reduced size where they take too long."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from raystream.rendering.contexts import make_context, with_bands
from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS, render
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream_lab.results import ReportImage
from raystream_lab.runner import Runner

Size = tuple[int, int]


def render_context(tracer: Tracer, size: Size) -> RenderContext:
    """A render context for a tracer's scene and camera, with one sample per pixel.

    Tables of materials and lights are made here, once per scene and not per frame.
    """
    width, height = size
    camera = tracer.scene.camera_for(width / height)
    return make_context(tracer, camera, size, Sampler.of("sobol", 0, 1), {})


def frame_seconds(
    context: RenderContext, tracer: Tracer, mode: str, size: Size, **options: Any
) -> float:
    """Time a frame: camera rays, traversal and shading, without display.

    Parameters
    ----------
    context : RenderContext
        Of the tracer's scene, with any size; see `render_context`.
    tracer : Tracer
    mode : str
        A key of `RENDERERS`; its default options apply unless overridden.
    size : (int, int)
    **options
    """
    renderer = RENDERERS[mode]
    chosen = renderer.check(renderer.complete(options))
    width, height = size
    own = with_bands(replace(context, tracer=tracer, width=width, height=height, options=chosen))
    started = time.perf_counter()
    trace_sample(renderer, own, 0)
    return time.perf_counter() - started


def affordable_size(seconds_per_pixel: float, size: Size, limit: float, least: Size) -> Size:
    """Halve an image's sides until it takes at most `limit` seconds or reaches the minimum size.

    Parameters
    ----------
    seconds_per_pixel : float
        As measured in a small image.
    size : (int, int)
        The desired size.
    limit : float
        Seconds.
    least : (int, int)
        Minimum width and height.
    """
    width, height = size
    while seconds_per_pixel * width * height > limit:
        if width // 2 < least[0] or height // 2 < least[1]:
            break
        width, height = width // 2, height // 2
    return width, height


def report_image(
    runner: Runner, name: str, title: str, scene: Scene, mode: str, size: Size, **options: Any
) -> ReportImage:
    """Render a scene for the report, unless its image exists.

    Parameters
    ----------
    runner : Runner
    name : str
        File name without suffix.
    title : str
    scene : Scene
    mode, size, **options
        See `render`.
    """
    path = runner.folder / f"{name.replace(' ', '_')}.png"
    if not path.exists():
        render(scene, mode, size, **options).save(path)
    return ReportImage(title, path)
