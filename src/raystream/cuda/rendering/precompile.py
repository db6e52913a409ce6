"""The kernels of renderers with example arguments, to compile them without a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.cuda.rendering.kernels import (
    ADD_UNBLOCKED,
    COMPACT,
    GENERATE_CAMERA_RAYS,
    SAMPLE_ALL_LIGHTS,
    SHADE_FACING_RATIO,
    SHADE_PATHS,
    SHADE_UNSHADOWED,
    SPAWN_AO_RAYS,
    SlotAddresses,
)
from raystream.cuda.rendering.tables import plain
from raystream.jit.constants import NULL, ONE_U64
from raystream.jit.cuda import RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.rendering.sampling.sampler import PixelSample, Sampler
from raystream.rendering.shading.ambient_occlusion import OcclusionOptions
from raystream.rendering.shading.camera_rays import view_of
from raystream.rendering.shading.light_tables import lights_of
from raystream.rendering.shading.paths import PathOptions
from raystream.rendering.shading.punctual_lights import punctual_lights_of
from raystream.rendering.shading.streams import ShadingBatch, StreamAddresses
from raystream.rendering.shading.tables import tables_of
from raystream.scene.scene import Scene


def rendering_kernels(scene: Scene) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels by name, with arguments that are valid for their types only.

    Parameters
    ----------
    scene : Scene
        Any scene.
    """
    number: Any = np.int64(1)
    stream = StreamAddresses(*[NULL] * 5)
    slots = SlotAddresses(stream, NULL, ONE_U64)
    batch = ShadingBatch(number, stream, HitAddresses(*[NULL] * 4), number, NULL)
    camera = scene.camera_for(1.0)
    tables, lights, punctual = (
        plain(made)
        for made, _ in (tables_of(scene), lights_of(scene), punctual_lights_of(scene, camera))
    )
    view = plain(view_of(camera, 1, 1))
    sample = plain(PixelSample(Sampler.of("sobol"), 1))
    options = plain(PathOptions(1, True, 1))
    occlusion = plain(OcclusionOptions(1, 1.0))
    local = batch, tables, punctual
    return {
        "generate camera rays": (GENERATE_CAMERA_RAYS, (view, number, sample, stream)),
        "shade paths": (
            SHADE_PATHS,
            (batch, tables, lights, sample, number, options, slots, slots),
        ),
        "shade unshadowed": (SHADE_UNSHADOWED, local),
        "shade facing ratio": (SHADE_FACING_RATIO, local),
        "sample all lights": (SAMPLE_ALL_LIGHTS, (*local, slots)),
        "spawn AO rays": (SPAWN_AO_RAYS, (batch, tables, sample, occlusion, slots)),
        "compact": (COMPACT, (slots, stream)),
        "add unblocked": (ADD_UNBLOCKED, (NULL, stream, NULL, number, NULL)),
    }
