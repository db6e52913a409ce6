"""Kernels that do nothing but the tests of a traversal, on nodes and leaf blocks in the cache."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import mask_bits, maximum, minimum, popcount, scratch
from raystream.kernels.leaf_block import BLOCK, block_ray, test_block
from raystream.kernels.ray import prepare_ray
from raystream.kernels.ray_source import load_ray
from raystream.kernels.triangle_lanes import slab_interval
from raystream.structures.bvh.node_layout import Node, plane_row

_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)


@device
def _prepared(source, i, frame):
    ray = load_ray(source, i, frame)
    return ray, prepare_ray(ray.origin, ray.direction, frame.max_coordinate)


@kernel
def test_nodes(begin, end, nodes, count, times, source, frame, found):
    """Test rays begin to end against the eight boxes of each node, several times.

    Parameters
    ----------
    begin, end : int
    nodes : uint64
        Address of the first of `count` nodes.
    count, times : uint64
    source : RaySource
    frame : SceneFrame
    found : ndarray of uint64
        The boxes entered are added to element 0.
    """
    entered_count = ZERO_U64
    for i in range(np.uint64(begin), np.uint64(end)):
        start, ray = _prepared(source, i, frame)
        inv = ray.inv_x, ray.inv_y, ray.inv_z
        near = ray.near_x, ray.near_y, ray.near_z
        far = ray.far_x, ray.far_y, ray.far_z
        x, y, z = plane_row(_X, inv[0]), plane_row(_Y, inv[1]), plane_row(_Z, inv[2])
        for _ in range(times):
            for k in range(count):
                planes = Node(nodes, k).planes
                first = planes[x], planes[y], planes[z]
                box = (*first, planes[x ^ ONE_U64], planes[y ^ ONE_U64], planes[z ^ ONE_U64])
                t_in, t_out = slab_interval(box, inv, near, far)
                entered = maximum(t_in, start.t_min) <= minimum(t_out, start.t_max)
                entered_count += popcount(mask_bits(entered))
    found[0] += entered_count


@kernel
def test_blocks(begin, end, blocks, count, times, source, frame, found):
    """Test rays begin to end against the triangles of each block, several times.

    Parameters
    ----------
    begin, end : int
    blocks : uint64
        Address of the first of `count` blocks.
    count, times : uint64
    source : RaySource
    frame : SceneFrame
    found : ndarray of uint64
        The triangles hit are added to element 0.
    """
    lanes = scratch(64)
    hit_count = ZERO_U64
    for i in range(np.uint64(begin), np.uint64(end)):
        start, ray = _prepared(source, i, frame)
        line = block_ray(ray)
        for _ in range(times):
            for k in range(count):
                bits = test_block(blocks + k * BLOCK, line, start.t_min, start.t_max, False, lanes)
                hit_count += popcount(bits)
    found[0] += hit_count
