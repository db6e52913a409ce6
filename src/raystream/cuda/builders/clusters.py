"""BVH construction by parallel locally-ordered clustering (PLOC) in Morton order.

References
----------
Meister and Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume Hierarchy
Construction", IEEE Transactions on Visualization and Computer Graphics 24(3), 2018.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.binary_tree import Nodes, join
from raystream.jit.constants import (
    BITS_32,
    INF_F32,
    LOW_32,
    ONE_U64,
    SHIFT_32,
    SHIFT_64,
    ZERO_U64,
)
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.scan import Scan
from raystream.jit.simd import f32x8, load, maximum, store
from raystream.structures.bvh.builder.prim_refs import FIRST_AT, REF_BYTES, half_area

#: Search radius: how far before and after a cluster its match may be. With 16 and 32 the trees are
#: no better, and take more rounds.
_RADIUS = np.uint64(8)

#: Rounds between readbacks of the cluster count. If they merged less than this share of the
#: clusters, the next round pairs them by position: a last resort, since it makes worse trees.
_ROUNDS, _LEAST_SHARE = 4, 0.25


class ClusterList(NamedTuple):
    """Clusters on a device.

    Attributes
    ----------
    boxes : DeviceArray of uint8
        Their boxes and tree rows, as in `bvh.prim_refs`.
    cluster_count : DeviceArray of shape (1,), uint64
        Their number.
    """

    boxes: DeviceArray
    cluster_count: DeviceArray


@gpu_kernel(nodes=Nodes)
def begin_cluster(i, nodes, boxes):
    """Make a cluster of leaf i."""
    at = boxes + i * np.uint64(REF_BYTES)
    store(at, load(f32x8, nodes.boxes + i * np.uint64(REF_BYTES)))
    store(at + np.uint64(FIRST_AT), np.int32(i))


@gpu_kernel(clusters=ClusterList, by_place=bool)
def find_match(i, clusters, by_place, matches):
    """Find the cluster near cluster i whose common box with it is smallest.

    Ties go to the cluster whose index differs in lower bits: so all clusters rank pairs alike,
    the first pair always merges, and identical triangles pair up.
    """
    count = load(np.uint64, clusters.cluster_count)
    if i >= count:
        return
    match = i
    if by_place:
        match = i ^ ONE_U64 if (i ^ ONE_U64) < count else i
    else:
        own = load(f32x8, clusters.boxes + i * np.uint64(REF_BYTES))
        least = INF_F32
        first = i - min(i, _RADIUS)
        last = min(i + _RADIUS, count - ONE_U64)
        for j in range(first, last + ONE_U64):
            if j != i:
                other = load(f32x8, clusters.boxes + j * np.uint64(REF_BYTES))
                area = half_area(maximum(own, other))
                if area < least or match == i or (area == least and (i ^ j) < (i ^ match)):
                    match, least = j, area
    store(matches + (i << SHIFT_32), np.uint32(match))


@gpu_kernel(clusters=ClusterList)
def count_places(i, clusters, matches, places):
    """Count 1 if cluster i remains, and 2**32 if it makes a node, as the first of a pair."""
    place = ZERO_U64
    if i < load(np.uint64, clusters.cluster_count):
        match = np.uint64(load(np.uint32, matches + (i << SHIFT_32)))
        is_pair = match != i and np.uint64(load(np.uint32, matches + (match << SHIFT_32))) == i
        if not is_pair:
            place = ONE_U64
        elif i < match:
            place = ONE_U64 | (ONE_U64 << BITS_32)
    store(places + (i << SHIFT_64), place)


@gpu_kernel(clusters=ClusterList, nodes=Nodes, to=ClusterList)
def merge(i, clusters, bound, matches, places, nodes, leaf_count, to):
    """Write cluster i, or the node that merges it with its match, at its offset in the scan."""
    count = load(np.uint64, clusters.cluster_count)
    own = load(np.uint64, places + (i << SHIFT_64))
    after = load(np.uint64, places + ((i + ONE_U64) << SHIFT_64))
    if i + ONE_U64 == bound:
        store(to.cluster_count, after & LOW_32)
    if i >= count or own == after:
        return
    at = clusters.boxes + i * np.uint64(REF_BYTES)
    new = to.boxes + (own & LOW_32) * np.uint64(REF_BYTES)
    row = np.uint64(load(np.int32, at + np.uint64(FIRST_AT)))
    if (own >> BITS_32) == (after >> BITS_32):
        store(new, load(f32x8, at))
        store(new + np.uint64(FIRST_AT), np.int32(row))
        return
    match = np.uint64(load(np.uint32, matches + (i << SHIFT_32)))
    other_at = clusters.boxes + match * np.uint64(REF_BYTES) + np.uint64(FIRST_AT)
    # Each node made before this round removed one cluster.
    made = leaf_count + (leaf_count - count) + (own >> BITS_32)
    join(nodes, made, row, np.uint64(load(np.int32, other_at)))
    store(new, load(f32x8, nodes.boxes + made * np.uint64(REF_BYTES)))
    store(new + np.uint64(FIRST_AT), np.int32(made))


def merge_clusters(gpu: Gpu, nodes: Nodes) -> int:
    """Write the inner nodes of a tree; returns the root's row.

    Parameters
    ----------
    gpu : Gpu
    nodes : Nodes
        With its leaves, in Morton order.

    Notes
    -----
    The host reads the number of clusters every fourth round: a few milliseconds of a build are
    waits. In a run of boxes that grow from each to the next, a round merges only the first pair;
    when few merge, one round pairs clusters by position, so that the number of rounds is at most
    about ten times the logarithm of the number of triangles.

    Raises
    ------
    CudaError
        If device memory runs out: it takes 80 bytes per leaf.
    """
    bound = nodes.leaf_count
    clusters, to = (
        ClusterList(
            gpu.empty("clusters", (bound, REF_BYTES), np.uint8),
            gpu.upload("number of clusters", np.array([bound], np.uint64)),
        )
        for _ in range(2)
    )
    matches = gpu.empty("matches", bound, np.uint32)
    places = gpu.empty("places", bound + 1, np.uint64)
    leaf_count, scan = np.uint64(bound), Scan(gpu, bound)
    begin_cluster.launch(gpu, bound, (nodes, clusters.boxes))
    by_place = False
    while bound > 1:
        for _ in range(_ROUNDS):
            find_match.launch(gpu, bound, (clusters, by_place, matches))
            count_places.launch(gpu, bound, (clusters, matches, places))
            scan.run(places.address, bound, places.address, np.uint64)
            found = np.uint64(bound), matches, places
            merge.launch(gpu, bound, (clusters, *found, nodes, leaf_count, to))
            clusters, to = to, clusters
            by_place = False
        left = int(clusters.cluster_count.host()[0])
        by_place = left > (1.0 - _LEAST_SHARE) * bound
        bound = left
    return max(0, 2 * nodes.leaf_count - 2)
