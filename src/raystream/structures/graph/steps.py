"""The steps of a ray's way through a graph of sectors, each a function of a small state.

A ray meets a plane at one distance, ``fma(plane, inv, middle)``: that of the kd-tree's steps,
and for the same reason. It depends on the plane alone and is monotone in its position, so a
distance t is either before a plane or not, whichever sector asks. A ray is in a sector for
t_in <= t < t_out, from the last of the planes by which it comes in to the first of those by
which it goes out; the sides of the scene's box are no such planes. So each t belongs to exactly
one sector, and a hit counts in the sector that its t belongs to, and nowhere else.

No ray loops. A step goes through a face on the side that the ray goes to, and sectors are the
leaves of splits: all sectors behind such a face come later in the order in which rays of that
octant meet sectors, whatever the distances are.

References
----------
Gribble and Naveros, "GPU Ray Tracing with Rayforce", SIGGRAPH 2013 posters. How sectors are
linked and walked is our reading of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import fma, load, next_float_up, store
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.kernels.ray import component
from raystream.kernels.slab import box_interval

__all__ = [
    "Face",
    "GraphAddresses",
    "SectorRay",
    "clip_to_scene",
    "exit_face",
    "follow_link",
    "sector_blocks",
    "sector_ray",
    "start_sector",
    "start_sector_cached",
    "walk_to",
]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)

# Where words of a sector are, in bytes.
_FIRST_BLOCK = np.uint64(12)
_HIGH = np.uint64(16)
_TRIANGLE_COUNT = np.uint64(28)
_LINKS = np.uint64(32)
_WORD = np.uint64(4)
_TWO_WORDS = np.uint64(8)

# Where words of a link node are; its first is the plane.
_AXIS = np.uint64(4)
_BELOW = np.uint64(8)
_ABOVE = np.uint64(12)

_ROW = np.uint64(4)  # a row's 16 bytes, as a shift
_NODE_BIT = np.uint64(1 << 31)
_NO_LIMIT = np.uint64(2**63)


class GraphAddresses(NamedTuple):
    """A graph as kernels take it; whoever calls one keeps the arrays alive.

    Attributes
    ----------
    rows : uint64
        Address of `layout.GraphArrays.rows`, but with planes at infinity where sectors have no
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
        Bins in a unit of length; 0 where there is one of no size.
    low, high : tuple of three float32
        The scene's box.
    """

    rows: np.uint64
    blocks: np.uint64
    bins: np.uint64
    bin_counts: tuple[np.float32, np.float32, np.float32]
    bin_low: tuple[np.float32, np.float32, np.float32]
    bin_scales: tuple[np.float32, np.float32, np.float32]
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]


class SectorRay(NamedTuple):
    """What steps need of a ray.

    Attributes
    ----------
    inv_x, inv_y, inv_z, middle_x, middle_y, middle_z : float32
        Constants of its distances to planes.
    out_x, out_y, out_z : uint64
        Where a sector has the planes by which it goes out, in bytes.
    link_x, link_y, link_z : uint64
        Where it has their links.
    """

    inv_x: np.float32
    inv_y: np.float32
    inv_z: np.float32
    middle_x: np.float32
    middle_y: np.float32
    middle_z: np.float32
    out_x: np.uint64
    out_y: np.uint64
    out_z: np.uint64
    link_x: np.uint64
    link_y: np.uint64
    link_z: np.uint64


class Face(NamedTuple):
    """A face of a sector: the distance at which a ray meets its plane, and its link."""

    t: np.float32
    link: np.uint64


@device
def sector_ray(ray):
    """What steps need of a `kernels.ray.Ray`.

    ``middle`` is the mean of the slab constants of both paddings: that of a plane without any,
    to two roundings.
    """
    high_x = _HIGH if ray.inv_x > _ZERO else _NONE
    high_y = _HIGH if ray.inv_y > _ZERO else _NONE
    high_z = _HIGH if ray.inv_z > _ZERO else _NONE
    return SectorRay(
        ray.inv_x,
        ray.inv_y,
        ray.inv_z,
        (ray.near_x + ray.far_x) * _HALF,
        (ray.near_y + ray.far_y) * _HALF,
        (ray.near_z + ray.far_z) * _HALF,
        high_x,
        high_y + _WORD,
        high_z + _TWO_WORDS,
        # Links are in pairs: that of the low side, and that of the high side.
        _LINKS + (high_x >> np.uint64(2)),
        _LINKS + _TWO_WORDS + (high_y >> np.uint64(2)),
        _LINKS + _TWO_WORDS + _TWO_WORDS + (high_z >> np.uint64(2)),
    )


@device
def _link(sector, at):
    return np.uint64(load(np.uint32, sector + at))


@device
def exit_face(line, sector):
    """The face by which a ray leaves a sector: inf at the last one.

    Parameters
    ----------
    line : SectorRay
    sector : uint64
        Address.

    Returns
    -------
    Face
    """
    t, link = _plane(sector, line.out_x, line.inv_x, line.middle_x), line.link_x
    t_y = _plane(sector, line.out_y, line.inv_y, line.middle_y)
    if t_y < t:
        t, link = t_y, line.link_y
    t_z = _plane(sector, line.out_z, line.inv_z, line.middle_z)
    if t_z < t:
        t, link = t_z, line.link_z
    return Face(t, _link(sector, link))


@device
def _entry_face(line, sector):
    """The face by which a ray comes into a sector: -inf at the first one."""
    t, link = _plane(sector, line.out_x ^ _HIGH, line.inv_x, line.middle_x), line.link_x
    t_y = _plane(sector, line.out_y ^ _HIGH, line.inv_y, line.middle_y)
    if t_y > t:
        t, link = t_y, line.link_y
    t_z = _plane(sector, line.out_z ^ _HIGH, line.inv_z, line.middle_z)
    if t_z > t:
        t, link = t_z, line.link_z
    return Face(t, _link(sector, link ^ _WORD))


@device
def _plane(sector, at, inv, middle):
    """Distance to a plane of a sector; infinite where it is at the scene's side."""
    return fma(load(np.float32, sector + at), inv, middle)


@device
def follow_link(graph, line, link, t):
    """Follow a link, through the nodes that tell sectors apart, to where a ray is at t.

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
        Link nodes that were passed.
    """
    node_count = _NONE
    while link & _NODE_BIT != _NONE:
        node = graph.rows + ((link ^ _NODE_BIT) << _ROW)
        axis = np.uint64(load(np.uint32, node + _AXIS))
        inv = component(axis, line.inv_x, line.inv_y, line.inv_z)
        middle = component(axis, line.middle_x, line.middle_y, line.middle_z)
        is_behind = fma(load(np.float32, node), inv, middle) <= t
        link = _link(node, _ABOVE if is_behind == (inv > _ZERO) else _BELOW)
        node_count += _ONE
    return graph.rows + (link << _ROW), node_count


@device
def clip_to_scene(graph, ray, t_min, t_max):
    """The part of a ray's interval in which it can hit anything.

    Returns
    -------
    is_active : bool
        Whether there is such a part.
    t_in : float32
        Where it begins.
    t_end : float32
        Just after the last t that is wanted.
    """
    low, high = graph.low, graph.high
    t_in, t_out = box_interval(ray, low[0], low[1], low[2], high[0], high[1], high[2])
    # A hit lies in its triangle's interval, so in that of the scene's box.
    t_in, t_out = max(t_in, t_min), min(t_out, t_max)
    return graph.rows != _NONE and t_in <= t_out, t_in, next_float_up(t_out)


@device
def _bin_number(position, low, scale, count):
    place = (position - low) * scale
    # Written so that a NaN becomes 0.
    return np.uint64(min(place, count - np.float32(1.0))) if place > _ZERO else _NONE


@device
def _bin_row(graph, ray, t):
    """The bin in which a ray is at t, to a rounding."""
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
    """The sector of a bin; its address."""
    return graph.rows + (np.uint64(load(np.uint32, graph.bins + row * _WORD)) << _ROW)


@device
def walk_to(graph, line, sector, t, limit):
    """Walk from any sector to the one in which a ray is at t.

    First back, through faces by which the ray comes in, until all of them are before t; then
    on, until none by which it goes out is. Exact from wherever it begins; near by, it is short.

    Parameters
    ----------
    graph : GraphAddresses
    line : SectorRay
    sector : uint64
        Address.
    t : float32
    limit : uint64
        Most sectors that are left: the walk then ends on its face.

    Returns
    -------
    sector : uint64
        Address.
    step_count : uint64
        Sectors that were left.
    """
    step_count = _NONE
    face = _entry_face(line, sector)
    while face.t > t and step_count != limit:
        sector, _ = follow_link(graph, line, face.link, t)
        step_count += _ONE
        face = _entry_face(line, sector)
    face = exit_face(line, sector)
    while face.t <= t and step_count != limit:
        sector, _ = follow_link(graph, line, face.link, t)
        step_count += _ONE
        face = exit_face(line, sector)
    return sector, step_count


@device
def start_sector(graph, line, ray, t):
    """The sector in which a ray is at t, from the bins; and the sectors left on the way there."""
    sector = _bin_sector(graph, _bin_row(graph, ray, t))
    return walk_to(graph, line, sector, t, _NO_LIMIT)


@device
def start_sector_cached(graph, line, ray, t, last):
    """The sector in which a ray is at t: from the ray before, if that began in the same bin.

    The rays of a camera share a sector, and those that leave a surface one after the other
    mostly do: first hits of bounce rays were 5 to 28 % faster for it, others within the noise.

    Parameters
    ----------
    graph, line, ray, t
        See `start_sector`.
    last : uint64
        Address of 16 bytes: the number of the last ray's bin, counted from 1, 0 before the
        first ray; and the sector in which it was. Changed.

    Returns
    -------
    uint64
        The sector's address.
    """
    row = _bin_row(graph, ray, t)
    if load(np.uint64, last) == row + _ONE:
        sector = load(np.uint64, last + _TWO_WORDS)
    else:
        sector = _bin_sector(graph, row)
        store(last, row + _ONE)
    sector, _ = walk_to(graph, line, sector, t, _NO_LIMIT)
    store(last + _TWO_WORDS, sector)
    return sector


@device
def sector_blocks(graph, sector):
    """A sector's first block, after its last one, and its number of triangles."""
    count = np.uint64(load(np.uint32, sector + _TRIANGLE_COUNT))
    first = np.uint64(load(np.uint32, sector + _FIRST_BLOCK))
    block = graph.blocks + first * BLOCK
    return block, blocks_end(block, count), count
