"""Pairing entries and exits of closed meshes, like brackets."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.kernels.crossing_sides import faces_ray
from raystream.kernels.ray import PAD, largest, prepare_ray
from raystream.kernels.ray_source import load_ray

#: In place of a row: the crossing is outside the ray's interval.
NO_ROW = -1

#: Uncertainty of t by rounding to float32, relative, doubled.
ROUNDING = 2.0**-23

# Kinds of crossings.
_ENTRY = np.uint8(0)
_EXIT = np.uint8(1)
_UNPAIRED_ENTRY = np.uint8(2)
_UNPAIRED_EXIT = np.uint8(3)


class Crossings(NamedTuple):
    """Crossings of surfaces by rays: rows of `MultiHits` and what is derived from them.

    Attributes
    ----------
    splits : ndarray of shape (N + 1,), int64
    t : ndarray of shape (K,), float32 or float64
    prim_id : ndarray of shape (K,), int32
    mesh_id : ndarray of shape (K,), int32
    kind : ndarray of shape (K,), uint8
        0 for an entry, 1 for an exit.
    order : ndarray of shape (K,), int64
        Written by `pair_crossings`: the rows of each ray, at equal t entries first.
    slack : ndarray of shape (K,), float64
        Uncertainty of t by rounding: large where a triangle is seen almost edge-on.
    """

    splits: NDArray[np.int64]
    t: NDArray[np.floating[Any]]
    prim_id: NDArray[np.int32]
    mesh_id: NDArray[np.int32]
    kind: NDArray[np.uint8]
    order: NDArray[np.int64]
    slack: NDArray[np.float64]

    @classmethod
    def of(
        cls, splits: NDArray[np.int64], t: NDArray[np.floating[Any]], prim_id: NDArray[np.int32]
    ) -> Crossings:
        """Allocate the columns to be derived."""
        count = len(t)
        mesh_id, kind = np.empty(count, np.int32), np.empty(count, np.uint8)
        order, slack = np.empty(count, np.int64), np.empty(count)
        return cls(splits, t, prim_id, mesh_id, kind, order, slack)


class Limits(NamedTuple):
    """The rays' intervals, and whether segments are clipped to them.

    Attributes
    ----------
    t_min, t_max : ndarray of shape (N,), float32 or float64
    clips : bool
        Whether an entry before t_min is assumed where a closed mesh must have one, and crossings
        beyond t_max are dropped.
    is_whole : ndarray of shape (N,), bool
        Whether the ray was traced to its last crossing.
    """

    t_min: NDArray[np.floating[Any]]
    t_max: NDArray[np.floating[Any]]
    clips: bool
    is_whole: NDArray[np.bool_]


class MeshScratch(NamedTuple):
    """Scratch memory of `pair_crossings`, a number for each of M meshes.

    Attributes
    ----------
    depth : ndarray of shape (M,), int64
        Open entries; zero before and after each ray.
    slot : ndarray of shape (M,), int64
        The mesh's open segment.
    """

    depth: NDArray[np.int64]
    slot: NDArray[np.int64]

    @classmethod
    def zeros(cls, mesh_count: int) -> MeshScratch:
        """Allocate it."""
        return cls(np.zeros(mesh_count, np.int64), np.zeros(mesh_count, np.int64))


class Pairs(NamedTuple):
    """The results of `pair_crossings`; those of ray i begin at splits[i].

    Attributes
    ----------
    counts, unpaired_counts : ndarray of shape (N,), int64
        Number of segments and of unpaired crossings of each ray.
    entries, exits : ndarray of shape (K,), int64
        Rows of the crossings at both ends of a segment, in order of entry; `NO_ROW` for an
        entry before the ray's interval.
    unpaired : ndarray of shape (K,), int64
        Rows of the unpaired crossings.
    overlaps : ndarray of shape (N,), uint8
        0 if no two of a ray's segments overlap, 1 if they do so within rounding errors, and 2 if
        they really do.
    beneath : ndarray of shape (K,), int64
        For each segment, another one that it really overlaps, as a place in `exits`, or `NO_ROW`.
    """

    counts: NDArray[np.int64]
    unpaired_counts: NDArray[np.int64]
    entries: NDArray[np.int64]
    exits: NDArray[np.int64]
    unpaired: NDArray[np.int64]
    overlaps: NDArray[np.uint8]
    beneath: NDArray[np.int64]

    @classmethod
    def empty(cls, ray_count: int, row_count: int) -> Pairs:
        """Allocate, not initialised."""
        rays, rows = (ray_count,), (row_count,)
        counts, unpaired_counts = np.empty(rays, np.int64), np.empty(rays, np.int64)
        entries, exits, unpaired, beneath = (np.empty(rows, np.int64) for _ in range(4))
        overlaps = np.empty(rays, np.uint8)
        return cls(counts, unpaired_counts, entries, exits, unpaired, overlaps, beneath)


@kernel
def classify_crossings(begin, end, source, frame, corners, mesh_splits, is_flipped, crossings):
    """Classify crossings as entries or exits, and find their meshes.

    Parameters
    ----------
    begin, end : int
        Rays.
    source : RaySource
    frame : SceneFrame
    corners : ndarray of shape (F, 3, 3), float32
    mesh_splits : ndarray of shape (M + 1,), int64
    is_flipped : ndarray of shape (M,), bool
    crossings : Crossings
        `mesh_id`, `kind` and `slack` are written.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        first, last = crossings.splits[i], crossings.splits[i + np.uint64(1)]
        if first == last:
            continue
        local = load_ray(source, i, frame)
        ray = prepare_ray(local.origin, local.direction, frame.max_coordinate)
        for row in range(first, last):
            mesh_id = _mesh_of(crossings.prim_id[row], mesh_splits)
            crossings.mesh_id[row] = mesh_id
            classify_crossing(row, local, ray, frame, corners, is_flipped[mesh_id], crossings)


@device
def classify_crossing(row, local, ray, frame, corners, is_flipped, crossings):
    """Write `kind` and `slack` of a crossing.

    Parameters
    ----------
    row : int
    local : LocalRay
    ray : Ray
        The same, prepared.
    frame : SceneFrame or view of one
        Of the triangle.
    corners : ndarray of shape (F, 3, 3), float32
    is_flipped : bool
        Whether the triangle's mesh faces inward.
    crossings : Crossings
    """
    # The triangle test may shift a ray sideways by this much, see `PAD`.
    reach = largest(local.origin)
    aside = np.float64(PAD) * np.float64(frame.max_coordinate + reach) * local.t_scale
    prim_id = crossings.prim_id[row]
    enters = faces_ray(ray, corners, prim_id) != is_flipped
    crossings.kind[row] = _ENTRY if enters else _EXIT
    cosine = _cosine(ray, corners, prim_id)
    crossings.slack[row] = aside / cosine + ROUNDING * abs(crossings.t[row])


@device
def _mesh_of(prim_id, mesh_splits):
    """The last mesh that begins at or before a triangle."""
    low, high = 0, len(mesh_splits) - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if mesh_splits[middle] <= prim_id:
            low = middle
        else:
            high = middle
    return low


@device
def _cosine(ray, corners, i):
    """Cosine of the angle between a ray and a triangle's normal, either side; 0 to 1."""
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    ax, ay, az = np.float64(a[ray.kx]), np.float64(a[ray.ky]), np.float64(a[ray.kz])
    px, py, pz = b[ray.kx] - ax, b[ray.ky] - ay, b[ray.kz] - az
    qx, qy, qz = c[ray.kx] - ax, c[ray.ky] - ay, c[ray.kz] - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx
    longest = max(abs(nx), abs(ny), abs(nz))  # squares of small numbers would underflow
    nx, ny, nz = nx / longest, ny / longest, nz / longest
    dx, dy, dz = np.float64(ray.dx), np.float64(ray.dy), np.float64(ray.dz)
    along = abs(nx * dx + ny * dy + nz * dz)
    return along / math.sqrt((nx * nx + ny * ny + nz * nz) * (dx * dx + dy * dy + dz * dz))


@kernel
def pair_crossings(begin, end, crossings, limits, is_closed, scratch, pairs):
    """Match the entries and exits of each mesh like brackets, for rays begin to end.

    Parameters
    ----------
    begin, end : int
    crossings : Crossings
        `order` is written; `kind` is overwritten.
    limits : Limits
    is_closed : ndarray of shape (M,), bool
    scratch : MeshScratch
    pairs : Pairs
        Written.
    """
    depth, slot = scratch.depth, scratch.slot
    for i in range(np.uint64(begin), np.uint64(end)):
        first, last = crossings.splits[i], crossings.splits[i + np.uint64(1)]
        count = 0
        if last > first:
            _sort_rows(crossings, first, last)
            if limits.is_whole[i]:
                _swap_grazes(crossings, first, last, is_closed, depth, slot)
            _mark_unpaired(crossings, first, last, depth)
            if limits.clips and limits.t_min[i] > -math.inf:
                count = _begin_inside(crossings, first, last, is_closed, depth, slot, pairs)
        _write_pairs(i, crossings, first, last, count, depth, slot, pairs)
        if limits.clips:
            _clip_at_t_max(i, crossings, first, limits.t_max[i], pairs)
        _find_overlaps(i, crossings, first, limits, pairs)


@device
def _sort_rows(crossings, first, last):
    """Sort the rows by t; at equal t, entries before exits."""
    group = first
    while group < last:
        stop = group + 1
        while stop < last and crossings.t[stop] == crossings.t[group]:
            stop += 1
        at = group
        for kind in (_ENTRY, _EXIT):
            for row in range(group, stop):
                if crossings.kind[row] == kind:
                    crossings.order[at] = row
                    at += 1
        group = stop


@device
def _swap_grazes(crossings, first, last, is_closed, depth, balance):
    """Put entries first where a ray from outside would leave a closed mesh before it enters.

    It is from outside if it leaves the mesh as often as it enters it. Crossings further apart
    than rounding explains are not swapped: parts of the mesh are inside out.
    """
    t, kind, mesh_id, order = crossings.t, crossings.kind, crossings.mesh_id, crossings.order
    for row in range(first, last):
        balance[mesh_id[row]] = 0
    for row in range(first, last):
        balance[mesh_id[row]] += 1 if kind[row] == _ENTRY else -1
    for at in range(first, last):
        mesh = mesh_id[order[at]]
        is_exit = kind[order[at]] == _EXIT
        if is_exit and depth[mesh] == 0 and balance[mesh] == 0 and is_closed[mesh]:
            row, other = order[at], at + 1
            while mesh_id[order[other]] != mesh or kind[order[other]] != _ENTRY:
                other += 1  # there is one: as many entries as exits
            entry = order[other]
            if t[entry] - t[row] <= crossings.slack[entry] + crossings.slack[row]:
                order[at], order[other] = entry, row
        depth[mesh] += 1 if kind[order[at]] == _ENTRY else -1
    _reset(crossings, first, last, depth)


@device
def _mark_unpaired(crossings, first, last, depth):
    """Mark exits that no open entry precedes, then entries that no such exit follows."""
    kind, mesh_id, order = crossings.kind, crossings.mesh_id, crossings.order
    for at in range(first, last):
        row = order[at]
        mesh = mesh_id[row]
        if kind[row] == _ENTRY:
            depth[mesh] += 1
        elif depth[mesh] > 0:
            depth[mesh] -= 1
        else:
            kind[row] = _UNPAIRED_EXIT
    _reset(crossings, first, last, depth)
    for at in range(last - 1, first - 1, -1):
        row = order[at]
        mesh = mesh_id[row]
        if kind[row] == _EXIT:
            depth[mesh] += 1
        elif kind[row] == _ENTRY:
            if depth[mesh] > 0:
                depth[mesh] -= 1
            else:
                kind[row] = _UNPAIRED_ENTRY
    _reset(crossings, first, last, depth)


@device
def _reset(crossings, first, last, depth):
    for row in range(first, last):
        depth[crossings.mesh_id[row]] = 0


@device
def _begin_inside(crossings, first, last, is_closed, depth, slot, pairs):
    """Begin a segment before the first crossing, in each mesh that the ray starts in.

    Those are the closed ones with unpaired exits and no unpaired entries: with both, parts of
    the mesh disagree about its inside. The depth there is left in `depth`.
    """
    kind, mesh_id = crossings.kind, crossings.mesh_id
    count = 0
    for row in range(first, last):
        if kind[row] == _UNPAIRED_ENTRY or not is_closed[mesh_id[row]]:
            depth[mesh_id[row]] = -1
    for row in range(first, last):
        mesh = mesh_id[row]
        if kind[row] == _UNPAIRED_EXIT and depth[mesh] >= 0:
            kind[row] = _EXIT
            depth[mesh] += 1
            if depth[mesh] == 1:
                pairs.entries[first + count] = NO_ROW
                slot[mesh] = count
                count += 1
    for row in range(first, last):
        depth[mesh_id[row]] = max(depth[mesh_id[row]], 0)
    return count


@device
def _write_pairs(i, crossings, first, last, count, depth, slot, pairs):
    """Write the outermost pairs, after `count` already begun, and unpaired crossings."""
    unpaired_count = 0
    for at in range(first, last):
        row = crossings.order[at]
        kind, mesh = crossings.kind[row], crossings.mesh_id[row]
        if kind == _ENTRY:
            if depth[mesh] == 0:
                pairs.entries[first + count] = row
                slot[mesh] = count
                count += 1
            depth[mesh] += 1
        elif kind == _EXIT:
            depth[mesh] -= 1
            if depth[mesh] == 0:
                pairs.exits[first + slot[mesh]] = row
        else:
            pairs.unpaired[first + unpaired_count] = row
            unpaired_count += 1
    pairs.counts[i] = count
    pairs.unpaired_counts[i] = unpaired_count


@device
def _clip_at_t_max(i, crossings, first, t_max, pairs):
    """Drop segments and unpaired crossings that begin beyond t_max."""
    kept = 0
    for k in range(first, first + pairs.counts[i]):
        entry = pairs.entries[k]
        if entry == NO_ROW or crossings.t[entry] <= t_max:
            pairs.entries[first + kept] = entry
            pairs.exits[first + kept] = pairs.exits[k]
            kept += 1
    pairs.counts[i] = kept
    kept = 0
    for k in range(first, first + pairs.unpaired_counts[i]):
        if crossings.t[pairs.unpaired[k]] <= t_max:
            pairs.unpaired[first + kept] = pairs.unpaired[k]
            kept += 1
    pairs.unpaired_counts[i] = kept


@device
def _find_overlaps(i, crossings, first, limits, pairs):
    """Write `overlaps` and `beneath` of a ray: each segment is compared with the longest so far."""
    t, slack = crossings.t, crossings.slack
    longest, latest, doubt = NO_ROW, -math.inf, 0.0
    overlap = np.uint8(0)
    for k in range(first, first + pairs.counts[i]):
        entry, exit_ = pairs.entries[k], pairs.exits[k]
        t_entry, t_exit = np.float64(limits.t_min[i]), np.float64(min(t[exit_], limits.t_max[i]))
        rounding = 0.0
        if entry != NO_ROW:
            t_entry, rounding = np.float64(t[entry]), slack[entry]
        pairs.beneath[k] = NO_ROW
        common = min(latest, t_exit) - t_entry
        if common > 0.0:
            rounding += slack[exit_] if t_exit < latest else doubt
            overlap = max(overlap, np.uint8(1))
            if common > rounding:
                overlap, pairs.beneath[k] = np.uint8(2), longest
        if t_exit > latest:
            longest, latest, doubt = k, t_exit, slack[exit_]
    pairs.overlaps[i] = overlap
