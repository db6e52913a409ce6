"""Brute force as shaders read it."""

from __future__ import annotations

import numpy as np

from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.structures.brute.structure import BruteStructure


def shader_structure(brute: BruteStructure) -> ShaderStructure:
    """A list of all triangles."""
    triangles = brute.triangles
    count = len(triangles.prim_ids)
    return ShaderStructure(
        name="brute",
        shader="brute.wgsl",
        tree=numbers(count),
        arrays=(triangles.prim_ids.astype(np.uint32), triangles.corners),
        budget=budget_for(count),
    )
