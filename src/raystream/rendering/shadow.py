"""shadow: the shadow caster (Purcell 2002, 3.1.4).

One shadow ray from the first hit to each light: `whitted` without mirrors and glass.
"""

from __future__ import annotations

from raystream.rendering.integrator import Integrator
from raystream.rendering.whitted import WHITTED_STAGES, check_whitted, lights_per_pixel

SHADOW = Integrator(
    "shadow",
    "the nearest surface under the lights, with shadows (Purcell 2002)",
    WHITTED_STAGES,
    {},
    check_whitted,
    lights_per_pixel,
)
