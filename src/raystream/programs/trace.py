"""Trace: a program and its payload, run at the hits of every ray."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.programs.program import Program
from raystream.programs.ray_subset import RaySubset
from raystream.programs.rounds import FindHits, visit

#: Orders of a ray's hits.
Order = Literal["front-to-back", "any"]
ORDERS: tuple[str, ...] = ("front-to-back", "any")


def check_order(order: str) -> None:
    """Raise ValueError for an unknown order."""
    if order not in ORDERS:
        known = " or ".join(map(repr, ORDERS))
        raise ValueError(f"order: expected {known}, got {order!r}")


def trace_program(
    find: FindHits,
    batch: RayBatch,
    triangles: Triangles | InstancedTriangles,
    function: Callable[..., Any],
    records: NDArray[Any] | None,
    is_ordered: bool,
    progress: Progress | None,
) -> None:
    """Run a program at the hits of each ray.

    Parameters
    ----------
    find : callable
    batch : RayBatch
    triangles : Triangles or InstancedTriangles
    function : callable
    records : ndarray of shape (N,) or (N, k), or None
        Each ray's payload, of `payloads.as_records`; changed in place.
    is_ordered : bool
        Whether hits are in order of t, then prim_id; otherwise packets need not sort theirs.
    progress : callable, optional
    """
    program = Program(function, "trace", None, (records,), triangles)
    program.compile()
    whole, status = RaySubset(batch, None, 0), np.zeros(len(batch), np.uint8)
    visit(find, whole, program.run, status, progress, is_ordered=is_ordered)
