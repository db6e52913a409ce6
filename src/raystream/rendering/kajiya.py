"""kajiya: the first surface and two bounces, with a shadow ray at each (Rayforce 2013).

The poster's benchmark of diffuse light: `path` of a fixed length.
"""

from __future__ import annotations

import math

from raystream.rendering.integrator import Integrator
from raystream.rendering.path import PATH_STAGES, check_path

__all__ = ["KAJIYA"]

KAJIYA = Integrator(
    "kajiya",
    "the first surface and two bounces, a shadow ray at each (Rayforce 2013)",
    PATH_STAGES,
    {"max_bounces": 3, "clamp": math.inf},
    check_path,
)
