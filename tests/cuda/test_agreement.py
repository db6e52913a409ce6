"""Every structure on CUDA, in every query, has brute force's bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
import test_float64 as float64
from cases import CASES
from conftest import CUDA_TRACERS, FLOAT64, FLOAT64_CUDA_TRACERS, GPU_TRACERS, assert_same_bits
from meshes import icosphere
from raystream.jit.cuda import is_simulated
from test_agreement import answers_of, assert_expected, case_of, rays_of

#: The simulator takes a tenth of a millisecond to begin a thread.
SIMULATED_RAYS = 24


def few_of(case):
    """Some rays of a case, spread over all of them; all, on a GPU."""
    if not is_simulated():
        return case
    rows = np.linspace(0, len(case.origins) - 1, SIMULATED_RAYS).astype(int)
    t_min, t_max = (limit[rows] for limit in case.limits())
    return replace(
        case,
        origins=case.origins[rows],
        directions=case.directions[rows],
        t_min=t_min,
        t_max=t_max,
    )


#: Those that are tried here.
TRACERS = CUDA_TRACERS | ({} if is_simulated() else GPU_TRACERS)


#: The simulator takes half a second for each. In a default run every tracer has five cases or six,
#: and every case three tracers or four; in .ci/nightly each has all.
PAIRS = [
    pytest.param(
        tracer, name, marks=[pytest.mark.exhaustive] * (is_simulated() and (i + k) % 4 > 0)
    )
    for i, tracer in enumerate(TRACERS)
    for k, name in enumerate(CASES)
]


@pytest.mark.parametrize(("tracer", "name"), PAIRS)
def test_structures_equal_brute_force(gpu, tracer, name):
    case = few_of(case_of(name))
    made = rs.Tracer(case.scene, **TRACERS[tracer])
    answers = answers_of(made, rays_of(case), is_brief=is_simulated())
    assert_expected(answers, answers_of(rs.Tracer(case.scene, "brute"), rays_of(case)))


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.exhaustive] * (one != "random_soup")) for one in CASES],
)
def test_the_cpus_layout_equals_brute_force(gpu, monkeypatch, name):
    """That of counters and closest points, here for all queries."""
    monkeypatch.setattr("raystream.cuda.structures.layout_of", lambda _: None)
    case = few_of(case_of(name))
    answers = answers_of(
        rs.Tracer(case.scene, "bvh", "cuda"), rays_of(case), is_brief=is_simulated()
    )
    assert_expected(answers, answers_of(rs.Tracer(case.scene, "brute"), rays_of(case)))


#: The simulator compiles for 20 seconds, and then takes a tenth of a second for each.
FLOAT64_PAIRS = [
    pytest.param(
        tracer, name, marks=[pytest.mark.exhaustive] * (is_simulated() and (i > 1 or k % 4 != i))
    )
    for i, tracer in enumerate(FLOAT64_CUDA_TRACERS)
    for k, name in enumerate(CASES)
]


@pytest.mark.parametrize(("tracer", "name"), FLOAT64_PAIRS)
def test_float64_is_exact_with_the_cpus_bits(gpu, tracer, name):
    case = few_of(case_of(name))
    made = rs.Tracer(case.scene, **FLOAT64_CUDA_TRACERS[tracer])
    float64.assert_right(case.scene, made, rays_of(case), 6)


def test_float64_from_a_planet_away(gpu):
    """Limits, parts and invalid rays in float64, where float32 has steps of half a metre."""
    vertices, faces = icosphere(1)
    scene = rs.Scene.from_arrays(vertices * 1e-3 + [6.4e6, -6.4e6, 3.2e6], faces)
    rng = np.random.default_rng(3)
    origins = scene.bounds.mean(axis=0) + rng.normal(size=(20, 3)) * 1e-2
    ways = scene.bounds.mean(axis=0) + rng.normal(size=(20, 3)) * 3e-4 - origins
    origins[3, 1], ways[5] = np.nan, 0.0
    oracle = rs.Tracer(scene, "brute", precision="float64")
    hits = oracle.first_hit(origins, ways)
    assert 3 < hits.is_hit.sum() < 19
    tracer = rs.Tracer(scene, "bvh", rays_at_once=7, **FLOAT64)
    for t_max in (np.inf, 1.0, hits.t, np.nextafter(hits.t, 0.0)):
        rays = {"origins": origins, "directions": ways, "t_max": t_max}
        float64.assert_same(float64.answers_of(tracer, rays), float64.answers_of(oracle, rays))
    assert tracer.any_hit(origins, ways, t_max=hits.t).sum() == hits.is_hit.sum()
    moved = vertices * 1e-3 + [6.4e6, -6.4e6, 3.2e6 + 1e-3]
    for one in (tracer, oracle):
        one.update(moved)
    assert tracer.first_hit(origins, ways).t.tolist() == oracle.first_hit(origins, ways).t.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"build": "device"}, "build='device': not supported with precision='float64'"),
        ({"structure": "grid"}, "structure='grid': not supported with precision='float64'"),
    ],
)
def test_what_float64_does_not_support_is_named(gpu, options, message):
    with pytest.raises((ValueError, rs.RaystreamError), match=message):
        rs.Tracer(rs.load("cornell"), **{**FLOAT64, **options})


def test_float64_gives_the_bits_of_the_cpu(gpu):
    scene = rs.load("cornell")
    ours, theirs = rs.Tracer(scene, **FLOAT64), rs.Tracer(scene, precision="float64")
    ray = [278.0, 273.0, -800.0], [[0.0, 0.0, 1.0], [0.1, -0.2, 1.0]]
    for ask in (
        lambda tracer: tracer.first_hit(*ray, on_hit=_is_far).t,
        lambda tracer: tracer.count_hits(*ray, skip_prim_ids=[1, 1]),
        lambda tracer: tracer.closest_point([278.0, 273.0, 280.0]).positions,
    ):
        assert_same_bits(ask(ours), ask(theirs))


def _is_far(hit):
    return hit.t > 1000.0


@pytest.mark.parametrize("tracer", CUDA_TRACERS)
def test_rays_meet_what_they_meet_on_the_cpu(gpu, tracer):
    case = few_of(case_of("random_soup"))
    options = {**CUDA_TRACERS[tracer], "counters": True}
    ours = rs.Tracer(case.scene, **options)
    theirs = rs.Tracer(case.scene, **{**options, "device": "cpu"})
    for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
        for one in (ours, theirs):
            getattr(one, query)(**rays_of(case))
        for column in ("steps", "leaves", "tests", "restarts", "backtracks", "shadings"):
            found, expected = (getattr(one.counters, column) for one in (ours, theirs))
            assert found.tolist() == expected.tolist(), (query, column)


def test_rays_come_in_any_layout(gpu):
    """Both dtypes, strides, one direction for all, and limits a ray; in parts."""
    case = few_of(case_of("closed_mesh"))
    scene, oracle = case.scene, rs.Tracer(case.scene, "brute")
    tracer = rs.Tracer(scene, "kdtree", "cuda", rays_at_once=7)
    wide = np.zeros((len(case.origins), 6), np.float32)
    wide[:, ::2] = case.origins
    t_max = np.linspace(0.5, 3.0, len(wide))
    for origins, directions, limit in (
        (case.origins, case.directions, np.inf),
        (wide[:, ::2], case.directions.astype(np.float32), t_max),
        (case.origins[::-1], [0.0, 0.0, -1.0], t_max[::-1]),
        (case.origins[0], case.directions, 2.0),
    ):
        ours, theirs = (one.first_hit(origins, directions, t_max=limit) for one in (tracer, oracle))
        for column in ("t", "u", "v", "prim_id", "status"):
            assert getattr(ours, column).tobytes() == getattr(theirs, column).tobytes()


def test_invalid_rays_miss(gpu):
    case = few_of(case_of("closed_mesh"))
    origins, directions = case.origins.copy(), case.directions.copy()
    origins[0, 1], directions[1] = np.nan, 0.0
    hits = rs.Tracer(case.scene, "grid", "cuda").first_hit(origins, directions)
    assert hits.status.tolist()[:3] == [1, 1, 0]
    assert hits.prim_id[:2].tolist() == [-1, -1]
    assert np.isinf(hits.t[:2]).all()


def test_no_rays_and_no_triangles(gpu):
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    for structure in ("brute", "bvh", "grid", "kdtree", "graph"):
        tracer = rs.Tracer(empty, structure, "cuda")
        assert not tracer.any_hit([[0.0, 0.0, 0.0]], [0.0, 0.0, 1.0]).any()
        assert len(tracer.multi_hit(np.zeros((0, 3)), np.zeros((0, 3))).t) == 0


def test_progress_is_reported(gpu):
    case = few_of(case_of("random_soup"))
    seen = []
    tracer = rs.Tracer(case.scene, "grid", "cuda", rays_at_once=10)
    tracer.multi_hit(**rays_of(case), progress=lambda *done: seen.append(done))
    assert seen[-1][0] == seen[-1][1]
    assert len(seen) > 4
    assert seen == sorted(seen)
