"""Rays from the host in overlapping parts: the same bits, whatever happens meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from raystream.cuda.staging import StagingStream
from raystream.jit.cuda import RangeKernel
from test_agreement import case_of

#: A simulated thread takes a tenth of a millisecond.
RAYS = 24

COLUMNS = ("t", "u", "v", "prim_id", "status")


@pytest.fixture(scope="module")
def case():
    return case_of("random_soup")


@pytest.fixture
def rays(case):
    rows = np.linspace(0, len(case.origins) - 1, RAYS).astype(int)
    return case.origins[rows].astype(np.float32), case.directions[rows].astype(np.float32)


@pytest.fixture
def oracle(case):
    return rs.Tracer(case.scene, "brute")


def assert_same(ours, theirs, *names):
    for name in names:
        assert_same_bits(getattr(ours, name), getattr(theirs, name))


def test_invalid_rays_have_a_status_where_no_hit_is_wanted(gpu, case, oracle, rays):
    origins, directions = rays
    origins[0, 1], directions[1] = np.nan, 0.0
    many = rs.Tracer(case.scene, "brute", "cuda").multi_hit(origins, directions, max_hits=0)
    assert many.status.tolist() == [1, 1, *[0] * (RAYS - 2)]
    assert_same(many, oracle.multi_hit(origins, directions, max_hits=0), "ray_splits", *COLUMNS)


def test_parts_are_half_of_the_rays_at_once(gpu, case, oracle, rays, monkeypatch):
    tracer = rs.Tracer(case.scene, "brute", "cuda", rays_at_once=14)
    steps: list[tuple[int, int]] = []
    sizes, launch_kernel = [], RangeKernel.launch

    def note(self, gpu, count, arguments, stream=None):
        sizes.append((self.name, count))
        launch_kernel(self, gpu, count, arguments, stream)

    monkeypatch.setattr(RangeKernel, "launch", note)
    many = tracer.multi_hit(*rays, progress=lambda *done: steps.append(done))
    assert_same(many, oracle.multi_hit(*rays), "ray_splits", *COLUMNS)
    assert steps == sorted(steps)
    assert steps[-1] == (2 * RAYS, 2 * RAYS)
    assert len(steps) == 2 * -(-RAYS // 7)
    for query in ("count_hits", "multi_hit"):
        assert [count for name, count in sizes if name == query] == [7, 7, 7, 3]


def is_even(hit):
    return hit.prim_id % 2 == 0


@pytest.mark.parametrize("on_hit", [None, is_even])
def test_a_part_is_copied_before_the_last_one_is_waited_for(
    gpu, case, oracle, rays, monkeypatch, on_hit
):
    """With and without a filter."""
    events = []

    def noting(name, plain):
        def note(self):
            events.append((name, self))
            plain(self)

        return note

    for name in ("begin", "finish"):
        monkeypatch.setattr(StagingStream, name, noting(name, getattr(StagingStream, name)))
    tracer = rs.Tracer(case.scene, "brute", "cuda", rays_at_once=2 * RAYS // 3)
    ours = tracer.first_hit(*rays, on_hit=on_hit)
    assert_same(ours, oracle.first_hit(*rays, on_hit=on_hit), *COLUMNS)
    names = [name for name, _ in events]
    assert names.count("begin") == 3
    assert names[:3] == ["begin", "begin", "finish"]
    assert events[0][1] is events[2][1] is not events[1][1]
    # The third part begins when the first is done, before the second is waited for.
    third = [k for k, name in enumerate(names) if name == "begin"][2]
    assert all(stream is events[0][1] for _, stream in events[2 : third + 1])


def test_an_interrupt_leaves_nothing_behind(gpu, case, oracle, rays):
    tracer = rs.Tracer(case.scene, "brute", "cuda", rays_at_once=6)
    staging_streams = tracer._backend._staging_streams

    def interrupt(done, count):
        assert not staging_streams._free  # they are in use
        if done > 8:
            raise KeyboardInterrupt

    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            tracer.first_hit(*rays, progress=interrupt)
        assert len(staging_streams._free) == 2
    assert_same(tracer.first_hit(*rays), oracle.first_hit(*rays), *COLUMNS)
    assert len(staging_streams._free) == 2
