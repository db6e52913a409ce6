"""kajiya: two diffuse bounces, with a shadow ray at each hit (Rayforce 2013).

The poster's global illumination benchmark: `path` with a fixed length.
"""

from __future__ import annotations

import math

from raystream.rendering.integrator import Integrator
from raystream.rendering.path import PATH_STAGES, check_path

__all__ = ["KAJIYA"]

KAJIYA = Integrator(
    "kajiya",
    "the first hit and two bounces, a shadow ray at each (Rayforce 2013)",
    PATH_STAGES,
    {"max_bounces": 3, "clamp": math.inf},
    check_path,
)
