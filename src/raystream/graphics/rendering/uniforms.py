"""The uniform ``Shading`` of ``shading.wgsl``: what all pixels of a band share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.graphics.camera import packed_view
from raystream.graphics.packing import FAR
from raystream.graphics.rendering.modes import Mode
from raystream.graphics.structures.base import numbers
from raystream.rendering.integrator import RenderContext
from raystream.rendering.sampling.quad_matrix import quad_matrix


class BandPlace(NamedTuple):
    """A sample of some pixels.

    Attributes
    ----------
    first_pixel, pixel_count, sample : int
    room : int
        Paths of a pixel and bounce for which there are rows.
    """

    first_pixel: int
    pixel_count: int
    sample: int
    room: int


def shading_uniform(context: RenderContext, mode: Mode, place: BandPlace) -> bytes:
    """The bytes of ``Shading``."""
    scene, camera = context.tracer.scene, context.camera
    frame, options = scene.triangles, context.options
    scale = float(frame.scale)
    eye = (np.array(camera.eye, np.float64) - frame.center) * scale
    low, high = frame.bounds
    lights, sky = context.punctual, context.punctual.sky
    most = float(FAR)
    if mode.samples_lights:
        sky, most = context.lights.sky, min(float(options["rules"].clamp), most)
    counts = context.lights
    words = numbers(
        *map(float, eye - eye.astype(np.float32)),
        0.5 * camera.aperture * scale,
        *map(float, low),
        camera.focus_distance * scale,
        *map(float, high),
        float(np.abs(frame.center).max()) * scale,
        *map(float, lights.ambient),
        float(options.get("min_weight", 0.0)),
        *map(float, sky.color),
        most,
        *(place.first_pixel, place.sample, context.sampler.seed, place.pixel_count),
        *(mode.shadow_count(context), int(lights.light_count), place.room),
        int(len(scene.attributes.material_ids) > 0 and context.tables.faces != 0),
        *(int(counts.point_count), int(counts.sun_count), int(counts.prim_count), 0),
    )
    size = context.width, context.height
    return packed_view(camera, size, frame) + words + quad_matrix().tobytes()
