"""Decisions for a view: its camera, and lights where a scene's own do not reach what it sees."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamWarning
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.color import LUMINANCE
from raystream.rendering.contexts import make_context, seen_by, with_bands, with_lights
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.lighting import (
    ADDED,
    MEASURED,
    PATHS,
    added_light,
    is_dark_by_intent,
    needs_light,
)
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.camera import Camera
from raystream.tracer import Tracer

#: The trial: strips of the image, in blocks whose means count, since one sample is noisy. Whole
#: rows go to the kernels that the image needs; sparse pixels went to others, and compiled them.
_STRIPS, _ROWS, _BLOCKS = 6, 2, 8

#: A view is dark if no more than this share of the blocks with surfaces is this bright: a tenth of
#: a screen's range, encoded. Lights of the scene itself may be meant to light little.
_LEAST_SHARE, _LEAST_SHARE_IF_ADDED, _LEAST_LUMINANCE = 0.05, 0.25, 0.01

#: Size of the images for which the viewer and pages choose lights: the default of `render`.
USUAL_SIZE = 1024, 768

#: Most triangles that a trial searches by brute force; a BVH of more is built in less time.
_MOST_BY_BRUTE_FORCE = 4096


def decide(
    renderer: Integrator,
    tracer: Tracer,
    camera: Camera | None,
    size: tuple[int, int],
    sampler: Sampler,
    options: Mapping[str, Any],
    layers: Sequence[str] = (),
    lights: str = "auto",
) -> RenderContext:
    """Decide what a view needs, once for all devices: its camera, and its lights.

    Parameters
    ----------
    renderer : Integrator
    tracer : Tracer
        Of the scene, on any device and machine, with any structure.
    camera : Camera, optional
        [default: `Scene.camera_for` the size]
    size : (int, int)
    sampler : Sampler
    options : mapping
        Of the renderer, as its `check` returns them.
    layers : sequence of str
    lights : {"auto", "file", "added"}
        See `lit`, which warns.

    Returns
    -------
    RenderContext
        Its ``camera`` and ``chosen_lights`` hold the decisions. Given to `make_context`, on any
        device or machine, they make the same view.
    """
    view = camera or tracer.scene.camera_for(size[0] / size[1])
    return lit(renderer, make_context(tracer, view, size, sampler, options, layers, lights))


def usual_context(renderer: Integrator, context: RenderContext, camera: Camera) -> RenderContext:
    """The context as in an image by the defaults of `render`, whatever the size of a window."""
    usual = Sampler.of("sobol", 0, renderer.default_samples)
    return seen_by(replace(context, sampler=usual), camera, USUAL_SIZE)


def lit(renderer: Integrator, context: RenderContext) -> RenderContext:
    """The context, with lights added if its own leave what the camera sees in the dark.

    One sample of some rows is rendered with the lights of the context, by the mode itself. If they
    are dark where there are surfaces, the scene gets the lights of ``"added"``; a scene that has
    lights, which do not suffice, is warned of.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
        Unless its lights are ``"auto"``, it is returned as it is, as for modes without lights.

    Notes
    -----
    The CPU decides, without passes, whatever the tracer's device and machine: rounding on another
    device, or a structure, changes nothing. The structure is the tracer's own, unless it is brute
    force in a large scene. There is no trial where it cannot change the image: in modes that add
    nothing but a light at the eye, which the scene has already.
    """
    chosen = well_lit(renderer, context)
    scene, asked = context.tracer.scene, context.chosen_lights
    if not _may_add(renderer, context):
        return chosen
    added = added_light(scene, renderer.name, chosen.chosen_lights)
    if added:
        is_weak = bool(added_light(scene, renderer.name, asked))
        why = "are too weak to see by" if is_weak else "do not reach what the camera sees"
        warnings.warn(
            f"the scene's own lights {why}: added {added} (lights='file' or --lights file uses "
            "only the scene's own)",
            RaystreamWarning,
            stacklevel=4,
        )
    return chosen


def well_lit(renderer: Integrator, context: RenderContext) -> RenderContext:
    """The context of `lit`, without a warning."""
    tracer = context.tracer
    if context.chosen_lights != "auto" or not _may_add(renderer, context):
        return context
    if renderer.name not in PATHS and needs_light(tracer.scene):  # has all that would be added
        return context
    seen = replace(context, tracer=_on_cpu(tracer), bands=None)
    if _shows(renderer, seen):
        return context
    lighter = with_lights(seen, "added")
    if not _shows(renderer, lighter):  # paths without bounces see no light that is added
        return context
    return with_bands(replace(lighter, tracer=tracer))


def _on_cpu(tracer: Tracer) -> Tracer:
    """A tracer of the same scene on the CPU, for a few rays: no passes, no other rounding."""
    structure = tracer.structure
    if structure.name == "brute" and len(structure.triangles) > _MOST_BY_BRUTE_FORCE:
        return Tracer(tracer.scene)
    if (tracer.device, tracer.machine) == ("cpu", "branching"):
        return tracer
    return Tracer.of_structure(structure.on_host, tracer.scene)


def _may_add(renderer: Integrator, context: RenderContext) -> bool:
    is_choice = context.chosen_lights in ("auto", MEASURED) and renderer.name in ADDED
    return is_choice and not is_dark_by_intent(context.tracer.scene)


def kept_choice(context: RenderContext) -> str:
    """The choice of lights of a context from `lit`, for other views of the same scene."""
    return MEASURED if context.chosen_lights == "auto" else context.chosen_lights


def _shows(renderer: Integrator, context: RenderContext) -> bool:
    """Whether the image shows more than darkness where there are surfaces."""
    bare = replace(context, bands=None, layers=(), options=_sampling_lights(context.options))
    width, size = context.width, (context.width, context.height)
    lit_count = block_count = 0
    for rows in _strips(context.height):
        paths = camera_paths(context.camera, size, context.sampler, rows, 0)
        hits = context.tracer.first_hit(paths.origins, paths.directions)
        is_surface = (hits.prim_id >= 0).reshape(len(rows), width)
        light = renderer.trace(bare, rows, 0).reshape(len(rows), width, 3)
        luminance = np.nan_to_num(light.astype(np.float64) @ LUMINANCE, posinf=0.0)
        counts = _blocks(is_surface)
        sums = _blocks(np.where(is_surface, luminance, 0.0))
        seen = counts > 0.0
        lit_count += int((sums[seen] / counts[seen] > _LEAST_LUMINANCE).sum())
        block_count += int(seen.sum())
    share = _LEAST_SHARE_IF_ADDED if context.is_light_added else _LEAST_SHARE
    return lit_count > share * block_count or not block_count  # no light would help


def _sampling_lights(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """A mode's options, with lights sampled: a path that finds them by chance rarely does."""
    if options.get("light_samples", True):
        return options
    return {**options, "rules": options["rules"]._replace(samples_lights=True)}


def sees_surface(tracer: Tracer, camera: Camera, size: tuple[int, int]) -> bool:
    """Whether a camera sees any surface, as far as some rows of an image of this size show."""
    width, height = size
    x = np.arange(width) + 0.5
    for rows in _strips(height):
        hits = tracer.first_hit(*camera.rays(width, height, x, np.array(rows)[:, None] + 0.5))
        if (hits.prim_id >= 0).any():
            return True
    return False


def _strips(height: int) -> list[range]:
    """Rows of strips that are spread over an image."""
    firsts = np.linspace(0, max(height - _ROWS, 0), _STRIPS).astype(int).tolist()
    return [range(first, min(first + _ROWS, height)) for first in firsts]


def _blocks(values: NDArray[Any]) -> NDArray[np.float64]:
    """Sums over blocks of a strip, from left to right."""
    columns = values.sum(axis=0, dtype=np.float64)
    width = -(-len(columns) // _BLOCKS)
    return np.add.reduceat(columns, np.arange(0, len(columns), width))
