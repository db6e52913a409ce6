"""Vector types that tests cover, and those in a default run."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.jit.simd.types import VECTORS

DTYPES = {"f32": np.float32, "f64": np.float64, "i32": np.int32, "i64": np.int64}

#: Every kind and every width, to which CI adds all pairs.
_USUAL = ("f32x8", "f64x4", "i32x16", "i64x8")

VECTOR_TYPES = [
    pytest.param(vector, marks=[pytest.mark.exhaustive] * (str(vector) not in _USUAL))
    for (kind, n), vector in VECTORS.items()
    if kind in DTYPES and n > 2
]
FLOAT_TYPES = [one for one in VECTOR_TYPES if one.values[0].is_float]
INTEGER_TYPES = [one for one in VECTOR_TYPES if not one.values[0].is_float]
