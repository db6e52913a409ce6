"""View light: lights added where a scene's own do not reach what the camera sees."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamWarning
from raystream.rendering.color import LUMINANCE
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.lighting import ADDED, MEASURED, added_light, is_dark_by_intent
from raystream.rendering.sampling.sampler import Sampler

__all__ = ["kept_choice", "lit"]

#: The trial image, in blocks whose means count: one sample of few pixels is noisy.
_SIZE, _BLOCK = (64, 48), 8

#: A view is dark if no more than this share of the blocks with surfaces is this bright: a tenth of
#: a screen's range, encoded.
_LEAST_SHARE, _LEAST_LUMINANCE = 0.05, 0.01


def lit(renderer: Integrator, context: RenderContext) -> RenderContext:
    """The context, with lights added if its own leave what the camera sees in the dark.

    A small image of one sample is rendered with the lights of the context, by the mode itself. If
    it is dark where there are surfaces, the scene gets the lights of ``"added"``; a scene that has
    lights, which do not suffice, is warned of.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
        Unless its lights are ``"auto"``, it is returned as it is, as for modes without lights.

    Notes
    -----
    The same for any number of threads and on all structures. No trial is rendered by multipass
    machines, whose queries may take thousands of passes, and on CUDA.
    """
    scene = context.tracer.scene
    asked = context.chosen_lights
    if asked not in ("auto", MEASURED) or renderer.name not in ADDED or is_dark_by_intent(scene):
        return context
    is_weak = bool(added_light(scene, renderer.name, asked))
    chosen = context
    is_tried = asked == "auto" and context.tracer.has_cheap_queries
    if is_tried and not _shows(renderer, context):
        lighter = context.with_lights("added")
        if _shows(renderer, lighter):  # paths without bounces see no light that is added
            chosen = lighter
    added = added_light(scene, renderer.name, chosen.chosen_lights)
    if added:
        why = "are too weak to see by" if is_weak else "do not reach what the camera sees"
        warnings.warn(
            f"the scene's own lights {why}: added {added} (lights='file' or --lights file uses "
            "the scene's own only)",
            RaystreamWarning,
            stacklevel=3,
        )
    return chosen


def kept_choice(context: RenderContext) -> str:
    """The choice of lights of a context from `lit`, for other views of the same scene."""
    return MEASURED if context.chosen_lights == "auto" else context.chosen_lights


def _shows(renderer: Integrator, context: RenderContext) -> bool:
    """Whether the image shows more than darkness where there are surfaces."""
    width, height = (min(pair) for pair in zip(_SIZE, (context.width, context.height), strict=True))
    small = context.seen_by(context.camera, (width, height))
    sampler = Sampler.of("sobol", context.sampler.seed, 1)
    small = replace(small, sampler=sampler, bands=None, layers=())
    origins, directions = context.camera.rays(width, height)
    is_surface = context.tracer.first_hit(origins, directions).prim_id >= 0
    if not is_surface.any():
        return True  # no light would help
    light = renderer.trace(small, range(height), 0).reshape(height, width, 3)
    luminance = np.nan_to_num(light.astype(np.float64) @ LUMINANCE, posinf=0.0)
    luminance[~is_surface] = 0.0
    sums, counts = _blocks(luminance), _blocks(is_surface.astype(np.float64))
    is_bright = sums[counts > 0.0] / counts[counts > 0.0] > _LEAST_LUMINANCE
    return bool(is_bright.mean() > _LEAST_SHARE)


def _blocks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over blocks."""
    for axis in (0, 1):
        values = np.add.reduceat(values, np.arange(0, values.shape[axis], _BLOCK), axis)
    return values
