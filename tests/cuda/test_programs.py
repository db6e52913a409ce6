"""Programs and filters at hits on CUDA give the CPU's results bit for bit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import CUDA_TRACERS, assert_same_bits
from programs.layers import layers_rays, layers_scene
from raystream.cuda.programs import rounds
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.jit.cuda import is_simulated
from raystream.jit.cuda.arguments import kind_of
from raystream.programs import Bound
from raystream.programs.program import Program

RECORD = np.dtype([("hits", "i4"), ("depth", "f8"), ("ids", "i8")])
NESTED = np.dtype([("flag", "i1"), ("at", "f4", (3,)), ("last", [("t", "f8"), ("mesh", "i2")])])


def fold(hit, payload):
    """It depends on the order, and ends at its tenth hit."""
    payload.hits += 1
    payload.depth += hit.t * payload.hits
    payload.ids = 7 * payload.ids + hit.prim_id
    return rs.Decision.STOP if payload.hits == 10 else rs.Decision.CONTINUE


def nest(hit, payload):
    payload.flag += 1
    payload.at[hit.prim_id % 3] += hit.u
    payload.last.t = hit.t
    payload.last.mesh = hit.mesh_id


def add_up(hit, payload):
    payload[0] = 3 * payload[0] + hit.prim_id


def of_two(hit, payload):
    if hit.is_entering:
        payload[0] += hit.t + hit.ray
    else:
        payload[1] = max(payload[1], hit.t)


def turn(hit, payload):
    payload[0] = payload[0] * 1j + hit.t


def look(hit, payload):
    return rs.Decision.STOP if hit.prim_id == 7 else rs.Decision.IGNORE


def one_in_five(hit):
    return hit.prim_id % 5 == 0


def until_one_in_five(hit):
    return rs.Decision.STOP if hit.prim_id % 5 == 0 else rs.Decision.IGNORE


def is_other(hit, constants):
    return hit.mesh_id != constants[0] and hit.t < constants[1][0]


def wave(hit):
    return math.sin(hit.t) > 0.0


def sines(hit, payload):
    payload[0] += math.sin(hit.t)


def fail(hit):
    if hit.prim_id == 7:
        raise ValueError("seven")
    return True


@pytest.fixture(params=["all hits at once", "a few hits at a time"])
def is_tight(request, monkeypatch):
    """Whether rays have room for one hit at first, and there are few rows."""
    is_tight = request.param == "a few hits at a time"
    monkeypatch.setattr(rounds, "FIRST_ROOM", 1 if is_tight else 1000)
    if is_tight:
        monkeypatch.setattr(rounds, "HITS_AT_ONCE", 60)
    return is_tight


@pytest.fixture
def rays():
    """Few rays, each with many hits at few t; one is invalid."""
    origins, directions = layers_rays(5, 4)
    return {"origins": origins, "directions": directions}


def tracers_of(name, **more):
    """One on the device, and the same on the CPU."""
    options, scene = CUDA_TRACERS[name], layers_scene()
    return rs.Tracer(scene, **options, **more), rs.Tracer(scene, **{**options, "device": "cpu"})


@pytest.fixture
def tracers(is_tight, gpu):
    """One on the device, and one on the CPU; rays may be traced in parts."""
    return tracers_of("bvh", rays_at_once=13) if is_tight else tracers_of("brute")


@pytest.fixture
def both(tracers, monkeypatch):
    """Query both tracers; the one on the device may not run anything on the CPU."""

    def ask(query):
        theirs = query(tracers[1])
        with monkeypatch.context() as patch:
            patch.setattr(Program, "run", None)
            ours = query(tracers[0])
        return ours, theirs

    return ask


def assert_same_hits(ours, theirs):
    for name in ("t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(ours, name), getattr(theirs, name))


def ask_all(tracer, rays, **arguments):
    """All queries."""
    return (
        tracer.first_hit(**rays, **arguments),
        tracer.any_hit(**rays, **arguments),
        tracer.count_hits(**rays, **arguments),
        tracer.multi_hit(**rays, **arguments),
        tracer.multi_hit(**rays, **arguments, max_hits=3, crossings="surfaces"),
    )


def assert_same_answers(ours, theirs):
    assert_same_hits(ours[0], theirs[0])
    assert_same_bits(ours[1], theirs[1])
    assert_same_bits(ours[2], theirs[2])
    for many, other in zip(ours[3:], theirs[3:], strict=True):
        assert_same_bits(many.ray_splits, other.ray_splits)
        assert_same_hits(many, other)


def test_programs_run_at_all_hits_in_order(both, rays):
    ours, theirs = both(lambda tracer: tracer.trace(**rays, on_hit=fold, payload=RECORD))
    assert ours.dtype == theirs.dtype
    assert ours.tobytes() == theirs.tobytes()
    assert ours["hits"].max() == 10


@pytest.mark.parametrize(
    ("function", "payload"),
    [(nest, NESTED), (add_up, np.int64), (turn, np.complex64), (look, None)],
)
def test_payloads_of_every_kind(both, rays, function, payload):
    ours, theirs = both(lambda tracer: tracer.trace(**rays, on_hit=function, payload=payload))
    if payload is None:
        assert ours is None
    else:
        assert ours.tobytes() == theirs.tobytes()
        assert any(ours.tobytes())


def test_a_payload_of_the_callers_is_changed_in_place(both, rays):
    payloads = []

    def run(tracer):
        payload = np.full((2, 5, 4), np.nan, np.float32).T  # scattered; a NaN is not a number
        payload[::2, :, 1] = 2.5
        payload[..., 0] = 1.0
        payloads.append(payload)
        return tracer.trace(**rays, on_hit=of_two, payload=payload)

    ours, theirs = both(run)
    assert ours is payloads[1]
    assert_same_bits(ours, theirs)


@pytest.mark.parametrize("on_hit", [one_in_five, until_one_in_five])
def test_filters_hide_hits_from_every_query(both, rays, on_hit):
    ours, theirs = both(lambda tracer: ask_all(tracer, rays, on_hit=on_hit))
    assert_same_answers(ours, theirs)
    seen = ours[1]
    assert 0 < seen.sum() < seen.size
    assert (ours[0].prim_id[seen] % 5 == 0).all()


def test_triangles_are_skipped(tracers, both, rays):
    many = tracers[1].multi_hit(**rays)
    skipped = np.full((*many.status.shape, 4), -1)
    for ray, begin in enumerate(many.ray_splits[:-1]):  # the nearest, the third and the last
        own = many.prim_id[begin : many.ray_splits[ray + 1]][[0, 2, -1][: many.counts.flat[ray]]]
        skipped.reshape(-1, 4)[ray, : len(own)] = own
    ours, theirs = both(
        lambda tracer: ask_all(tracer, rays, skip_prim_ids=skipped, on_hit=one_in_five)
    )
    assert_same_answers(ours, theirs)
    nearest = skipped[..., 0]
    ours, theirs = both(lambda tracer: tracer.first_hit(**rays, skip_prim_ids=nearest))
    assert_same_hits(ours, theirs)
    assert (ours.prim_id != nearest)[many.counts > 0].all()


def test_kernels_get_arguments_of_the_types_that_were_checked(tracers, both, rays, monkeypatch):
    given, plain = [], DeviceProgram.arguments

    def arguments(self, *rest):
        given.append((self, plain(self, *rest)))
        return given[-1][1]

    monkeypatch.setattr(DeviceProgram, "arguments", arguments)
    both(lambda tracer: tracer.trace(**rays, on_hit=fold, payload=RECORD))
    both(
        lambda tracer: ask_all(
            tracer, rays, on_hit=one_in_five, skip_prim_ids=-np.ones((4, 5), int)
        )
    )
    bound = Bound(is_other, (2, (20.5, 1)))
    both(lambda tracer: tracer.first_hit(**rays, on_hit=bound))
    for program, own in given.copy():
        assert kind_of(own) == kind_of(program.typical())


#: The rest is for .ci/nightly: their traversals take long to compile.
USUAL = ("brute", "bvh", "kdtree, stack")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(one, marks=[pytest.mark.exhaustive] * (one not in USUAL))
        for one in CUDA_TRACERS
    ],
)
def test_every_structure_runs_them(gpu, rays, name):
    tracers = tracers_of(name)
    rays = {key: array[:2] for key, array in rays.items()}
    ours, theirs = (tracer.multi_hit(**rays, on_hit=one_in_five, max_hits=3) for tracer in tracers)
    assert_same_bits(ours.ray_splits, theirs.ray_splits)
    assert_same_hits(ours, theirs)
    ours, theirs = (tracer.trace(**rays, on_hit=fold, payload=RECORD) for tracer in tracers)
    assert ours.tobytes() == theirs.tobytes()


def test_constants_that_are_addresses_stay_with_the_processor(tracers, both, rays):
    bound = Bound(is_other, (2, (20.5, 1)))
    ours, theirs = both(lambda tracer: tracer.first_hit(**rays, on_hit=bound))
    assert_same_hits(ours, theirs)
    kept = bound._replace(kept=np.zeros(1))
    assert_same_hits(tracers[0].first_hit(**rays, on_hit=kept), theirs)


def test_what_raises_stays_with_the_processor(gpu, rays):
    tracer = rs.Tracer(layers_scene(), "brute", "cuda")
    with pytest.raises(RuntimeError, match=r"^fail: raised ValueError: seven$"):
        tracer.count_hits(**rays, on_hit=fail)
    there = {name: gpu.upload(name, array) for name, array in rays.items()}
    with pytest.raises(TypeError, match=r"^fail: cannot run on the GPU.*may raise an exception"):
        tracer.count_hits(**there, on_hit=fail)


def test_what_the_device_cannot_do_stays_with_the_processor(gpu, rays, monkeypatch):
    if is_simulated():  # which supports whatever the CPU supports
        monkeypatch.setattr(DeviceProgram, "reason_against", lambda *_: "it calls sinf")
    tracers = tracers_of("brute")
    assert_same_answers(*(ask_all(tracer, rays, on_hit=wave) for tracer in tracers))
    ours, theirs = (tracer.trace(**rays, on_hit=sines, payload=float) for tracer in tracers)
    assert_same_bits(ours, theirs)
    assert ours.any()


def test_a_counting_tracer_runs_no_programs(gpu):
    tracer = rs.Tracer(layers_scene(), "brute", "cuda", counters=True)
    with pytest.raises(ValueError, match="counters=True"):
        tracer.first_hit([0.5, 0.5, -1.0], [0.0, 0.0, 1.0], on_hit=one_in_five)
