"""The stages of renderers that a device or a machine implements as a whole."""

from __future__ import annotations

from collections.abc import Sequence

from raystream.rendering.ao import spawn_ambient_rays
from raystream.rendering.integrator import PathStage, find_surfaces, trace_shadow_rays
from raystream.rendering.path import shade_surfaces
from raystream.rendering.raycast import shade_by_lights
from raystream.rendering.vis import shade_by_facing_ratio
from raystream.rendering.whitted import sample_all_lights

#: Stages that shade, and whether shadow rays are traced after them.
_SHADING: dict[PathStage, bool] = {
    shade_by_lights: False,
    shade_by_facing_ratio: False,
    sample_all_lights: True,
    spawn_ambient_rays: True,
    shade_surfaces: True,
}


def shading_of(stages: Sequence[PathStage]) -> PathStage | None:
    """The stage that shades, of a renderer that only traces rays besides; else None."""
    if len(stages) < 2 or stages[0] is not find_surfaces or stages[1] not in _SHADING:
        return None
    _, shading, *rest = stages
    return shading if rest == [trace_shadow_rays] * _SHADING[shading] else None
