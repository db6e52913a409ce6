"""The modes whose shading is in shaders, and what these do not support."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from raystream.graphics.packing import FAR as MOST_LENGTH
from raystream.kernels.ray import FAR
from raystream.rendering.ao import distance_of, spawn_ambient_rays
from raystream.rendering.integrator import PathStage, RenderContext
from raystream.rendering.path import shade_surfaces
from raystream.rendering.raycast import shade_by_lights
from raystream.rendering.sampling.sampler import KINDS
from raystream.rendering.shading.tables import ABSORBS, HAS_TRANSMISSION, IS_ROUGH
from raystream.rendering.shading_stages import shading_of
from raystream.rendering.vis import shade_by_facing_ratio
from raystream.rendering.whitted import lights_per_pixel, sample_all_lights
from raystream.scene.lights import SpotLight

#: Supported textures, and one that no renderer uses.
TEXTURES = frozenset(["diffuse", "occlusion"])


class Mode(NamedTuple):
    """A mode's shading in WGSL, for fragment programs and compute shaders.

    Attributes
    ----------
    shader : str
        Its file, see ``shade.wgsl``.
    shadow_count : callable
        ``shadow_count(context)``: most shadow rays of a path.
    last_bounce : callable
        ``last_bounce(context)``: at which paths spawn no paths.
    constants : callable
        ``constants(context)``: values of ``override`` declarations.
    branches : callable
        ``branches(context)``: most paths that a path spawns.
    samples_lights : bool
        Whether it chooses lights at random, see ``light_samples.wgsl``.
    """

    shader: str
    shadow_count: Callable[[RenderContext], int] = lambda _: 0
    last_bounce: Callable[[RenderContext], int] = lambda _: 0
    constants: Callable[[RenderContext], Mapping[str, float]] = lambda _: {}
    branches: Callable[[RenderContext], int] = lambda _: 1
    samples_lights: bool = False

    def spawns(self, context: RenderContext) -> bool:
        """Whether shading spawns rays."""
        return self.shadow_count(context) > 0 or self.samples_lights or self.is_whitted

    @property
    def is_whitted(self) -> bool:
        """Whether it has the shading of Whitted's ray tracing."""
        return self.shader == _WHITTED


_WHITTED = "rendering/whitted.wgsl"


def _branches(context: RenderContext) -> int:
    """Two behind glass, which reflects and refracts."""
    continues = context.options["max_bounces"] > 0
    return 2 if continues and context.tables.kinds & HAS_TRANSMISSION else 1


def _path_constants(context: RenderContext) -> Mapping[str, float]:
    rules = context.options["rules"]
    return {
        "SAMPLES_LIGHTS": float(rules.samples_lights),
        "ROULETTE_BOUNCE": float(rules.roulette_bounce),
        "FOLLOWS_LAST": float(rules.follows_last),
    }


def _ambient_constants(context: RenderContext) -> Mapping[str, float]:
    distance = distance_of(context) * float(context.tracer.scene.triangles.scale)
    return {"DISTANCE": min(distance, float(MOST_LENGTH))}


def _path_shadows(context: RenderContext) -> int:
    rules = context.options["rules"]
    return int(rules.samples_lights and not context.lights.is_dark and rules.max_bounces > 0)


#: The modes, by the stage that shades.
_MODES: MappingProxyType[PathStage, Mode] = MappingProxyType(
    {
        shade_by_lights: Mode("rendering/unshadowed.wgsl"),
        shade_by_facing_ratio: Mode("rendering/facing_ratio.wgsl"),
        sample_all_lights: Mode(
            _WHITTED,
            lights_per_pixel,
            lambda context: int(context.options["max_bounces"]),
            lambda context: {"CASTS_SHADOWS": float(context.options["casts_shadows"])},
            _branches,
        ),
        spawn_ambient_rays: Mode(
            "rendering/ao.wgsl",
            lambda context: int(context.options["rays"]),
            constants=_ambient_constants,
        ),
        shade_surfaces: Mode(
            "rendering/path.wgsl",
            _path_shadows,
            lambda context: int(context.options["rules"].max_bounces),
            _path_constants,
            samples_lights=True,
        ),
    }
)


def mode_of(stages: Sequence[PathStage]) -> Mode | None:
    """The mode of a renderer's stages; None if they have no shaders."""
    shading = shading_of(stages)
    return None if shading is None else _MODES[shading]


def unsupported(context: RenderContext) -> str | None:
    """What shaders do not support of a scene and its view; None if all."""
    scene, camera = context.tracer.scene, context.camera
    if scene.placements is not None:
        return "instances"
    if scene.has_primitives:
        return "spheres, height fields and shapes"
    used = [scene.materials[k] for k in np.unique(scene.attributes.material_ids).tolist()]
    if context.opacity is not None:
        return "surfaces that are not opaque"
    if camera.projection != "perspective":
        return f"cameras of projection {camera.projection!r}"
    if context.tables.kinds & IS_ROUGH and any(one.roughness is not None for one in used):
        return "materials with a roughness"
    if any(not TEXTURES.issuperset(one.textures) for one in used):
        return "textures other than diffuse ones"
    if context.punctual.sky.image or context.lights.sky.image:
        return "skies with an image"
    if any(isinstance(light, SpotLight) for light in scene.lights):
        return "spot lights"
    if KINDS[context.sampler.kind] == "stratified":
        return "the sampler 'stratified'"
    frame = scene.triangles
    eye = np.abs((np.array(camera.eye) - frame.center) * float(frame.scale))
    if context.tables.kinds & ABSORBS and eye.max() > FAR * float(frame.max_coordinate):
        return "materials that absorb light, seen from far outside"
    return None
