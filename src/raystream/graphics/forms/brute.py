"""Brute force as shaders take it."""

from __future__ import annotations

import numpy as np

from raystream.graphics.forms.base import Form, budget_for, numbers
from raystream.structures.brute.structure import BruteStructure

__all__ = ["form"]


def form(brute: BruteStructure) -> Form:
    """All triangles."""
    triangles = brute.triangles
    count = len(triangles.prim_ids)
    return Form(
        name="brute",
        shader="brute.wgsl",
        tree=numbers(count),
        arrays=(triangles.prim_ids.astype(np.uint32), triangles.corners),
        budget=budget_for(count),
    )
