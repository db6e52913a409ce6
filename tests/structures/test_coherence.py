"""Choice of the kernel for a batch: the probe of its rays, and the decision."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.core.rays import RayBatch
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.coherence import Coherence, choose_kernel, probe, rivals
from raystream.structures.bvh.packets.rays import PacketOrder


@pytest.fixture(scope="module")
def frame():
    return rs.Tracer(rs.load("cornell")).structure.frame


def look(frame, origins, directions, byte_count=100_000):
    batch = RayBatch(origins, directions, 0.0, np.inf)
    source, _kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    return probe(source, PacketOrder.of(batch.shape), frame, byte_count)


def points(frame, rng, count):
    """Anywhere in the scene, world space."""
    low, high = np.array(frame.low), np.array(frame.high)
    return rng.uniform(low, high, (count, 3)) / frame.scale + frame.center


def test_a_picture_is_narrow_and_close(frame):
    origins, directions = rs.load("cornell").camera.rays(512, 512)
    assert look(frame, origins, directions) == Coherence(1.0, 1.0, 1.0, 1.0)


def test_random_rays_have_nothing_in_common(frame, rng):
    found = look(frame, points(frame, rng, 4096), rng.normal(size=(4096, 3)))
    assert found == Coherence(0.0, 0.0, 0.0, 0.0)


def test_rays_from_a_point_in_all_directions_are_close(frame, rng):
    origins = np.broadcast_to(np.array(frame.center), (4096, 3))
    found = look(frame, origins, rng.normal(size=(4096, 3)))
    assert (found.narrow, found.near, found.close) == (0.0, 1.0, 1.0)


def test_what_is_close_depends_on_the_size_of_triangles(frame, rng):
    size = float(max(np.array(frame.high) - np.array(frame.low))) / frame.scale
    steps = np.arange(4096) % 16 * size * 0.004  # a group is 0.06 of the scene long
    origins = np.array(frame.center) + steps[:, None] * [1, 0, 0]
    directions = np.broadcast_to([0.0, 1.0, 0.0], (4096, 3))
    assert look(frame, origins, directions, 100_000) == Coherence(1.0, 1.0, 1.0, 0.0)
    assert look(frame, origins, directions, 100_000_000) == Coherence(1.0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("coherence", "count", "byte_count", "kernel"),
    [
        (Coherence(1.0, 1.0, 1.0, 0.0), 2_000, 10**9, "packet"),
        (Coherence(1.0, 1.0, 0.0, 0.0), 10**6, 10**8, "groups"),
        (Coherence(0.0, 1.0, 1.0, 0.0), 10**6, 10**8, "groups"),
        (Coherence(0.0, 1.0, 1.0, 0.0), 2_000, 10**8, "wavefront"),
        (Coherence(0.0, 0.0, 0.0, 0.0), 10**6, 2**26, "groups"),
        (Coherence(0.0, 0.0, 0.0, 0.0), 10**6, 2**26 + 1, "wavefront"),
        (Coherence(0.0, 0.0, 0.0, 0.0), 10**6, 10**8, "wavefront"),
        (Coherence(0.0, 0.0, 0.0, 0.0), 10**5, 10**8, "wavefront"),
        (Coherence(1.0, 0.0, 0.0, 0.0), 10**5, 10**6, "groups"),
    ],
)
def test_choice(coherence, count, byte_count, kernel):
    assert choose_kernel(coherence, count, byte_count) == kernel


@pytest.mark.parametrize(
    ("coherence", "guess", "others"),
    [
        (Coherence(1.0, 1.0, 1.0, 1.0), "packet", ()),
        (Coherence(1.0, 1.0, 1.0, 0.0), "packet", ("groups",)),
        (Coherence(1.0, 1.0, 0.0, 0.0), "groups", ("packet",)),
        (Coherence(0.0, 1.0, 1.0, 0.0), "groups", ("wavefront",)),
        (Coherence(0.0, 0.0, 0.0, 0.0), "wavefront", ("groups",)),
    ],
)
def test_rivals(coherence, guess, others):
    assert rivals(coherence, guess) == others
