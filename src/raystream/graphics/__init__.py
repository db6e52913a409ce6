"""The graphics device: rays traced by a GPU's shaders, by way of wgpu.

Vulkan, Metal or Direct3D 12; ``pip install raystream[graphics]``. ``Tracer(device="graphics")``
has three machines: ``"compute"``, its usual one.
"""

from raystream.graphics.forms import build_with_shaders
from raystream.graphics.machines import GRAPHICS_MACHINES
from raystream.machines.devices import register_device

__all__ = ["GRAPHICS_MACHINES"]

register_device("graphics", build_with_shaders, GRAPHICS_MACHINES)
