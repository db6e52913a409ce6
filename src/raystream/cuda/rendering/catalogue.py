"""The kernels of renderers with arguments of the right types: compiled where no device is."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.cuda.rendering.kernels import (
    ADD,
    ASK_LIGHTS,
    BEGIN,
    FOLLOW,
    KEEP,
    LIGHT,
    LOOK_AROUND,
    VIEW,
)
from raystream.cuda.rendering.tables import plain
from raystream.jit.cuda import RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.camera_rays import view_of
from raystream.rendering.shading.light_tables import lights_of
from raystream.rendering.shading.paths import PathOptions
from raystream.rendering.shading.punctual_lights import punctual_lights_of
from raystream.rendering.shading.streams import StreamAddresses
from raystream.rendering.shading.tables import tables_of
from raystream.scene.scene import Scene

__all__ = ["rendering_catalogue"]

_AT, _NUMBER = np.uint64(0), np.int64(1)


def rendering_catalogue(scene: Scene) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels, by name, and arguments that are good for their types alone.

    Parameters
    ----------
    scene : Scene
        Any.
    """
    stream, hits = StreamAddresses(*[_AT] * 5), HitAddresses(*[_AT] * 4)
    camera = scene.camera_for(1.0)
    tables, lights, punctual = (
        plain(made)
        for made, _ in (tables_of(scene), lights_of(scene), punctual_lights_of(scene, camera))
    )
    sampler = Sampler.of("sobol")
    numbers = plain((sampler, _NUMBER))
    view = plain(view_of(camera, 1, 1))
    shading = tables, lights, *numbers, _NUMBER, plain(PathOptions(1, True, 1))
    first = stream, hits, tables, punctual, _NUMBER, _AT
    around = stream, hits, tables, *numbers, _NUMBER, 1.0, _NUMBER, _AT, stream, _AT
    return {
        "begin": (BEGIN, (view, _NUMBER, *numbers, stream)),
        "follow": (FOLLOW, (_NUMBER, stream, hits, *shading, _NUMBER, _AT, *[stream, _AT] * 2)),
        "light": (LIGHT, first),
        "view": (VIEW, first),
        "ask lights": (ASK_LIGHTS, (*first, _AT, stream, _AT)),
        "look around": (LOOK_AROUND, around),
        "keep": (KEEP, (_AT, _AT, stream, stream)),
        "add": (ADD, (_AT, stream, _AT, _NUMBER, _AT)),
    }
