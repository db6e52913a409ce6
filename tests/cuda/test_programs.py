"""Programs and filters at hits that CUDA found: what the processor's tracers give."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import CUDA_TRACERS, assert_same_bits
from programs.layers import layers_rays, layers_scene
from raystream.programs import rounds

RECORD = np.dtype([("hits", "i4"), ("depth", "f8"), ("ids", "i8")])


def fold(hit, payload):
    """It depends on the order, and ends at its tenth hit."""
    payload.hits += 1
    payload.depth += hit.t * payload.hits
    payload.ids = 7 * payload.ids + hit.prim_id
    return rs.STOP if payload.hits == 10 else rs.CONTINUE


def one_in_five(hit):
    return hit.prim_id % 5 == 0


def until_one_in_five(hit):
    return rs.STOP if hit.prim_id % 5 == 0 else rs.IGNORE


@pytest.fixture(params=["all hits at once", "a few hits at a time"])
def rays(request, monkeypatch):
    """Few rays, each with many hits; one is invalid."""
    if request.param == "a few hits at a time":
        monkeypatch.setattr(rounds, "FIRST_RAYS", 8)
        monkeypatch.setattr(rounds, "RAYS_PER_BLOCK", 8)
        monkeypatch.setattr(rounds, "FEW_HITS", 0)
        monkeypatch.setattr(rounds, "SEEN_SHARE", 1.0)
    origins, directions = layers_rays(5, 5)
    return {"origins": origins, "directions": directions}


@pytest.fixture(params=["brute", "grid", "kdtree, stack"])
def tracers(request, gpu):
    """One on the device, and the same on the CPU."""
    options, scene = CUDA_TRACERS[request.param], layers_scene()
    return [rs.Tracer(scene, **{**options, "device": device}) for device in ("cuda", "cpu")]


def assert_same_hits(ours, theirs):
    for name in ("t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(ours, name), getattr(theirs, name))


def test_programs_run_at_all_hits_in_order(tracers, rays):
    ours, theirs = (tracer.trace(**rays, on_hit=fold, payload=RECORD) for tracer in tracers)
    assert ours.tobytes() == theirs.tobytes()
    assert ours["hits"].max() == 10


@pytest.mark.parametrize("on_hit", [one_in_five, until_one_in_five])
def test_filters_hide_hits_from_every_query(tracers, rays, on_hit):
    asked = [
        [
            tracer.first_hit(**rays, on_hit=on_hit),
            tracer.any_hit(**rays, on_hit=on_hit),
            tracer.count_hits(**rays, on_hit=on_hit),
            tracer.multi_hit(**rays, on_hit=on_hit, max_hits=3),
        ]
        for tracer in tracers
    ]
    (first, seen, counts, many), (first_, seen_, counts_, many_) = asked
    assert_same_hits(first, first_)
    assert_same_bits(seen, seen_)
    assert_same_bits(counts, counts_)
    assert_same_bits(many.ray_splits, many_.ray_splits)
    assert_same_hits(many, many_)
    assert 0 < seen.sum() < seen.size
    assert (first.prim_id[seen] % 5 == 0).all()


def test_triangles_are_skipped(tracers, rays):
    nearest = tracers[1].first_hit(**rays).prim_id
    ours, theirs = (tracer.first_hit(**rays, skip_prim_ids=nearest) for tracer in tracers)
    assert_same_hits(ours, theirs)
    assert (ours.prim_id[nearest >= 0] != nearest[nearest >= 0]).all()
    ours, theirs = (tracer.count_hits(**rays, skip_prim_ids=nearest) for tracer in tracers)
    assert_same_bits(ours, theirs)


def test_a_counting_tracer_runs_no_programs(gpu):
    tracer = rs.Tracer(layers_scene(), "brute", "cuda", counters=True)
    with pytest.raises(ValueError, match="counters=True"):
        tracer.first_hit([0.5, 0.5, -1.0], [0.0, 0.0, 1.0], on_hit=one_in_five)
