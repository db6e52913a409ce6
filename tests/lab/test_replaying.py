"""Replayed schedules: exactly the passes that the multipass machine runs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from lab.walking import PLACED, scene_and_rays, walks_of
from raystream.machines import Queues
from raystream.machines.schedulers import SCHEDULERS, Double, MostWork, Naive, Threshold
from raystream_lab.walks import record, replay, sweep

#: Scheduler and threshold, traversal steps and intersections in a pass.
WAYS = [
    *[(scheduler, 0.2, 1, 1) for scheduler in SCHEDULERS],
    *[(scheduler, 0.2, 4, 2) for scheduler in SCHEDULERS],
    ("threshold", 0.0, 1, 1),
    ("threshold", 0.05, 3, 1),
    ("threshold", 0.6, 1, 5),
    ("threshold", 1.0, 1, 1),
]


@pytest.mark.parametrize("name", [*PLACED, "any hits"])
def test_a_replay_is_what_the_machine_runs(name):
    any_hit = name == "any hits"
    structure = "kdtree, stack" if any_hit else name
    scene, rays = scene_and_rays()
    walks = walks_of(structure, any_hit)
    for scheduler, threshold, steps, tests in WAYS:
        own = {"traversal_steps": steps, "intersections": tests}
        own |= {"scheduler": scheduler, "threshold": threshold}
        tracer = rs.Tracer(scene, **PLACED[structure], machine="multipass", counters=True, **own)
        tracer.any_hit(**rays) if any_hit else tracer.first_hit(**rays)
        passes = tracer.counters.passes
        replayed = replay(walks, **own)
        expected = [(one.kernel, one.run_count) for one in passes]
        assert list(replayed) == expected, own
        assert len(replayed) == len(passes)
        assert replayed.optimal_count == passes.optimal_count
        assert replayed.efficiency == pytest.approx(passes.efficiency, rel=1e-12)
        assert replayed.passes == {kernel: passes.of(kernel) for kernel in walks.names}
        totals = {kernel: passes.counters.of(kernel).run_count for kernel in walks.names}
        assert replayed.runs == totals


@pytest.mark.parametrize(
    "rule", [Naive(), Threshold(0.3), MostWork(), Double()], ids=lambda rule: type(rule).__name__
)
@pytest.mark.parametrize("name", ["grid", "kdtree, restart"])
def test_the_compiled_rules_are_those_of_the_schedulers(name, rule):
    """An object that merely chooses is asked; the classes themselves are not."""

    class Asked:
        def choose(self, queues: Queues) -> int:
            return rule.choose(queues)

    compiled, asked = (replay(walks_of(name), scheduler=one) for one in (rule, Asked()))
    np.testing.assert_array_equal(compiled.kernels, asked.kernels)
    np.testing.assert_array_equal(compiled.run_counts, asked.run_counts)


def test_a_scheduler_that_chooses_wrongly_is_told():
    class First:
        def choose(self, queues: Queues) -> int:
            assert any(queues.waiting)
            return 0

    with pytest.raises(ValueError, match="chose 0, for which no ray waits"):
        replay(walks_of("grid"), scheduler=First())
    with pytest.raises(ValueError, match="threshold: expected 0 to 1"):
        replay(walks_of("grid"), threshold=2.0)
    with pytest.raises(ValueError, match="traversal_steps: expected at least 1"):
        replay(walks_of("grid"), traversal_steps=0)


def test_a_sweep_is_one_replay_for_each_threshold():
    walks = walks_of("grid")
    thresholds = [0.01, 0.1, 0.5, 0.9]
    for one, threshold in zip(sweep(walks, thresholds, intersections=2), thresholds, strict=True):
        assert list(one) == list(replay(walks, threshold=threshold, intersections=2))
    assert len(sweep(walks, [])) == 0


def test_more_passes_than_a_call_has_room_for(monkeypatch):
    walks = walks_of("grid")
    whole = list(replay(walks))
    monkeypatch.setattr("raystream_lab.walks.replaying._PASSES_PER_CALL", 7)
    assert list(replay(walks)) == whole
    monkeypatch.setattr("raystream_lab.walks.replaying._PASSES_PER_CALL", len(whole))
    assert list(replay(walks)) == whole


def test_rays_that_walk_alike_are_one():
    walks = walks_of("grid")
    distinct = walks.distinct
    assert int(distinct.weights.sum()) == len(walks)
    assert len(distinct.weights) < len(walks)

    def all_walks(splits, kernels, lengths):
        for begin, end in pairwise(splits):
            yield kernels[begin:end].tobytes() + lengths[begin:end].tobytes()

    every = list(all_walks(walks.run_splits, walks.run_kernels, walks.run_lengths))
    found = list(all_walks(*distinct[:3]))
    assert [every.count(walk) for walk in found] == distinct.weights.tolist()


def test_no_rays_take_no_passes():
    nothing = replay(record(walks_of("grid").structure, np.zeros((0, 3)), np.zeros((0, 3))))
    assert len(nothing) == nothing.optimal_count == 0
    assert np.isnan(nothing.efficiency)
