"""The roofline: counts of a tree that is known, and kernels that do what they count."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.bench.contenders.base import Rays
from raystream.bench.peak_kernels import test_blocks as run_blocks
from raystream.bench.peak_kernels import test_nodes as run_nodes
from raystream.bench.roofline import Counts, Peaks, count_tests, measure_peaks, most_rays
from raystream.core.rays import RayBatch
from raystream.kernels.ray_source import RaySource

#: Four triangles one behind the other: one block, and no node but the root.
LAYERS = np.array(
    [[[k, -9.0, -9.0], [k, 9.0, -9.0], [k, 0.0, 9.0]] for k in np.linspace(0.0, 1.0, 4)]
)


def rays_along_x(y):
    origins = np.array([[-3.0, one, 0.0] for one in y], np.float32)
    return Rays(origins, np.tile(np.float32([1.0, 0.0, 0.0]), (len(y), 1)), np.inf)


@pytest.fixture(scope="module")
def tracer():
    faces = np.arange(12).reshape(-1, 3)
    return rs.Tracer(rs.Scene.from_arrays(LAYERS.reshape(-1, 3), faces), counters=True)


def test_counts(tracer):
    rays = rays_along_x([0.0, 0.5, 50.0, 60.0])  # two of them miss the scene's box
    nodes, blocks, hits = count_tests(tracer, "first", rays)
    assert (nodes, blocks, hits) == (0.5, 0.5, 0.5)
    assert count_tests(tracer, "any", rays) == (0.5, 0.5, 0.5)
    assert count_tests(tracer, "multi", rays) == (0.5, 0.5, 8 / 4 / 4)


def test_most_rays():
    peaks = Peaks(nodes=1e9, blocks=5e8, hit_blocks=1e8)
    assert most_rays(peaks, Counts(1.0, 0.0, 0.0)) == pytest.approx(1e9)
    assert most_rays(peaks, Counts(0.0, 2.0, 0.0)) == pytest.approx(2.5e8)
    assert most_rays(peaks, Counts(0.0, 1.0, 1.0)) == pytest.approx(1e8)
    assert most_rays(peaks, Counts(0.0, 0.0, 0.0)) is None
    assert most_rays(peaks, Counts(10.0, 3.0, 1.0)) == pytest.approx(1e9 / (10 + 2 * 2 + 10))


def test_kernels_do_the_tests_that_are_counted(tracer):
    structure = tracer.structure
    rays = rays_along_x([0.0, 0.5, 50.0])
    batch = RayBatch(rays.origins, rays.directions)
    source, _kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    times = np.uint64(5)
    for run, rows, each in (
        (run_nodes, structure.tree.nodes, 1),
        (run_blocks, structure.tree.leaves, 4),
    ):
        found = np.zeros(1, np.uint64)
        at, count = np.uint64(rows.ctypes.data), np.uint64(len(rows))
        assert count == 1
        run(0, 3, at, count, times, source, structure.frame, found)
        assert found[0] == 2 * each * times  # two rays of three enter the box, or hit all


def test_peaks_are_in_order():
    peaks = measure_peaks()
    assert all(1e5 < one < 1e12 for one in peaks)
    assert peaks.hit_blocks < peaks.nodes
