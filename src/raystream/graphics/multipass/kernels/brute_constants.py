"""Brute force with a triangle in the constants of each draw (Foley 2005, section 3)."""

from __future__ import annotations

import numpy as np

from raystream.graphics.ray_textures import RayTextures
from raystream.graphics.structures.base import ShaderStructure, budget_for
from raystream.machines.records import RayState
from raystream.machines.steps.base import StepKernel
from raystream.structures import Structure
from raystream.structures.brute.structure import BruteStructure

#: The uniform of a triangle: see brute_constants.wgsl.
_CONSTANTS = np.dtype(
    [
        ("a", "f4", 3),
        ("triangle_count", "u4"),
        ("b", "f4", 3),
        ("prim_id", "i4"),
        ("c", "f4", 3),
        ("pad", "f4"),
    ]
)


class TriangleConstants:
    """Brute force's triangles, one in the constants of each draw.

    All rays test the same triangle, since each pass runs on all that are left.

    Parameters
    ----------
    brute : BruteStructure

    Attributes
    ----------
    shaders : ShaderStructure
        With the first triangle and no arrays: the device holds one triangle at a time.
    """

    def __init__(self, brute: BruteStructure) -> None:
        triangles = brute.triangles
        ids = triangles.prim_ids
        self._records = np.zeros(max(len(ids), 1), _CONSTANTS)
        self._records["triangle_count"] = len(ids)
        if len(ids):
            corners = triangles.corners[ids]
            for number, name in enumerate("abc"):
                self._records[name] = corners[:, number]
            self._records["prim_id"] = ids
        self.shaders = ShaderStructure(
            name="brute",
            shader="brute_constants.wgsl",
            tree=self._records[0].tobytes(),
            arrays=(),
            budget=budget_for(len(ids)),
        )
        self._row = 0

    def begin(self) -> None:
        """Restart at the first triangle, for other rays."""
        self._row = 0

    def load(self, rays: RayTextures, kernel: StepKernel) -> None:
        """Write the constants of a kernel, before its pass."""
        if kernel.state == RayState.INTERSECTING:
            rays.write_tree(self._records[self._row].tobytes())
            self._row += 1

    @classmethod
    def if_supported(
        cls, structure: Structure, loop: str, intersections: int
    ) -> TriangleConstants | None:
        """For brute force, if the host encodes each pass, of one test; else None."""
        if isinstance(structure, BruteStructure) and loop == "queries" and intersections == 1:
            return cls(structure)
        return None
