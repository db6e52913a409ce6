"""Roofline: the tests that a machine can do in a second, and those that rays need at least.

A ray that descends the BVH on its own, the nearest child first, tests the eight boxes of some nodes
and the four triangles of some leaf blocks. If it did nothing else, with every node in the
first-level cache, it would take as long as these tests do in `peak_kernels`. The share of
that bound that is reached tells what is left for memory, lists, stacks, and reading and writing
rays. Packets may exceed it: they cull a box for many rays with one test.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.bench.contenders.base import Query, Rays
from raystream.bench.peak_kernels import test_blocks, test_nodes
from raystream.core.rays import RayBatch
from raystream.jit.threads import parallel_for, thread_count
from raystream.kernels.ray_source import RaySource
from raystream.scene.scene import Scene
from raystream.structures.bvh.structure import BvhStructure
from raystream.tracer import Tracer

#: Most rays that are counted of a set, evenly spread.
_SAMPLE = 1 << 16

#: Most nodes and blocks that are tested over and over: 16 KB and 10 KB.
_NODES, _BLOCKS = 64, 64

#: Rays of a measurement, for each thread; tests of a ray are repeated this often.
_RAYS, _TIMES = 256, 32

#: Measurements; the fastest counts.
_ROUNDS = 7


class Peaks(NamedTuple):
    """Tests per second of all threads together, with everything in the first-level cache.

    Parameters
    ----------
    nodes : float
        Tests of a ray against the eight boxes of a node.
    blocks : float
        Tests of a ray against the four triangles of a leaf block, all of which it misses.
    hit_blocks : float
        The same if the ray hits: with distances and barycentrics.
    """

    nodes: float
    blocks: float
    hit_blocks: float


class Counts(NamedTuple):
    """Tests per ray of a set, when each ray is traced on its own.

    Parameters
    ----------
    nodes, blocks : float
        Nodes and leaf blocks tested.
    hits : float
        Blocks with a hit, at least: one of a ray that hits; for all hits, one for four hits.
    """

    nodes: float
    blocks: float
    hits: float


def measure_peaks() -> Peaks:
    """Measure the tests per second of this machine, on `thread_count` threads."""
    count = _RAYS * thread_count()
    rng = np.random.default_rng(0)
    # Small triangles in a box, and rays that pass beside it: no block has a hit.
    corners = rng.random((1024, 1, 3)) + 0.01 * rng.normal(size=(1024, 3, 3))
    crowd = _structure(corners)
    across = rng.uniform(-0.4, 0.4, (count, 3)) + [0.5, 0.5, 0.5]
    forward = np.ones((count, 3)) + rng.uniform(-0.2, 0.2, (count, 3))
    nodes = _rate(test_nodes, crowd, crowd.tree.nodes[:_NODES], across - 4.0 * forward, forward)
    beside = across + [0.0, 9.0, 0.0]
    along = np.tile([1.0, 0.02, 0.02], (count, 1))
    blocks = _rate(test_blocks, crowd, crowd.tree.leaves[:_BLOCKS], beside, along)
    # Triangles one behind the other, and rays through all of them.
    layers = np.array([[0.0, -9.0, -9.0], [0.0, 9.0, -9.0], [0.0, 0.0, 9.0]])
    stack = _structure(layers + np.arange(4 * _BLOCKS)[:, None, None] * [0.01, 0.0, 0.0])
    through = rng.uniform(-0.5, 0.5, (count, 3)) - [9.0, 0.0, 0.0]
    hit_blocks = _rate(test_blocks, stack, stack.tree.leaves[:_BLOCKS], through, along)
    return Peaks(nodes, blocks, hit_blocks)


def count_tests(tracer: Tracer, query: Query, rays: Rays) -> Counts:
    """Count the tests of a set, on a sample of its rays.

    Parameters
    ----------
    tracer : Tracer
        With ``counters=True``, structure ``"bvh"`` and at most four triangles in a leaf.
    query : {"first", "any", "multi"}
    rays : Rays
        At least one.
    """
    origins, directions = rays.rows()
    step = -(-len(origins) // _SAMPLE)
    sample = origins[::step], directions[::step]
    if query == "first":
        hits = float(np.sum(tracer.first_hit(*sample, t_max=rays.t_max).is_hit))
    elif query == "any":
        hits = float(np.sum(tracer.any_hit(*sample, t_max=rays.t_max)))
    else:
        hits = float(np.sum(tracer.count_hits(*sample, t_max=rays.t_max))) / 4.0
    counted, count = tracer.counters, len(sample[0])
    assert counted is not None
    nodes, blocks = (float(np.sum(one)) / count for one in (counted.steps, counted.leaves))
    return Counts(nodes, blocks, hits / count)


def most_rays(peaks: Peaks, counts: Counts) -> float | None:
    """Rays per second if they took no longer than their tests; None if they need no test."""
    whole = max(1.0 / peaks.hit_blocks, 1.0 / peaks.blocks)
    missed = max(counts.blocks - counts.hits, 0.0)
    seconds = counts.nodes / peaks.nodes + missed / peaks.blocks + counts.hits * whole
    return 1.0 / seconds if seconds > 0.0 else None


def _structure(corners: NDArray[np.float64]) -> BvhStructure:
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    structure = Tracer(Scene.from_arrays(corners.reshape(-1, 3), faces)).structure
    assert isinstance(structure, BvhStructure)
    return structure


def _rate(
    run: Callable[..., None],
    structure: BvhStructure,
    rows: NDArray[np.float32],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> float:
    """Tests per second of rays against the first rows of nodes or blocks."""
    batch = RayBatch(origins.astype(np.float32), directions.astype(np.float32))
    source, kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    at, count, times = (np.uint64(n) for n in (rows.ctypes.data, len(rows), _TIMES))
    found = np.zeros(1, np.uint64)

    def body(begin: int, end: int) -> None:
        run(begin, end, at, count, times, source, structure.frame, found)

    best = np.inf
    for _ in range(_ROUNDS):
        started = time.perf_counter()
        parallel_for(body, len(batch), 16)
        best = min(best, time.perf_counter() - started)
    del kept  # the kernels read it by address
    return len(batch) * len(rows) * _TIMES / best
