"""The multipass machine on CUDA: the passes of the CPU's, and the same hits."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import CUDA_TRACERS, assert_same_bits
from raystream.cuda.multipass import loops
from raystream.cuda.multipass.control import (
    begin_control,
    read_active,
    read_passes,
    rules_of,
)
from raystream.cuda.multipass.kernels.choose import decide
from raystream.cuda.multipass.precompile import multipass_kernels
from raystream.jit.cuda import CAPABILITIES, CudaError, is_simulated
from raystream.jit.cuda.arguments import flat
from raystream.kernels.tally import COLUMNS
from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS, Queues, make_scheduler
from raystream.machines.steps import steps_of
from raystream.structures import build_structure, names_with
from test_agreement import case_of

_AT = np.uint64(0)

#: Scheduler, steps and intersections in a pass, compaction, and loop.
WAYS = [
    ("threshold", 1, 1, False, "batches"),
    ("naive", 2, 3, True, "batches"),
    ("double", 4, 2, True, "graph"),
    ("most-work", 1, 1, False, "graph"),
]


QUERIES = {
    "first hits": lambda tracer, rays: tracer.first_hit(**rays),
    "any hits": lambda tracer, rays: tracer.any_hit(**rays),
    "counts": lambda tracer, rays: tracer.count_hits(**rays),
    "all hits": lambda tracer, rays: tracer.multi_hit(**rays, crossings="surfaces"),
    "three hits": lambda tracer, rays: tracer.multi_hit(**rays, max_hits=3),
}


def scene_and_rays(name, count=12):
    """A scene of `cases`, and a few of its rays where CUDA is simulated."""
    case = case_of(name)
    most = len(case.origins)
    rows = np.linspace(0, most - 1, count if is_simulated() else most).astype(int)
    return case.scene, {"origins": case.origins[rows], "directions": case.directions[rows]}


def assert_same_results(a, b):
    if isinstance(a, np.ndarray):
        assert_same_bits(a, b)
        return
    for column in ("t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(a, column), getattr(b, column))


def tracers_of(scene, options, way):
    """The machine on both devices."""
    scheduler, steps, tests, compaction, loop = way
    shared = {
        **options,
        "machine": "multipass",
        "scheduler": scheduler,
        "traversal_steps": steps,
        "intersections": tests,
        "compaction": compaction,
        "counters": True,
    }
    return rs.Tracer(scene, **shared, loop=loop), rs.Tracer(scene, **{**shared, "device": "cpu"})


def assert_same_passes(ours, theirs):
    """Kernel, rays and words of every pass, the bound, and each ray's tallies."""
    assert list(ours.counters.passes) == list(theirs.counters.passes)
    assert ours.counters.passes.optimal_count == theirs.counters.passes.optimal_count
    assert ours.counters.passes.most_runs == theirs.counters.passes.most_runs
    for column in COLUMNS:
        assert_same_bits(getattr(ours.counters, column), getattr(theirs.counters, column))


STEPPED = {name: one for name, one in CUDA_TRACERS.items() if "multipass" not in name}


#: The simulator's cases in a default run: each of WAYS once. Others take it up to a minute.
FEW_STEPPED = ("brute", "bvh", "grid", "grid, two levels")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=[pytest.mark.exhaustive] * (is_simulated() and name not in FEW_STEPPED)
        )
        for name in STEPPED
    ],
)
def test_passes_are_those_of_the_cpu(gpu, name):
    scene, rays = scene_and_rays("closed_mesh")
    way = WAYS[list(STEPPED).index(name) % len(WAYS)]
    ours, theirs = tracers_of(scene, STEPPED[name], way)
    for query in QUERIES.values():
        assert_same_results(query(ours, rays), query(theirs, rays))
        assert_same_passes(ours, theirs)


@pytest.mark.parametrize("loop", loops.LOOPS)
def test_rays_are_dropped_in_their_order(gpu, monkeypatch, loop):
    """The host checks after each pass, and some rays want no hits."""
    scene, rays = scene_and_rays("random_soup", 40)
    monkeypatch.setattr(loops, "_FIRST_PASSES", 1)
    monkeypatch.setattr(loops, "_MOST_AT_ONCE", 1)
    way = ("threshold", 1, 1, True, loop)
    ours, theirs = tracers_of(scene, STEPPED["kdtree, stack"], way)
    for query in ("first hits", "all hits"):
        assert_same_results(QUERIES[query](ours, rays), QUERIES[query](theirs, rays))
        assert_same_passes(ours, theirs)
    lengths = {one.record_count for one in ours.counters.passes}
    assert len(lengths) > 3


def test_rays_are_traced_in_parts(gpu):
    scene, rays = scene_and_rays("closed_mesh")
    count, options = len(rays["origins"]), {"machine": "multipass", "counters": True}
    whole = rs.Tracer(scene, "kdtree", "cuda", **options)
    parts = rs.Tracer(scene, "kdtree", "cuda", **options, rays_at_once=count // 3)
    done = []
    for tracer, progress in ((whole, None), (parts, lambda *k: done.append(k))):
        tracer.multi_hit(**rays, progress=progress)
    assert len(parts.counters.passes) > len(whole.counters.passes)
    for column in COLUMNS:
        assert_same_bits(getattr(parts.counters, column), getattr(whole.counters, column))
    assert done == sorted(done)
    assert done[-1] == (2 * count, 2 * count)


@pytest.mark.parametrize("loop", loops.LOOPS)
def test_too_many_passes_are_an_error(gpu, loop):
    scene, rays = scene_and_rays("closed_mesh")
    options = {"machine": "multipass", "counters": True, "loop": loop}
    tracer = rs.Tracer(scene, "kdtree", "cuda", **options)
    tracer.any_hit(**rays)
    enough = len(tracer.counters.passes)
    rs.Tracer(scene, "kdtree", "cuda", **options, max_passes=enough).any_hit(**rays)
    short = rs.Tracer(scene, "kdtree", "cuda", **options, max_passes=enough - 1)
    with pytest.raises(CudaError, match=rf"after {enough - 1} passes; max_passes is {enough - 1}"):
        short.any_hit(**rays)


def test_options_are_checked(gpu):
    scene = rs.load("cornell")
    for options, error, text in (
        ({"scheduler": "optimal"}, ValueError, "is a bound"),
        ({"scheduler": make_scheduler("naive")}, TypeError, "needs device='cpu'"),
        ({"threshold": 2.0}, ValueError, "0 to 1"),
        ({"traversal_steps": 0}, ValueError, "at least 1"),
        ({"max_passes": 0}, ValueError, "at least 1"),
        ({"loop": "queries"}, ValueError, "'graph', 'batches'"),
        ({"machine": "branching", "loop": "graph"}, TypeError, "machine='multipass'"),
    ):
        with pytest.raises(error, match=text):
            rs.Tracer(scene, "grid", "cuda", **{"machine": "multipass", **options})


@pytest.mark.parametrize("name", SCHEDULERS)
def test_the_device_chooses_as_schedulers_do(name, rng):
    kernels = steps_of(build_structure("kdtree", rs.load("cornell").triangles)).kernels
    scheduler, latest = make_scheduler(name, 0.3), None
    words = begin_control(kernels, 0)
    at, rules = np.uint64(words.ctypes.data), rules_of(kernels, name, 0.3, False)
    for known in range(300):
        waiting = rng.integers(0, 4, len(kernels)) * rng.integers(0, 2, len(kernels))
        waiting[rng.integers(len(kernels))] += 1
        words[8:24] = 0
        words[[8 + int(one.state) for one in kernels]] = waiting
        decide(_AT, at, rules)
        latest = scheduler.choose(Queues(kernels, waiting.tolist(), latest))
        (ran,) = read_passes(words, known)
        assert (ran.kernel, ran.run_count) == (latest, waiting[latest])
        assert read_active(words) == waiting.sum()
    words[8:24] = 0
    words[8 + int(RayState.DONE)] = 5
    decide(_AT, at, rules)
    assert not read_passes(words, known + 1)


def check(kernel, arguments):
    """Compile a kernel, and inspect the result."""
    compiled = kernel.compiled(arguments, CAPABILITIES[0])
    head = compiled.ptx[compiled.ptx.index(f".visible .entry {compiled.entry}") :]
    assert head[: head.index("{")].count(".param .") == 1 + len(list(flat(arguments)))
    assert "fma.rn.f64" not in compiled.ptx
    return compiled


#: The rest is for .ci/nightly: each takes as long as all kernels of the branching machine.
_USUAL = [
    pytest.param(name, marks=[pytest.mark.exhaustive] * (name != "brute"))
    for name in names_with("multipass")
]


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
@pytest.mark.parametrize("name", _USUAL)
def test_passes_compile_without_a_device(name):
    catalogue = multipass_kernels(name, rs.load("cornell"))
    for kernel in ("pass", "counting pass"):
        assert "match.any.sync" in check(*catalogue[kernel]).ptx


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param("begin", marks=pytest.mark.exhaustive),  # as long as all of the others
        *("decide", "finish", "finish many", "count kept", "keep"),
    ],
)
def test_what_surrounds_passes_compiles_without_a_device(name):
    check(*multipass_kernels("kdtree", rs.load("cornell"))[name])


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
def test_loops_of_the_device_link_without_one():
    from cuda.core import ObjectCode

    from raystream.jit.cuda.compiler import SET_CONDITION, link

    loop = check(*multipass_kernels("kdtree", rs.load("cornell"))["decide in loop"])
    assert SET_CONDITION in loop.ptx
    linked = link(ObjectCode.from_ptx(loop.ptx.encode(), name=loop.entry), CAPABILITIES[0])
    assert linked.code_type == "cubin"
    assert loop.entry.encode() in linked.code
