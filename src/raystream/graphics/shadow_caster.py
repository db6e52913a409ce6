"""Hybrid rendering: visibility by rasterisation, shadows by ray tracing.

Purcell 2002, section 3.2 (the shadow caster): the standard graphics pipeline finds the visible
surfaces in a first pass; a second one traces a shadow ray from there to each light. There are no
camera rays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.hits import Hits
from raystream.graphics.raster import Visibility, visibility
from raystream.rendering.arguments import check_camera, check_size, make_tracer
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.image import Image
from raystream.rendering.integrator import Band, PathStream, RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.view_light import decide
from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

#: Most shadow rays at a time.
_MOST_RAYS = 1 << 18


def hybrid(
    scene: Scene | Tracer,
    size: tuple[int, int] = (1024, 768),
    structure: str | None = None,
    device: str | None = None,
    *,
    camera: Camera | None = None,
    adapter: str | None = None,
    **options: Any,
) -> Image:
    """Render an image: visible surfaces by rasterisation, shadows by ray tracing.

    Parameters
    ----------
    scene : Scene or Tracer
        A tracer, of any device; its structure is reused.
    size : (int, int)
        Width and height in pixels.
    structure, device, **options
        Arguments of the tracer of shadow rays, see `Tracer` [default: a BVH on the graphics
        device]. Not allowed with a tracer as `scene`.
    camera : Camera, optional
        Perspective; a lens is taken as a pinhole [default: the scene's].
    adapter : str, optional
        Adapter of the rasteriser, see `adapters.open_device`.

    Returns
    -------
    Image
        Linear RGB, that of ``render(scene, "shadow")`` except where `visibility` differs from
        primary rays; with the AOVs ``prim_id`` and ``depth``, the distance from the eye.

    Raises
    ------
    ValueError
        If an argument is out of range, the camera is not a perspective one, or some of the
        scene's surfaces are not opaque: the rasteriser keeps only the nearest.
    GraphicsError
        If there is no adapter, or the scene or the image is too large for it.
    """
    check_camera(camera)
    width, height = check_size(size)
    tracer = _tracer_of(scene, structure, device, options)
    shadow = RENDERERS["shadow"]
    chosen = shadow.check(shadow.options)
    centered = Sampler.of("sobol", 0, 1)
    context = decide(shadow, tracer, camera, (width, height), centered, chosen)
    if context.opacity is not None:
        raise ValueError("scene: some surfaces are not opaque, which rasterising does not support")
    seen = visibility(tracer.scene, (width, height), camera=context.camera, adapter=adapter)
    pixels = np.zeros((height, width, 3), np.float32)
    rows = max(1, _MOST_RAYS // (width * max(shadow.rays_per_pixel(context), 1)))
    for first in range(0, height, rows):
        band = range(first, min(first + rows, height))
        pixels[band.start : band.stop] = _shade(context, seen, band)
    return Image(pixels, {"prim_id": seen.prim_id, "depth": seen.t})


def _tracer_of(
    scene: Scene | Tracer, structure: str | None, device: str | None, options: dict[str, Any]
) -> Tracer:
    """The given tracer, or a new one of the scene."""
    if isinstance(scene, Tracer):
        return make_tracer(scene, structure or "bvh", device or "cpu", options)
    return make_tracer(scene, structure or "bvh", device or "graphics", options)


def _shade(context: RenderContext, seen: Visibility, rows: range) -> Any:
    """Shade some rows: the stages of the shadow renderer after its first."""
    count = len(rows) * context.width
    size = context.width, context.height
    band = Band(context, 0, rows.start * context.width, np.zeros((count, 3), np.float32))
    part = [array[rows.start : rows.stop].ravel() for array in (seen.t, seen.u, seen.v)]
    prim_id = seen.prim_id[rows.start : rows.stop].ravel()
    hits = Hits(
        part[0],
        part[1],
        part[2],
        prim_id,
        np.zeros(count, np.uint8),
        context.tracer.scene.triangles,
    )
    paths = camera_paths(context.camera, size, context.sampler, rows, 0)
    stream = PathStream(paths, hits=hits)
    for stage in RENDERERS["shadow"].stages:
        stream = stage(stream, band)
    return band.radiance.reshape(len(rows), context.width, 3)
