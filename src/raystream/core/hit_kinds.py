"""What results are made of, for what a scene holds: classes and types."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.float64_hits import Float64Hits, Float64MultiHits
from raystream.core.float64_triangles import Float64Triangles
from raystream.core.hits import Hits, MultiHits
from raystream.core.primitive_hits import PrimitiveHits, PrimitiveMultiHits
from raystream.core.primitives import Primitives


def hits_type(triangles: Any) -> type[Hits]:
    """The class of `Tracer.first_hit`'s result."""
    if isinstance(triangles, Primitives):
        return PrimitiveHits
    return Float64Hits if isinstance(triangles, Float64Triangles) else Hits


def multi_hits_type(triangles: Any) -> type[MultiHits]:
    """The class of `Tracer.multi_hit`'s result."""
    if isinstance(triangles, Primitives):
        return PrimitiveMultiHits
    return Float64MultiHits if isinstance(triangles, Float64Triangles) else MultiHits


def distance_type(triangles: Any) -> type[np.floating[Any]]:
    """The type of t, u and v."""
    return np.float64 if isinstance(triangles, Float64Triangles) else np.float32
