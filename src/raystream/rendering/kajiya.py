"""kajiya: two interreflection rays, with a shadow ray at each hit (Rayforce 2013).

The poster's global illumination benchmark: `path` with a fixed length, whose last surface only
samples the lights. A pixel's sample traces at most 1 + 2 first-hit and 3 any-hit rays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from raystream.rendering.integrator import Integrator
from raystream.rendering.path import PATH_STAGES, check_path


def _check(options: Mapping[str, Any]) -> Mapping[str, Any]:
    return check_path({**options, "follows_last": False})


KAJIYA = Integrator(
    "kajiya",
    "the first hit and two bounces, a shadow ray at each (Rayforce 2013)",
    PATH_STAGES,
    {"max_bounces": 3, "clamp": math.inf},
    _check,
    default_samples=16,
)
