"""What a multipass machine keeps of a ray between two passes, as records of streams."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.collect import HitAddresses
from raystream.kernels.ray import prepare_ray
from raystream.kernels.tally import ROW, add_to

__all__ = [
    "FOUND",
    "RAY",
    "WANTED",
    "RayState",
    "StepArguments",
    "end_of",
    "note",
    "ray_of",
    "tick",
    "wants_any",
]


class RayState(IntEnum):
    """What a ray waits for: the kernel that runs on it next (Purcell 2002, section 3.2).

    Attributes
    ----------
    DONE
        Nothing: its hits have been handed over, or it has none.
    STARTING
        To be set up.
    TRAVERSING
        A step from cell to cell, or from node to node; in a kd-tree, Foley's Down.
    INTERSECTING
        A triangle, or a block of them.
    SHADING
        To hand its hits over.
    AT_LEAF, LEAVING, CLIMBING
        Foley's Leaf, Continue and Up.
    OVERFLOWN
        More room for the triangles that it has met: it is traced again.
    """

    DONE = 0
    STARTING = 1
    TRAVERSING = 2
    INTERSECTING = 3
    SHADING = 4
    AT_LEAF = 5
    LEAVING = 6
    CLIMBING = 7
    OVERFLOWN = 8


#: A ray, in the scene's local frame: 8 words.
RAY = np.dtype(
    [("origin", np.float32, 3), ("direction", np.float32, 3), ("t_min", "f4"), ("t_max", "f4")]
)

#: Where its hits go, and how many are wanted: rows from `first` on; `number` is the ray's own.
WANTED = np.dtype([("first", np.uint64), ("capacity", np.uint64), ("number", np.uint32)])

#: How many hits it has, and the distance beyond which none is wanted any more.
FOUND = np.dtype([("count", np.uint32), ("t_far", np.float32)])

_DONE = np.uint8(RayState.DONE)
_SHADING = np.uint8(RayState.SHADING)
_NOWHERE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift


class StepArguments(NamedTuple):
    """What all rays of a query have in common.

    Attributes
    ----------
    max_coordinate : float32
        See `kernels.ray.prepare_ray`.
    surfaces, keep : bool
        See `kernels.queries.ray_queries`.
    hands_over : bool
        Whether anyone wants to know of a ray's hits, and not only their number.
    hits : HitAddresses
        Where hits are kept.
    tallies, runs : uint64
        Addresses of the rays' tallies, and of how often each kernel ran on each ray, eight
        words for each; 0 if nobody counts.
    stacks, stack_bytes : uint64
        Address of the rays' own memory, and how much each has.
    steps, tests : uint64
        Traversal steps and intersections in one pass.
    """

    max_coordinate: np.float32
    surfaces: bool
    keep: bool
    hands_over: bool
    hits: HitAddresses
    tallies: np.uint64
    runs: np.uint64
    stacks: np.uint64
    stack_bytes: np.uint64
    steps: np.uint64
    tests: np.uint64


@device
def ray_of(ray, query):
    """A `RAY` as tests want it: set up anew in each pass."""
    o, d = ray.origin, ray.direction
    return prepare_ray(o[0], o[1], o[2], d[0], d[1], d[2], query.max_coordinate)


@device
def wants_any(wanted, query):
    """Whether one hit is wanted, no matter which."""
    return wanted.capacity == _ONE and not query.keep


@device
def end_of(count, query):
    """The state of a ray whose search has ended."""
    return _SHADING if query.hands_over and count != _NOWHERE else _DONE


@device
def tick(query, wanted, kernel, column, more):
    """Count a step of a ray: a run of kernel number `kernel`, and `more` in its tally."""
    if query.runs != _NOWHERE:
        at = query.runs + np.uint64(wanted.number) * ROW + (np.uint64(kernel) << _WORD)
        store(at, np.uint32(load(np.uint32, at) + np.uint32(1)))
        note(query, wanted, column, more)


@device
def note(query, wanted, column, more):
    """Count something else of a ray."""
    if query.tallies != _NOWHERE:
        add_to(query.tallies + np.uint64(wanted.number) * ROW, column, more)
