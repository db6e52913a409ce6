"""Brute force as kernels: every ray takes one triangle after another (Foley 2005, section 4)."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.search import is_full
from raystream.kernels.tally import TESTS
from raystream.kernels.triangle_list import intersect_list
from raystream.machines.records import RayState, end_of, ray_of, tick
from raystream.machines.steps.base import StepKernel, Steps, resumed, with_shade
from raystream.structures.brute.structure import BruteStructure

__all__ = ["steps"]

#: The triangle that is next.
PLACE = np.dtype([("row", np.uint32)])

_INTERSECTING = np.uint8(RayState.INTERSECTING)
_DONE = np.uint8(RayState.DONE)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_INF = np.float32(np.inf)


def set_up(ray, wanted, tree, query, kernel):
    """Begin with the first triangle."""
    tick(query, wanted, kernel, TESTS, _NONE)
    is_active = tree.triangle_count != _NONE and ray.t_min <= ray.t_max
    return (np.uint32(0), ray.t_max), (np.uint32(0),), _INTERSECTING if is_active else _DONE


@device
def _intersect(hits, ray, wanted, found, place, tree, query, kernel):
    line, search = ray_of(ray, query), resumed(hits, ray, wanted, found, query, None)
    row, state = np.uint64(place.row), _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, _ONE)
        search = intersect_list(
            tree.references, tree.corners, row, row + _ONE, line, search, search.t_min, _INF
        )
        row += _ONE
        if row == tree.triangle_count or is_full(search):
            state = end_of(search.hit_count, query)
            break
    return (np.uint32(search.hit_count), search.t_far), (np.uint32(row),), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a triangle."""
    if query.keep:
        return _intersect(query.hits, ray, wanted, found, place, tree, query, kernel)
    return _intersect(None, ray, wanted, found, place, tree, query, kernel)


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(brute: BruteStructure) -> Steps:
    """The steps of brute force."""
    return Steps(_KERNELS, PLACE, brute.arrays)
