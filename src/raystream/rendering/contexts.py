"""Contexts of images: what all stages of one image share, made for a tracer, camera and options."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from raystream.core.errors import RaystreamWarning
from raystream.core.scene_kinds import check_support
from raystream.rendering.integrator import RenderContext
from raystream.rendering.lighting import has_visible_light, needs_light
from raystream.rendering.opacity import Opacity
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.light_tables import lights_of
from raystream.rendering.shading.punctual_lights import punctual_lights_of
from raystream.rendering.shading.tables import EMITS, IS_TEXTURED, tables_of
from raystream.rendering.surfaces import objects_of
from raystream.scene.camera import Camera
from raystream.tracer import Tracer


def make_context(
    tracer: Tracer,
    camera: Camera,
    size: tuple[int, int],
    sampler: Sampler,
    options: Mapping[str, Any],
    layers: Sequence[str] = (),
    chosen_lights: str = "auto",
) -> RenderContext:
    """Prepare a tracer's scene for shading; see `tables_of` for warnings."""
    scene = tracer.scene
    if not scene.is_opaque:
        check_support("materials that are not opaque", tracer.structure.triangles)
    tables, kept_tables = tables_of(scene)
    if options.get("diffuse_only"):
        tables = tables._replace(kinds=tables.kinds & (EMITS | IS_TEXTURED))
    lights, kept_lights = lights_of(tracer.scene, camera, chosen_lights)
    if not options.get("light_samples", True) and not has_visible_light(
        tracer.scene, chosen_lights
    ):
        warnings.warn(
            "light_samples=False: no ray can hit this scene's lights, which are points and "
            "directions, so the image is black; sample the lights, or add a surface or a sky that "
            "emits",
            RaystreamWarning,
            stacklevel=3,
        )
    punctual, kept_punctual = punctual_lights_of(tracer.scene, camera, chosen_lights)
    kept = kept_tables, kept_lights, kept_punctual
    opacity = Opacity.of(tracer.scene, sampler.seed)
    made = RenderContext(
        tracer,
        camera,
        *size,
        tables,
        lights,
        punctual,
        sampler,
        opacity,
        options,
        kept,
        layers,
        chosen_lights,
        needs_light(scene, chosen_lights, background=scene.background),
        objects=objects_of(scene, kept_tables),
    )
    return with_bands(made)


def seen_by(
    context: RenderContext, camera: Camera, size: tuple[int, int] | None = None
) -> RenderContext:
    """The same scene from another camera, or in another size.

    Shares everything that does not depend on them, and so is much faster than
    `make_context`: for interactive cameras.
    """
    scene, chosen = context.tracer.scene, context.chosen_lights
    punctual, kept_punctual = punctual_lights_of(scene, camera, chosen)
    lights, kept_lights = context.lights, context.kept[1]
    if chosen == "added" or context.is_light_added:  # their place depends on the camera
        lights, kept_lights = lights_of(scene, camera, chosen)
    width, height = size or (context.width, context.height)
    made = replace(
        context,
        camera=camera,
        width=width,
        height=height,
        lights=lights,
        punctual=punctual,
        kept=(context.kept[0], kept_lights, kept_punctual),
    )
    return with_bands(made)


def with_lights(context: RenderContext, chosen: str) -> RenderContext:
    """The same with another choice of lights; see `lighting.needs_light`."""
    return seen_by(replace(context, chosen_lights=chosen), context.camera)


def with_bands(context: RenderContext) -> RenderContext:
    """The same with `bands` of the tracer's device or machine."""
    bare = replace(context, bands=None)  # else each would keep the one before
    bands, machine = context.tracer.bands_on_device(bare), context.tracer.loop_machine
    if machine is not None:
        # Here, since it loads all renderers: 40 ms.
        from raystream.rendering.ray_loops import MultipassBands

        bands = MultipassBands(bare, machine)
    return replace(bare, bands=bands)
