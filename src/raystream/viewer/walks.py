"""Walks: one ray's traversal of a structure, for messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.tally import COLUMNS
from raystream.machines import Branching
from raystream.machines.counters import answer_counting
from raystream.stepper import Spot, Step, Walk, walk
from raystream.tracer import Tracer
from raystream.viewer.messages import Message, finite_or_none
from raystream.viewer.picking import PixelRay

#: Maximum steps sent, and maximum tested triangles listed per step.
MAX_STEPS, MAX_TESTED = 300, 32

#: Structures without a meaningful walk.
_NO_WALK = {"brute": "brute force has no structure to traverse: it tests every triangle"}


def walk_along(tracer: Tracer, ray: PixelRay) -> Message:
    """Record a ray's traversal up to its nearest hit, step by step, and its counters.

    Parameters
    ----------
    tracer : Tracer
    ray : PixelRay

    Returns
    -------
    dict
        ``walk``: see `_walk_message`; None if not available, with ``walk_reason``. And
        ``counts`` of the ray, by the names of `RayCounters`; None on CUDA.
    """
    if tracer.device == "cuda":
        reason = "walks are recorded on the CPU only: choose device cpu"
        return {"walk": None, "walk_reason": reason, "counts": None}
    counts = _counts(tracer, ray)
    if tracer.structure.name in _NO_WALK:
        reason = _NO_WALK[tracer.structure.name]
        return {"walk": None, "walk_reason": reason, "counts": counts}
    way = walk(tracer, ray.origin, ray.direction, max_steps=MAX_STEPS)
    return {"walk": _walk_message(way, counts), "walk_reason": None, "counts": counts}


def _counts(tracer: Tracer, ray: PixelRay) -> dict[str, int]:
    batch = RayBatch(ray.origin[None], ray.direction[None], 0.0, np.inf)
    _, counters = answer_counting(Branching(tracer.structure), Query(Kind.FIRST_HIT), batch)
    return {name: int(getattr(counters, name)[0]) for name in COLUMNS}


def _walk_message(way: Walk, counts: dict[str, int]) -> Message:
    """Describe a walk: ``more`` is the number of omitted steps, None if unknown."""
    return {
        "structure": way.structure,
        "traversal": way.traversal,
        "counts": counts,
        "steps": [_step_message(step) for step in way.steps],
        "more": 0 if way.is_whole else None,
        "is_whole": way.is_whole,
    }


def _step_message(step: Step) -> Message:
    at = step.at
    return {
        "kernel": step.kernel,
        "at": None if at is None else _spot_message(at),
        "face": step.face,
        "tested": list(step.tested[:MAX_TESTED]),
        "tested_count": len(step.tested),
        "t_in": None if at is None else finite_or_none(at.t_in),
        "t_out": None if at is None else finite_or_none(at.t_out),
        "t": finite_or_none(step.t),
        "prim_id": step.prim_id,
        "put_aside": len(step.stack),
        "counts": step.counts,
    }


def _spot_message(spot: Spot) -> dict[str, Any]:
    return {
        "number": spot.number,
        "kind": spot.kind,
        "low": [finite_or_none(part) for part in spot.low],
        "high": [finite_or_none(part) for part in spot.high],
    }
