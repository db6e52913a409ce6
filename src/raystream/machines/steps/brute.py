"""Brute force as kernels: one triangle per ray and step (Foley 2005, section 3)."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.kernels.search import is_full
from raystream.kernels.tally import TESTS
from raystream.kernels.triangle_list import intersect_list
from raystream.machines.records import (
    INTERSECTING,
    RayState,
    count_step,
    end_state,
    found_by,
    prepared_ray,
)
from raystream.machines.steps.base import StepKernel, Steps, resume_search, with_shade
from raystream.structures.brute.structure import BruteStructure

#: The next triangle.
PLACE = np.dtype([("row", np.uint32)])


def set_up(ray, wanted, tree, query, kernel):
    """Begin with the first triangle."""
    count_step(query, wanted, kernel, TESTS, ZERO_U64)
    is_active = tree.triangle_count != ZERO_U64 and ray.t_min <= ray.t_max
    state = INTERSECTING if is_active else end_state(ZERO_U64, query)
    return (np.uint32(0), ray.t_max), (np.uint32(0),), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a triangle."""
    line = prepared_ray(ray, query)
    search = resume_search(query.hits, ray, wanted, found, query)
    row, state = np.uint64(place.row), INTERSECTING
    for _ in range(query.tests):
        count_step(query, wanted, kernel, TESTS, ONE_U64)
        search = intersect_list(
            tree.references, tree.corners, row, row + ONE_U64, line, search, search.t_min, INF_F32
        )
        row += ONE_U64
        if row == tree.triangle_count or is_full(search):
            state = end_state(search.hit_count, query)
            break
    return found_by(search), (np.uint32(row),), state


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(brute: BruteStructure) -> Steps:
    """The steps of brute force."""
    return Steps(_KERNELS, PLACE, brute.view)
