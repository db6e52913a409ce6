"""Races of kernels: who wins, what is remembered, and that each ray is traced once."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.core.query import Kind
from raystream.machines import batch
from raystream.machines.batch import LEAST_RACE, race
from raystream.machines.race import Races
from raystream.structures.bvh.batches import BATCH_KERNELS

COUNT = 100_000


class FakeKernels:
    """Kernels of given speeds, on a clock of their own."""

    def __init__(self, monkeypatch, **rates):
        self.rates, self.now = rates, 0.0
        self.rays = dict.fromkeys(rates, 0)
        self.pieces = []
        monkeypatch.setattr(batch, "clock", lambda: self.now)

    def run(self, name, begin, end):
        self.now += self.rates[name] * (end - begin)
        self.rays[name] += end - begin
        self.pieces.append((begin, end))


def to_end(ray):
    return min(ray, COUNT)


def run(trace, races, names, cut=to_end, kind="kind", cold=()):
    for piece in race(races, kind, names, cold, COUNT, cut):
        trace(*piece)


@pytest.mark.parametrize(
    ("rates", "winner"),
    [
        ({"a": 1.0, "b": 3.0}, "a"),
        ({"a": 1.0, "b": 1.02}, "a"),
        ({"a": 1.02, "b": 1.0}, "a"),
        ({"a": 2.0, "b": 1.0}, "b"),
        ({"a": 2.0, "b": 1.5, "c": 1.0}, "c"),
    ],
)
def test_the_fastest_wins(monkeypatch, rates, winner):
    kernels, races = FakeKernels(monkeypatch, **rates), Races()
    run(kernels.run, races, tuple(rates))
    assert races.fastest("kind", tuple(rates)) == winner
    assert kernels.rays[winner] > 0.5 * COUNT


@pytest.mark.parametrize("disturbed", [0, 1])
def test_a_disturbance_does_not_decide(monkeypatch, disturbed):
    """One of the favourite's two pieces takes ten times as long."""
    kernels, races = FakeKernels(monkeypatch, a=1.0, b=1.5), Races()
    numbers = iter(range(100))

    def run_disturbed(name, begin, end):
        kernels.rates["a"] = 10.0 if name == "a" and next(numbers) == disturbed else 1.0
        kernels.run(name, begin, end)

    run(run_disturbed, races, ("a", "b"))
    assert races.fastest("kind", ("a", "b")) == "a"


def test_a_slow_rival_costs_little(monkeypatch):
    kernels = FakeKernels(monkeypatch, a=1.0, b=2.5)
    run(kernels.run, Races(), ("a", "b"))
    assert kernels.rays["b"] <= 0.05 * COUNT


@pytest.mark.parametrize("step", [1, 256, 16 * 1024, 40_000, COUNT])
def test_each_ray_is_traced_once(monkeypatch, step):
    def cut(ray):
        return COUNT if ray >= COUNT else ray // step * step

    kernels = FakeKernels(monkeypatch, a=1.0, b=0.5)
    run(kernels.run, Races(), ("a", "b"), cut)
    pieces = sorted(kernels.pieces)
    assert [begin for begin, _ in pieces] == [0, *(end for _, end in pieces[:-1])]
    assert pieces[-1][1] == COUNT


def test_races_become_rare():
    races = Races()
    due = [number for number in range(1, 40) if races.is_due("kind", True)]
    assert due == [1, 2, 4, 8, 16, 32]
    due = [number for number in range(1, 40) if races.is_due("other", False)]
    assert due == [4, 8, 16, 32]


def test_the_winner_is_remembered_for_its_kind_only():
    races = Races()
    races.learn("kind", {"a": 2.0, "b": 1.0})
    assert races.fastest("kind", ("a", "b")) == "b"
    assert races.fastest("other", ("a", "b")) == "a"


def test_one_race_runs_at_a_time(monkeypatch):
    """A batch that another race traces meanwhile is traced by one kernel, and not timed."""
    kernels, times, inner = FakeKernels(monkeypatch, a=1.0, b=1.0), {}, []

    def outer(name, begin, end):
        if not inner:
            run(lambda *piece: inner.append(piece), Races(times), ("a", "b"), kind="inner")
        kernels.run(name, begin, end)

    run(outer, Races(times), ("a", "b"), kind="outer")
    assert inner == [("a", 0, COUNT)]
    assert sum(kernels.rays.values()) == COUNT
    assert times["outer"].rates.keys() == {"a", "b"}
    assert not times["inner"].rates
    assert Races(times).is_due("inner", True)  # its second batch


def test_an_interrupt_teaches_nothing(monkeypatch):
    kernels, races = FakeKernels(monkeypatch, a=1.0, b=0.1), Races()

    def interrupted(name, begin, end):
        if name == "b":
            raise KeyboardInterrupt
        kernels.run(name, begin, end)

    with pytest.raises(KeyboardInterrupt):
        run(interrupted, races, ("a", "b"))
    assert races.fastest("kind", ("a", "b")) == "a"


def test_bits_do_not_depend_on_the_winner(monkeypatch, rng):
    """Each of a batch's kernels in turn seems the fastest."""
    scene = rs.load("spheres")
    origins = rng.uniform(-2, 2, (LEAST_RACE + 5000, 3)).astype(np.float32)
    directions = rng.normal(size=origins.shape).astype(np.float32)
    want = rs.Tracer(scene, kernel="single").first_hit(origins, directions)
    kernels = BATCH_KERNELS[Kind.FIRST_HIT].kernels
    trace_piece = batch._trace_piece
    for fastest in ("groups", "wavefront"):
        tracer, now, used = rs.Tracer(scene), [0.0], []

        def timed(kernel, *shared, fastest=fastest, now=now, used=used):
            trace_piece(kernel, *shared)
            *_, rays, _ = shared
            used.append(next(name for name, one in kernels.items() if one is kernel))
            now[0] += (rays[1] - rays[0]) * (1.0 if used[-1] == fastest else 1.9)

        with monkeypatch.context() as patch:
            patch.setattr(batch, "_trace_piece", timed)
            patch.setattr(batch, "_loaded", {(one.bind, False) for one in kernels.values()})
            patch.setattr(batch, "clock", lambda now=now: now[0])
            for _ in range(3):
                got = tracer.first_hit(origins, directions)
                for name in ("t", "u", "v", "prim_id"):
                    np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
        assert set(used) == {"groups", "wavefront"}


def test_a_kernel_that_must_be_loaded_is_not_timed(monkeypatch):
    """Its first piece, which loads it, does not count."""
    kernels, races = FakeKernels(monkeypatch, a=1.0, b=0.5), Races()
    loaded = set()

    def loading(name, begin, end):
        if name == "b" and name not in loaded:
            loaded.add(name)
            kernels.run(name, begin, begin + 1000 * (end - begin))
        else:
            kernels.run(name, begin, end)

    for _ in range(3):  # the first batches are not raced
        races.is_due("kind", False)
    run(loading, races, ("a", "b"), cold=["b"])
    assert races.fastest("kind", ("a", "b")) == "b"
