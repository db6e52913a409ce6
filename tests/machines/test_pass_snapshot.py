"""Observing a multipass machine: it sees every pass, and changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from cases import CASES
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.machines import MultipassBackend, Passes
from raystream.machines.records import RayState


@pytest.mark.parametrize("compaction", [False, True])
def test_an_observer_sees_every_pass_and_changes_nothing(compaction):
    case = CASES["random_soup"](np.random.default_rng(7))
    structure = rs.Tracer(case.scene, "kdtree").structure
    batch = RayBatch(case.origins, case.directions, case.t_min, case.t_max)
    plain, watched, shown = Passes(), Passes(), []

    def observe(now):
        numbers = now.streams["wanted"]["number"]
        states, places = now.streams["state"], now.streams["place"]
        assert len(numbers) == len(states) == len(places) <= len(batch)
        assert len(now.stacks) == len(now.tallies) == len(now.hits.t) == len(batch)
        assert places["top"].max() <= now.stacks.shape[1]
        shown.append((now.kernel, len(states), int(now.tallies.sum())))

    machine = MultipassBackend(structure, scheduler="most-work", compaction=compaction)
    answers = []
    for one in (machine.recording(plain), machine.recording(watched).observed_by(observe)):
        sink = one.answer(Query(Kind.FIRST_HIT, counters=True), batch)
        answers.append((sink.hits, sink.tallies))
    (hits, tallies), (again, counted) = answers
    assert hits.t.tobytes() == again.t.tobytes()
    assert np.array_equal(tallies, counted)
    passes = list(watched)
    assert [one.kernel for one in plain] == [one.kernel for one in passes]
    # Once before the first pass, then after each.
    kernel, count, total = shown[0]
    assert kernel is None
    assert (count, total) == (len(batch), 0)
    assert [kernel.name for kernel, _, _ in shown[1:]] == [one.kernel for one in passes]
    assert [count for _, count, _ in shown[1:]] == [one.record_count for one in passes]
    totals = [total for _, _, total in shown]
    assert totals == sorted(totals)
    assert totals[-1] == tallies.sum()
    assert (min(count for _, count, _ in shown) < len(batch)) == compaction


def test_a_machine_that_nobody_watches_shows_nothing():
    case = CASES["random_soup"](np.random.default_rng(7))
    machine = MultipassBackend(rs.Tracer(case.scene, "grid").structure)
    seen = []
    watched = machine.observed_by(lambda now: seen.append(RayState(int(now.streams["state"][0]))))
    batch = RayBatch(case.origins[:1], case.directions[:1], 0.0, np.inf)
    machine.answer(Query(Kind.FIRST_HIT), batch)
    assert not seen
    watched.answer(Query(Kind.FIRST_HIT), batch)
    assert seen[0] is RayState.STARTING
    assert seen[-1] is RayState.DONE
