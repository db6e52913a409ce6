"""The state of a ray between passes of the multipass machine, as records of streams."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from raystream.jit.constants import SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import prepare_ray
from raystream.kernels.tally import ROW, add_to


class RayState(IntEnum):
    """The kernel that a ray waits for (Purcell 2002, section 3).

    Attributes
    ----------
    DONE
        None: its hits have been shaded, or it has none.
    STARTING
        Set-up.
    TRAVERSING
        A step from cell to cell, or from node to node; in a kd-tree, Foley's Down.
    INTERSECTING
        A test of a triangle, or of a block of them.
    SHADING
        Shading: its search is over. In a query only rays with hits are shaded.
    AT_LEAF, CONTINUING, BACKTRACKING
        Foley's Leaf, Continue and Up.
    NO_ROOM
        None: the rays that its shading spawns need more room, and it is shaded again with more.
    """

    DONE = 0
    STARTING = 1
    TRAVERSING = 2
    INTERSECTING = 3
    SHADING = 4
    AT_LEAF = 5
    CONTINUING = 6
    BACKTRACKING = 7
    NO_ROOM = 8


#: A ray, in the scene's local frame: 8 words.
RAY = np.dtype(
    [("origin", np.float32, 3), ("direction", np.float32, 3), ("t_min", "f4"), ("t_max", "f4")]
)

#: Hits that a ray wants: up to `capacity`, in rows from `first` on. `number` is the ray's index.
WANTED = np.dtype([("first", np.uint64), ("capacity", np.uint64), ("number", np.uint32)])

#: Hits found so far, and the distance beyond which none is wanted any more.
FOUND = np.dtype([("count", np.uint32), ("t_far", np.float32)])

#: States as kernels write them.
DONE = np.uint8(RayState.DONE)
TRAVERSING = np.uint8(RayState.TRAVERSING)
INTERSECTING = np.uint8(RayState.INTERSECTING)
SHADING = np.uint8(RayState.SHADING)
AT_LEAF = np.uint8(RayState.AT_LEAF)
CONTINUING = np.uint8(RayState.CONTINUING)
BACKTRACKING = np.uint8(RayState.BACKTRACKING)
NO_ROOM = np.uint8(RayState.NO_ROOM)

#: Least number of hits of rays that are shaded.
SHADE_ALL, SHADE_HITS, SHADE_NONE = np.uint64(0), np.uint64(1), np.uint64(2**64 - 1)

_NOWHERE = np.uint64(0)


class StepArguments(NamedTuple):
    """What all rays of a query share.

    Attributes
    ----------
    max_coordinate : float32
        See `kernels.ray.prepare_ray`.
    surfaces : bool
        See `kernels.triangle.intersect`.
    shaded_hits : uint64
        Rays with at least this many hits are shaded: `SHADE_HITS`, `SHADE_NONE` if hits are only
        counted, `SHADE_ALL` in a renderer.
    hits : HitAddresses or None
        Where hits are kept; None for a query that only counts. These are two types: kernels are
        compiled for each.
    tallies, runs : uint64
        Addresses of the rays' tallies, and of the number of runs of each kernel on each ray,
        eight words per ray; 0 without counters.
    stacks, stack_bytes : uint64
        Address of the rays' stacks, and bytes of each.
    steps, tests : uint64
        Traversal steps and intersections in one pass.
    """

    max_coordinate: np.float32
    surfaces: bool
    shaded_hits: np.uint64
    hits: HitAddresses | None
    tallies: np.uint64
    runs: np.uint64
    stacks: np.uint64
    stack_bytes: np.uint64
    steps: np.uint64
    tests: np.uint64


@device
def prepared_ray(ray, query):
    """Set up a `RAY` for box and triangle tests: in each pass, since that is not kept."""
    return prepare_ray(ray.origin, ray.direction, query.max_coordinate)


@device
def stack_of(wanted, query):
    """Address of a ray's stack."""
    return query.stacks + np.uint64(wanted.number) * query.stack_bytes


@device
def found_by(search):
    """The results of a search as a record of `FOUND`."""
    return np.uint32(search.hit_count), search.t_far


@device
def end_state(count, query):
    """The state of a ray whose search has ended with a number of hits."""
    return SHADING if count >= query.shaded_hits else DONE


@device
def count_step(query, wanted, kernel, column, more):
    """Count a run of kernel number `kernel` on a ray, and add `more` to a column of its tally."""
    if query.runs != _NOWHERE:
        at = query.runs + np.uint64(wanted.number) * ROW + (np.uint64(kernel) << SHIFT_32)
        store(at, np.uint32(load(np.uint32, at) + np.uint32(1)))
        add_count(query, wanted, column, more)


@device
def add_count(query, wanted, column, more):
    """Add to a column of a ray's tally."""
    if query.tallies != _NOWHERE:
        add_to(query.tallies + np.uint64(wanted.number) * ROW, column, more)
