"""The graphics device: rays traced by shaders, through wgpu.

Vulkan, Metal or Direct3D 12; ``pip install raystream[graphics]``. ``Tracer(device="graphics")``
has the machines ``"compute"``, the default, ``"branching"`` and ``"multipass"``.

Images by the graphics pipeline itself: with ``machine="multipass"`` a whole renderer is draws of
fragment programs (`rendering`); `visibility` rasterises, and `hybrid` adds ray-traced shadows.
"""

from __future__ import annotations

import importlib
from typing import Any

from raystream.core.choices import Graphics
from raystream.graphics.machines import GRAPHICS_MACHINES
from raystream.graphics.structures import build_with_shaders
from raystream.tracer.devices import register_device

__all__ = ["GRAPHICS_MACHINES", "Visibility", "hybrid", "visibility"]

register_device("graphics", build_with_shaders, GRAPHICS_MACHINES, Graphics)

#: Modules of functions that render, imported on first use.
_HOMES = {
    "Visibility": "raster",
    "visibility": "raster",
    "hybrid": "shadow_caster",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'raystream.graphics' has no attribute {name!r}")
    return getattr(importlib.import_module(f"raystream.graphics.{_HOMES[name]}"), name)
