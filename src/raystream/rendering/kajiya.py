"""kajiya: the first surface and two bounces, with a shadow ray at each (Rayforce 2013).

The poster's benchmark of diffuse light: `path` of a fixed length.
"""

from __future__ import annotations

import math

from raystream.rendering.path import PATH_STAGES, check_path
from raystream.rendering.sampled import SampledRenderer

__all__ = ["KAJIYA"]

KAJIYA = SampledRenderer(
    "kajiya",
    "the first surface and two bounces, a shadow ray at each (Rayforce 2013)",
    PATH_STAGES,
    {"max_bounces": 3, "clamp": math.inf},
    check_path,
)
