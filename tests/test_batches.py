"""Batches of any size, shape, layout and dtype give brute force's bits with every kernel."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import raystream as rs
from batches import BATCHES
from conftest import TRACERS, assert_same_bits, is_turn, tier
from meshes import soup
from raystream.jit.threads import parallel_for, thread_count
from test_agreement import Answers, answers_of, assert_expected

#: Tracers that read rays differently: one by one, by eights, as packets, as groups, in passes.
READERS = (
    "brute",
    "bvh",
    "bvh, wavefront",
    "bvh, packets",
    "bvh, groups",
    "bvh, single rays",
    "bvh, multipass",
)

#: All batches on all tracers: a default run has those that read rays differently with a third of
#: the batches each, CI with all of them, and some of the rest.
PAIRS = [
    pytest.param(
        name,
        tracer,
        marks=tier(
            is_everyday=tracer in READERS[:-1] and is_turn(tracer, i, 3),
            is_ci=tracer in READERS or is_turn(tracer, i, 8),
        ),
        id=f"{name}-{tracer}",
    )
    for i, name in enumerate(BATCHES)
    for tracer in TRACERS
]

KERNELS = ("auto", "wavefront", "packet", "groups", "single")


@cache
def expected_of(name: str) -> Answers:
    """Brute force's answers, once for all that are compared with them."""
    vertices, faces, rays = BATCHES[name](np.random.default_rng(2013))
    return answers_of(rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute"), rays)


@pytest.mark.parametrize(("name", "make_tracer"), PAIRS, indirect=["make_tracer"])
def test_awkward_batches(make_tracer, name, rng):
    vertices, faces, rays = BATCHES[name](rng)
    tracer = make_tracer(rs.Scene.from_arrays(vertices, faces))
    # All options in passes are compared in test_agreement; here it is how rays are read.
    answers = answers_of(tracer, rays, is_brief=tracer.machine == "multipass")
    assert_expected(answers, expected_of(name))


@pytest.mark.parametrize("name", BATCHES)
def test_the_caller_s_arrays_are_left_alone(name, rng):
    vertices, faces, rays = BATCHES[name](rng)
    copies = {name: np.array(array) for name, array in rays.items()}
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    tracer.first_hit(**rays)
    tracer.any_hit(**rays)
    for key, array in rays.items():
        assert_same_bits(array, copies[key])


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_hundred_thousand_coplanar_layers(kernel):
    """All at the same t: the lowest prim_id wins, and all hits come in its order."""
    count = 100_000
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.broadcast_to([0, 1, 2], (count, 3))
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), kernel=kernel)
    origins = np.float32([[0.25, 0.25, 2], [0.5, 0.5, 1], [0.7, 0.7, 1]])
    directions = np.float32([[0, 0, -1], [0, 0, -2], [0, 0, -1]])
    hits = tracer.first_hit(origins, directions)
    assert hits.t.tolist() == [2.0, 0.5, np.inf]
    assert hits.prim_id.tolist() == [0, 0, -1]
    assert tracer.any_hit(origins, directions).tolist() == [True, True, False]
    assert tracer.count_hits(origins, directions).tolist() == [count, count, 0]
    many = tracer.multi_hit(origins, directions)
    assert many.ray_splits.tolist() == [0, count, 2 * count, 2 * count]
    np.testing.assert_array_equal(many.prim_id, np.tile(np.arange(count), 2))
    assert tracer.multi_hit(origins, directions, max_hits=3).prim_id.tolist() == [0, 1, 2] * 2


@pytest.mark.ci
@pytest.mark.slow
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_million_hits_on_one_ray(kernel, rng):
    """A stack of triangles in random order; the answer is known."""
    count = 1_000_000
    place = rng.permutation(count)
    corners = np.empty((count, 3, 3), np.float32)
    corners[:, :, :2] = [[-1e5, -1e5], [3e5, -1e5], [-1e5, 3e5]]
    corners[:, :, 2] = place[:, None]
    scene = rs.Scene.from_arrays(
        corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    )
    tracer = rs.Tracer(scene, kernel=kernel)
    ray = [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]
    order = np.argsort(place)
    many = tracer.multi_hit(*ray)
    np.testing.assert_array_equal(many.t, np.arange(1, count + 1, dtype=np.float32))
    np.testing.assert_array_equal(many.prim_id, order)
    assert tracer.count_hits(*ray) == count
    assert tracer.first_hit(*ray).prim_id == order[0]
    assert tracer.first_hit(*ray, t_min=500_000.5).prim_id == order[500_000]
    assert tracer.any_hit(*ray, t_min=999_999.5)
    assert not tracer.any_hit(*ray, t_min=1_000_000.5)
    few = tracer.multi_hit(*ray, t_min=1000, max_hits=5)
    np.testing.assert_array_equal(few.prim_id, order[999:1004])


def test_large_batches_are_shared_by_the_threads(make_tracer, rng):
    """Of each kernel's own pieces, and with a progress callback."""
    scene = rs.Scene.from_arrays(*soup(40, 1))
    tracer, oracle = make_tracer(scene), rs.Tracer(scene, "brute")
    origins = rng.random((20_011, 3), np.float32) * 3 - 1
    rays = {"origins": origins, "directions": rng.random((20_011, 3), np.float32) - origins}
    seen = []
    hits = tracer.first_hit(**rays, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (20_011, 20_011)
    assert seen == sorted(seen)
    expected = oracle.first_hit(**rays)
    for column in ("t", "u", "v", "prim_id", "status"):
        assert_same_bits(getattr(hits, column), getattr(expected, column))
    assert_same_bits(tracer.any_hit(**rays), oracle.any_hit(**rays))
    try:
        rs.set_thread_count(5)
        assert_same_bits(tracer.first_hit(**rays).u, expected.u)
    finally:
        rs.set_thread_count(None)


@pytest.mark.parametrize("make_tracer", READERS, indirect=True)
def test_batches_in_a_loop_that_keeps_all_threads_busy(make_tracer):
    """As an image's bands are: each batch then has one thread for many pieces of work."""
    tracer = make_tracer(rs.Scene.from_arrays(*soup(40, 1)))
    side = 40 if tracer.machine == "multipass" else 160
    x, y = np.meshgrid(np.linspace(-0.2, 1.2, side), np.linspace(-0.2, 1.2, side))
    directions = np.stack([x - 0.4, y - 0.6, np.full_like(x, 3.0)], axis=-1).astype(np.float32)
    rays = {"origins": np.array([0.4, 0.6, -3.0], np.float32), "directions": directions}
    expected = answers_of(tracer, rays, is_brief=True)
    found = []

    def body(begin, end):
        if begin < end:
            found.append(answers_of(tracer, rays, is_brief=True))

    parallel_for(body, thread_count(), 1)
    assert len(found) == thread_count()
    for answers in found:
        assert_expected(answers, expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_limit_of_minus_zero_is_zero(make_tracer_anywhere, dtype):
    scene = rs.Scene.from_arrays([[0, 0, 0], [0, 1, 0], [1, 0, 0]], [[0, 1, 2]])
    tracer = make_tracer_anywhere(scene)
    origins, directions = np.zeros((40, 3), dtype), np.tile(np.array([0, 0, 1], dtype), (40, 1))
    for limits in ({"t_max": -0.0}, {"t_min": -0.0}, {"t_min": -0.0, "t_max": -0.0}):
        assert (tracer.first_hit(origins, directions, **limits).t == 0.0).all()
        assert tracer.any_hit(origins, directions, **limits).all()
        assert (tracer.count_hits(origins, directions, **limits) == 1).all()
        assert (tracer.multi_hit(origins, directions, **limits).counts == 1).all()
        assert tracer.multi_hit(origins, directions, **limits, max_hits=1).t.tolist() == [0.0] * 40
