"""Words and instructions of our kernels, and the searches in which they are measured."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from conftest import TRACERS, assert_same_bits
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.hits import Sink
from raystream.machines import Branching
from raystream.machines.steps import steps_of
from raystream.streams import Counters
from raystream_lab import timing
from raystream_lab.kernels.bandwidth import copy_bandwidth, kernel_speeds, measure_speed
from raystream_lab.kernels.costs import cost_of, stream_words, words_fetched, words_of
from raystream_lab.kernels.fetch_only import FETCH_ONLY, fetch_only
from raystream_lab.kernels.instructions import count_instructions
from raystream_lab.kernels.memory_accesses import accesses
from raystream_lab.kernels.recirculation import (
    PassTime,
    Recirculation,
    by_occupancy,
    measure_recirculation,
)
from raystream_lab.kernels.record_code import compile_steps
from raystream_lab.kernels.snapshots import (
    Search,
    busiest,
    in_local_frame,
    local_rays,
    snapshots,
)

#: Each recompiles its kernels: inspected code is not cached on disk.
#: That of the graph takes them as long as all of the others.
NAMES = ["grid", "kdtree, Foley's", pytest.param("graph", marks=pytest.mark.exhaustive)]
BACKTRACK = "kdtree, Foley's"


def make(name, size=16):
    scene = rs.load("cornell")
    structure = rs.Tracer(scene, **TRACERS[name]).structure
    return structure, local_rays(structure, *scene.camera_for(1.0).rays(size, size))


def number_of(steps, kernel):
    return [one.name for one in steps.kernels].index(kernel)


@pytest.mark.parametrize("name", NAMES)
def test_words_are_those_that_passes_count(name):
    structure, rays = make(name)
    counters = Counters()
    search = Search(structure, rays)
    search.run(counters)
    steps = search.steps
    for one in counters.passes:
        words_in, words_out = words_of(steps, number_of(steps, one.kernel))
        read = {key: words * one.run_count for key, words in words_in.items()}
        written = {key: words * one.run_count for key, words in words_out.items()}
        assert one.words_read == {**read, "state": one.record_count}
        assert one.words_written == {**written, "state": one.run_count}


@pytest.mark.parametrize("name", ["bvh", "grid", BACKTRACK])
def test_a_search_finds_what_the_structure_finds(name):
    structure, rays = make(name)
    query = Query(Kind.FIRST_HIT)
    sink = Sink.of(query, len(rays.t_min))
    Branching(in_local_frame(structure)).run(query, RayBatch(*rays), sink)
    expected = sink.hits
    search = Search(structure, rays, "double", compaction=True)
    assert search.run() > 2
    hit = expected.prim_id >= 0
    assert_same_bits(search.hits.prim_id, expected.prim_id)
    assert_same_bits(search.hits.t, expected.t)
    assert_same_bits(search.hits.u[hit], expected.u[hit])


#: Words that each kernel needs of the structure: a reference and a triangle; where a cell's list
#: begins and ends; a split; a link, and the box's planes that the ray goes towards.
NEEDED = {
    ("brute", "brute", "intersect"): 10,
    ("grid", "grid", "traverse"): 2,
    (BACKTRACK, "kdtree", "down"): 3,
    (BACKTRACK, "kdtree", "up"): 4,
}


@pytest.mark.parametrize(
    ("name", "structure", "kernel"),
    [
        pytest.param(*one, marks=[pytest.mark.exhaustive] * (one[0] == "grid"))  # seconds
        for one in NEEDED
    ],
)
def test_fetch_only_versions_fetch_the_same(name, structure, kernel):
    steps = steps_of(make(name)[0])
    number = number_of(steps, kernel)
    only = compile_steps(fetch_only(structure, steps, number), number, is_in_place=False)
    found = accesses(only.code.instructions)
    words = sum(one.words for one in words_fetched(only, found).values())
    assert words == NEEDED[name, structure, kernel]
    if structure != "kdtree":  # the others' kernels take up to ten seconds to compile
        return
    full = compile_steps(steps, number, is_in_place=False)
    expected = accesses(full.code.instructions)
    assert words_fetched(only, found) == words_fetched(full, expected)
    for opcode in ("load", "store"):
        assert stream_words(only, found, opcode) == stream_words(full, expected, opcode)
    counts = count_instructions(only.code.instructions), count_instructions(full.code.instructions)
    assert counts[0].total < counts[1].total


def test_cost_of_a_kernel():
    """The same each time; no word is read that is not in a record, and nothing is counted."""
    structure, _ = make(BACKTRACK)
    steps = steps_of(structure)
    costs = [cost_of(steps, number_of(steps, "leaf")) for _ in range(2)]
    cost = costs[0]
    assert cost == costs[1]
    assert cost.loop is None
    assert cost.words_in == {"wanted": 5, "place": 8}
    assert cost.words_out == {"place": 8}
    assert cost.fetched["tree.leaves"] == (2, 2, 2)
    assert (cost.fetched_words, cost.dependent_loads) == (2, 2)
    assert cost.code.total > cost.code.loads >= 3
    assert cost.machine > 0
    assert cost.code.calls == 0


def test_a_snapshot_does_what_its_pass_does():
    """The kernel on the rays of its busiest pass writes what the machine writes in that pass."""
    structure, rays = make(BACKTRACK)
    passes = busiest(Search(structure, rays), ["down"])
    taken = snapshots(Search(structure, rays), passes)["down"]
    search = Search(structure, rays)
    for number, (kernel, _) in enumerate(search.schedule()):
        if number == passes["down"]:
            break
        search.streams.run(kernel, None)
    streams = {name: stream.array for name, stream in search.streams.streams.items()}
    chosen = streams["state"] == np.uint8(search.steps.kernels[kernel].state)
    assert len(taken) == np.count_nonzero(chosen) > 1
    before = {name: array.copy() for name, array in taken.arrays.items()}
    made, written = taken.kernel()
    search.streams.run(kernel, None)
    for _ in range(2):
        assert made.execute() == len(taken)
        for name in ("place", "state"):
            assert_same_bits(written[name].array, streams[name][chosen])
    for name, array in taken.arrays.items():
        assert_same_bits(array, before[name])
    speed = measure_speed("kdtree", taken, runs=3)
    assert speed.ray_count == len(taken)
    assert (speed.words_in, speed.words_fetched, speed.words_out) == (11, 3, 9)
    assert speed.byte_count == 4 * len(taken) * 23
    assert speed.seconds.shape == speed.fetch_seconds.shape == (3,)
    assert speed.is_bandwidth_bound(slack=np.inf)


@pytest.mark.parametrize("name", ["bvh", "grid, two levels"])
def test_structures_without_key_kernels(name):
    with pytest.raises(ValueError, match="key kernels"):
        kernel_speeds(*make(name, 2), runs=1)


def test_key_kernels_are_kernels():
    for name, kernel in FETCH_ONLY:
        structure = next(one for key, one in TRACERS.items() if one["structure"] == name)
        steps = steps_of(rs.Tracer(rs.load("cornell"), **structure).structure)
        assert kernel in [one.name for one in steps.kernels]


@pytest.mark.parametrize("compaction", [False, True])
def test_recirculation(compaction):
    structure, rays = make("grid")
    result = measure_recirculation(structure, rays, compaction=compaction)
    counters = Counters()
    Search(structure, rays).run(counters)
    names = {one.kernel for one in result.passes}
    for name in names - {"shade"}:  # some rays are shaded before they are dropped
        runs = sum(one.run_count for one in result.passes if one.kernel == name)
        assert runs == counters.of(name).run_count
    assert all(0 < one.run_count <= one.record_count for one in result.passes)
    assert set(result.idle_seconds) == names - {"set up"} | {"shade"}
    bins = by_occupancy(result.passes)
    assert sum(one.run_count for one in bins) == result.step_count
    assert sum(one.seconds for one in bins) == pytest.approx(result.multipass_seconds)
    if not compaction:
        assert {one.record_count for one in result.passes} == {len(rays.t_min)}


def test_cost_of_idle_lanes():
    """Passes of which the times are given: half of the time goes to those that are not full."""
    passes = [
        PassTime("a", 100, 100, 1.0),
        PassTime("a", 50, 100, 0.5),
        PassTime("a", 10, 100, 1.1),
        PassTime("b", 40, 100, 0.4),
        PassTime("b", 10, 100, 1.0),
    ]
    result = Recirculation(passes, {"b": 0.001}, 2.1)
    assert (result.step_count, result.efficiency) == (210, pytest.approx(0.42))
    assert result.sparse_share == pytest.approx(1.0 - (1.6 + 0.5) / 4.0)
    assert result.idle_share == pytest.approx((60 + 90) * 0.001 / 4.0)
    assert result.branching_seconds_per_step == pytest.approx(0.01)
    assert [one.run_count for one in by_occupancy(passes, (0.0, 0.1, 0.5, 1.0))] == [0, 60, 150]


def test_a_bvh_is_rejected():
    with pytest.raises(ValueError, match="many rays at once"):
        measure_recirculation(*make("bvh", 2))


def test_the_bandwidth_of_copying_counts_bytes_read_and_written(monkeypatch):
    """The times are given: their median counts."""
    times = iter([0.5, 4.0, 2.0])
    monkeypatch.setattr(timing, "seconds_of", lambda call: (call(), next(times))[1])
    assert copy_bandwidth(1 << 12, runs=3) == 2 * (1 << 12) / 2.0
