"""The steps of a ray's walk through a graph of sectors.

A ray intersects a plane at one distance (`plane_distances`), as in the kd-tree, and for the same
reason: a distance t is either before a plane or not, from whichever sector. A ray is in a sector
for t_in <= t < t_out, from the last of the planes through which it enters to the first of those
through which it leaves; the sides of the scene's box do not count. So each t belongs to exactly
one sector, and a hit counts in the sector that its t belongs to, and nowhere else.

Every walk ends. A step goes through a face that faces the ray's direction, and sectors are the
leaves of splits: all sectors behind such a face come later in the order in which rays of that
octant visit sectors, whatever the distances are.

References
----------
Gribble and Naveros, "GPU Ray Tracing with Rayforce", SIGGRAPH 2013 posters. How sectors are
linked and walked is our reading of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import BYTES_32, NULL, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import fma, load, next_float_up, store
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.kernels.ray import component
from raystream.structures.plane_distances import (
    SplitRay,
    plane_distance,
    scene_interval,
    split_ray,
)

#: Most sectors that a walk from a nearby sector leaves before it falls back to the bins.
MAX_WALK = 16

# Byte offsets of the words of a sector.
_FIRST_BLOCK = np.uint64(12)
_HIGH = np.uint64(16)
_TRIANGLE_COUNT = np.uint64(28)
_LINKS = np.uint64(32)
_TWO_WORDS = np.uint64(8)

# Byte offsets of the words of a link node; the first is the plane.
_AXIS = np.uint64(4)
_BELOW = np.uint64(8)
_ABOVE = np.uint64(12)

_ROW = np.uint64(4)  # a row's 16 bytes, as a shift
_NODE_BIT = np.uint64(1 << 31)
_NO_LIMIT = np.uint64(2**63)
_NEARBY = np.uint64(MAX_WALK)

_SECTOR = np.uint64(6)  # a sector's 64 bytes, as a shift
_INDEX = np.uint64(2)  # a number's four bytes, as a shift


class GraphAddresses(NamedTuple):
    """A graph as kernels take it; the caller keeps the arrays alive.

    Attributes
    ----------
    rows : uint64
        Address of `layout.GraphArrays.rows`, with planes at infinity where sectors have no
        neighbour; 0 for a graph without sectors.
    blocks : uint64
        Address of the sectors' blocks.
    bins : uint64
        Address of the bins.
    bin_counts : tuple of three float32
        Bins along each axis.
    bin_low : tuple of three float32
        The low corner of the first bin.
    bin_scales : tuple of three float32
        Bins per unit of length; 0 along an axis on which the box is flat.
    low, high : tuple of three float32
        The scene's box.
    starts : uint64
        Address of an int32 per ray: the number of a sector near its start, or -1; 0 without.
    ends : uint64
        Address of an int32 per ray, written if it hits anything: the number of the sector of its
        hit; 0 without.
    """

    rows: np.uint64
    blocks: np.uint64
    bins: np.uint64
    bin_counts: tuple[np.float32, np.float32, np.float32]
    bin_low: tuple[np.float32, np.float32, np.float32]
    bin_scales: tuple[np.float32, np.float32, np.float32]
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]
    starts: np.uint64
    ends: np.uint64


class SectorRay(NamedTuple):
    """A ray as the steps use it.

    Attributes
    ----------
    planes : SplitRay
        For its distances to planes.
    out : tuple of three uint64
        Byte offsets in a sector of the planes through which the ray leaves.
    links : tuple of three uint64
        Byte offsets of their links.
    """

    planes: SplitRay
    out: tuple[np.uint64, np.uint64, np.uint64]
    links: tuple[np.uint64, np.uint64, np.uint64]


class Face(NamedTuple):
    """A face of a sector: the distance of its plane along a ray, and its link."""

    t: np.float32
    link: np.uint64


@device
def sector_ray(ray):
    """A `kernels.ray.Ray` as a `SectorRay`."""
    high_x = _HIGH if ray.inv_x > ZERO_F32 else ZERO_U64
    high_y = _HIGH if ray.inv_y > ZERO_F32 else ZERO_U64
    high_z = _HIGH if ray.inv_z > ZERO_F32 else ZERO_U64
    # Links are in pairs: low side, high side.
    links = (
        _LINKS + (high_x >> np.uint64(2)),
        _LINKS + _TWO_WORDS + (high_y >> np.uint64(2)),
        _LINKS + _TWO_WORDS + _TWO_WORDS + (high_z >> np.uint64(2)),
    )
    return SectorRay(split_ray(ray), (high_x, high_y + BYTES_32, high_z + _TWO_WORDS), links)


@device
def _link(sector, at):
    return np.uint64(load(np.uint32, sector + at))


@device
def _distances(line, sector, side):
    """Distances of the planes through which a ray leaves a sector; with `_HIGH`, enters it.

    They are infinite at the side of the scene.
    """
    planes, (x, y, z) = line.planes, line.out
    return (
        fma(load(np.float32, sector + (x ^ side)), planes.inv_x, planes.middle_x),
        fma(load(np.float32, sector + (y ^ side)), planes.inv_y, planes.middle_y),
        fma(load(np.float32, sector + (z ^ side)), planes.inv_z, planes.middle_z),
    )


@device
def exit_face(line, sector):
    """The face through which a ray leaves a sector; its distance is inf in the last one.

    Parameters
    ----------
    line : SectorRay
    sector : uint64
        Address.

    Returns
    -------
    Face
    """
    t, t_y, t_z = _distances(line, sector, ZERO_U64)
    link = line.links[0]
    if t_y < t:
        t, link = t_y, line.links[1]
    if t_z < t:
        t, link = t_z, line.links[2]
    return Face(t, _link(sector, link))


@device
def _entry_face(line, sector):
    """The face through which a ray enters a sector; its distance is -inf in the first one."""
    t, t_y, t_z = _distances(line, sector, _HIGH)
    link = line.links[0]
    if t_y > t:
        t, link = t_y, line.links[1]
    if t_z > t:
        t, link = t_z, line.links[2]
    return Face(t, _link(sector, link ^ BYTES_32))


@device
def follow_link(graph, line, link, t):
    """Follow a link, through link nodes, to the sector in which a ray is at t.

    Parameters
    ----------
    graph : GraphAddresses
    line : SectorRay
    link : uint64
        Not void.
    t : float32

    Returns
    -------
    sector : uint64
        Address.
    node_count : uint64
        Link nodes passed.
    """
    node_count = ZERO_U64
    while link & _NODE_BIT != ZERO_U64:
        node = graph.rows + ((link ^ _NODE_BIT) << _ROW)
        axis = np.uint64(load(np.uint32, node + _AXIS))
        t_plane, is_upward = plane_distance(line.planes, axis, load(np.float32, node))
        link = _link(node, _ABOVE if (t_plane <= t) == is_upward else _BELOW)
        node_count += ONE_U64
    return graph.rows + (link << _ROW), node_count


@device
def clip_to_scene(graph, ray, t_min, t_max):
    """Clip a ray's interval to the scene's box.

    Returns
    -------
    is_active : bool
        Whether the ray can hit anything.
    t_in : float32
        Begin of the interval.
    t_end : float32
        The next float32 after its end.
    """
    t_in, t_out = scene_interval(graph, ray, t_min, t_max)
    return graph.rows != NULL and t_in <= t_out, t_in, next_float_up(t_out)


@device
def _bin_number(position, low, scale, count):
    place = (position - low) * scale
    # Written so that a NaN becomes 0.
    return np.uint64(min(place, count - np.float32(1.0))) if place > ZERO_F32 else ZERO_U64


@device
def _bin_row(graph, ray, t):
    """The bin in which a ray is at t, up to rounding."""
    kz = ray.kz
    x = fma(t, component(kz, ray.dz, ray.dy, ray.dx), component(kz, ray.oz, ray.oy, ray.ox))
    y = fma(t, component(kz, ray.dx, ray.dz, ray.dy), component(kz, ray.ox, ray.oz, ray.oy))
    z = fma(t, component(kz, ray.dy, ray.dx, ray.dz), component(kz, ray.oy, ray.ox, ray.oz))
    counts, scales, low = graph.bin_counts, graph.bin_scales, graph.bin_low
    i = _bin_number(x, low[0], scales[0], counts[0])
    j = _bin_number(y, low[1], scales[1], counts[1])
    k = _bin_number(z, low[2], scales[2], counts[2])
    return (i * np.uint64(counts[1]) + j) * np.uint64(counts[2]) + k


@device
def _bin_sector(graph, row):
    """Address of the sector of a bin."""
    return graph.rows + (np.uint64(load(np.uint32, graph.bins + row * BYTES_32)) << _ROW)


@device
def walk_to(graph, line, sector, t, limit):
    """Walk from any sector to the one in which a ray is at t.

    First backward, until the ray enters the sector before t; then forward, until it leaves
    after t. Exact from any sector, and short from a nearby one.

    Parameters
    ----------
    graph : GraphAddresses
    line : SectorRay
    sector : uint64
        Address.
    t : float32
    limit : uint64
        Most sectors to leave: the walk then stops short.

    Returns
    -------
    sector : uint64
        Address.
    step_count : uint64
        Sectors left.
    """
    step_count = ZERO_U64
    face = _entry_face(line, sector)
    while face.t > t and step_count != limit:
        sector, _ = follow_link(graph, line, face.link, t)
        step_count += ONE_U64
        face = _entry_face(line, sector)
    face = exit_face(line, sector)
    while face.t <= t and step_count != limit:
        sector, _ = follow_link(graph, line, face.link, t)
        step_count += ONE_U64
        face = exit_face(line, sector)
    return sector, step_count


@device
def start_sector(graph, line, ray, t):
    """The sector in which a ray is at t, from the bins; and the number of steps to it."""
    sector = _bin_sector(graph, _bin_row(graph, ray, t))
    return walk_to(graph, line, sector, t, _NO_LIMIT)


@device
def start_sector_cached(graph, line, ray, t, last):
    """The sector in which a ray is at t: from the previous ray, if that began in the same bin.

    Rays of a camera share a sector, and successive rays that leave a surface mostly do:
    first hits of bounce rays became 5 to 28 % faster, others within the noise.

    Parameters
    ----------
    graph, line, ray, t
        See `start_sector`.
    last : uint64
        Address of 16 bytes: the bin of the previous ray, counted from 1, 0 before the
        first ray; and its sector. Changed.

    Returns
    -------
    sector : uint64
        Its address.
    step_count : uint64
        Sectors left on the way there.
    """
    row = _bin_row(graph, ray, t)
    if load(np.uint64, last) == row + ONE_U64:
        sector = load(np.uint64, last + _TWO_WORDS)
    else:
        sector = _bin_sector(graph, row)
        store(last, row + ONE_U64)
    sector, step_count = walk_to(graph, line, sector, t, _NO_LIMIT)
    store(last + _TWO_WORDS, sector)
    return sector, step_count


@device
def near_sector(graph, line, ray, t, number, last):
    """The sector in which a ray is at t: displaced from a nearby one where that is given.

    Parameters
    ----------
    graph, line, ray, t, last
        See `start_sector_cached`, which is the route otherwise, and after a long walk.
    number : uint64
        The ray's, for `GraphAddresses.starts`.

    Returns
    -------
    uint64
        The sector's address.
    """
    if graph.starts != NULL:
        start = load(np.int32, graph.starts + (number << _INDEX))
        if start >= np.int32(0):
            known = graph.rows + (np.uint64(start) << _SECTOR)
            sector, step_count = walk_to(graph, line, known, t, _NEARBY)
            if step_count != _NEARBY:
                return sector
    sector, _ = start_sector_cached(graph, line, ray, t, last)
    return sector


@device
def sector_number(graph, sector):
    """The number of a sector, as `GraphAddresses.starts` and `ends` have it."""
    return np.int32((sector - graph.rows) >> _SECTOR)


@device
def sector_blocks(graph, sector):
    """Addresses of a sector's first block and after its last one, and its number of triangles."""
    count = np.uint64(load(np.uint32, sector + _TRIANGLE_COUNT))
    first = np.uint64(load(np.uint32, sector + _FIRST_BLOCK))
    block = graph.blocks + first * BLOCK
    return block, blocks_end(block, count), count
