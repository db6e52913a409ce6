"""The graphics device: rays traced by shaders, through wgpu.

Vulkan, Metal or Direct3D 12; ``pip install raystream[graphics]``. ``Tracer(device="graphics")``
has the machines ``"compute"``, the default, ``"branching"`` and ``"multipass"``.

Images by the graphics pipeline itself: `visibility` rasterises, `hybrid` adds ray-traced shadows,
and `render_bounces` renders shadows and mirrors by fragment programs alone.
"""

from __future__ import annotations

import importlib
from typing import Any

from raystream.core.choices import Graphics
from raystream.graphics.machines import GRAPHICS_MACHINES
from raystream.graphics.structures import build_with_shaders
from raystream.machines.devices import register_device

__all__ = ["GRAPHICS_MACHINES", "Visibility", "hybrid", "render_bounces", "visibility"]

register_device("graphics", build_with_shaders, GRAPHICS_MACHINES, Graphics)

#: Modules of functions that render, imported on first use.
_HOMES = {
    "Visibility": "raster",
    "visibility": "raster",
    "hybrid": "shadow_caster",
    "render_bounces": "bounces",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'raystream.graphics' has no attribute {name!r}")
    return getattr(importlib.import_module(f"raystream.graphics.{_HOMES[name]}"), name)
