"""Every structure and machine gives brute force's bits, in every query.

That is on the CPU; answers of other devices differ by no more than `tolerance` allows. And brute
force agrees with an independent oracle in float64.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import raystream as rs
from cases import CASES, Case
from conftest import (
    CODE_PATHS,
    EVERY_GRAPHICS_TRACER,
    EVERY_TREE,
    EVERYDAY,
    GRAPHICS_TRACERS,
    TRACERS,
    assert_same_bits,
    is_turn,
    tier,
)
from oracles import check_counts, check_first, judge
from raystream.structures import STRUCTURES
from tolerance import Tolerance, assert_close

Answers = dict[str, np.ndarray]

#: Cases in which a tracer that takes long for a query is asked them all: hits of any kind, on
#: edges, at one t, at the limits.
ALL_OPTIONS = (
    "random_soup",
    "exact_edges_on_a_lattice",
    "degenerate_and_duplicate",
    "limits_at_the_hits_themselves",
)


@cache
def case_of(name: str) -> Case:
    return CASES[name](np.random.default_rng(2013))


@cache
def expected_of(name: str) -> Answers:
    """Brute force's answers, once for all that are compared with them."""
    case = case_of(name)
    return answers_of(rs.Tracer(case.scene, "brute"), rays_of(case))


@pytest.fixture(params=CASES)
def case(request) -> Case:
    return case_of(request.param)


def rays_of(case: Case) -> dict[str, Any]:
    return {
        "origins": case.origins,
        "directions": case.directions,
        "t_min": case.t_min,
        "t_max": case.t_max,
    }


def takes_long(tracer: rs.Tracer) -> bool:
    """Whether queries take hundreds of passes, or the GPU may be emulated by the CPU."""
    return tracer.machine == "multipass" or tracer.device != "cpu"


def some_hits(hit) -> bool:
    """A filter that uses all numbers of a hit."""
    if not (hit.u >= 0.0 and hit.v >= 0.0 and hit.t > -np.inf and hit.mesh_id == 0):
        return False
    return (hit.prim_id + hit.ray) % 3 != 0 or (hit.is_entering and hit.u < hit.v)


def answers_of(tracer: rs.Tracer, rays, *, is_brief: bool = False) -> Answers:
    """All four queries, with all their options or, where passes take long, a few."""
    answers: Answers = {}

    def note(query: str, result: Any, *columns: str) -> None:
        answers.update({f"{query}: {column}": getattr(result, column) for column in columns})

    first = tracer.first_hit(**rays)
    note("first_hit", first, "t", "u", "v", "prim_id", "mesh_id", "status")
    answers["any_hit"] = tracer.any_hit(**rays)
    if tracer.device == "cpu":
        for skipped in (None, first.prim_id):
            chosen = {"on_hit": some_hits, "skip_prim_ids": skipped}
            filtered = tracer.first_hit(**rays, **chosen)
            query = f"filtered, {skipped is not None}"
            note(f"first_hit, {query}", filtered, "t", "u", "v", "prim_id", "status")
            answers[f"any_hit, {query}"] = tracer.any_hit(**rays, **chosen)
    for crossings in ("surfaces",) if is_brief else ("triangles", "surfaces"):
        answers[f"count_hits, {crossings}"] = tracer.count_hits(**rays, crossings=crossings)
        for max_hits in (None, 3) if is_brief else (None, 0, 1, 3):
            many = tracer.multi_hit(**rays, crossings=crossings, max_hits=max_hits)
            query = f"multi_hit, {crossings}, {max_hits}"
            note(query, many, "ray_splits", "t", "u", "v", "prim_id", "status")
    return answers


def assert_expected(answers: Answers, expected: Answers) -> None:
    """The arrays of a query have the expected bits; more may be expected than were computed."""
    assert answers
    for name, answer in answers.items():
        assert_same_bits(answer, expected[name])


def assert_expected_of(
    tracer: rs.Tracer, rays, expected: Answers, *, is_brief: bool = False
) -> None:
    """A tracer gives brute force's answers: on the CPU their bits."""
    answers = answers_of(tracer, rays, is_brief=is_brief)
    if tracer.device == "cpu":
        assert_expected(answers, expected)
    else:
        assert_close(answers, expected, Tolerance(tracer.scene, rays))


def assert_same_answers(tracer: rs.Tracer, oracle: rs.Tracer, rays) -> None:
    assert_expected_of(tracer, rays, answers_of(oracle, rays))


#: Cases that graphics devices are asked in CI: compute shaders, and the fragment programs that
#: take many passes. Those of all others are for `.ci/nightly`.
COMPUTE_CASES = ("exact_edges_on_a_lattice", "limits_at_the_hits_themselves")
FRAGMENT_CASES = ("exact_edges_on_a_lattice",)
FRAGMENT_TRACERS = ("grid, multipass, graphics", "kdtree, backtrack, multipass, graphics")


def is_everyday(tracer: str, name: str) -> bool:
    """Whether a default run has a case on a tracer: a third in turn, and two cases on all."""
    if tracer not in EVERYDAY or name in ("random_soup", "exact_edges_on_a_lattice"):
        return tracer in EVERYDAY
    return (EVERYDAY.index(tracer) + list(CASES).index(name)) % 3 == 0


def is_exhaustive(tracer: str, name: str) -> bool:
    """Whether a case on a tracer is omitted from CI.

    On the CPU the code paths have each case, and all others a quarter of them in turn.
    """
    if tracer in TRACERS:
        return tracer not in CODE_PATHS and not is_turn(tracer, list(CASES).index(name), 4)
    options = GRAPHICS_TRACERS[tracer]
    if tracer == "kdtree, short stack, graphics":  # one of four traversals
        return True
    if "machine" in options:
        return tracer not in FRAGMENT_TRACERS or name not in FRAGMENT_CASES
    return name not in COMPUTE_CASES


def tracers_with(name: str) -> list[Any]:
    """Every tracer, for a case."""
    return [
        pytest.param(
            one,
            marks=tier(is_everyday=is_everyday(one, name), is_ci=not is_exhaustive(one, name)),
        )
        for one in (*TRACERS, *GRAPHICS_TRACERS)
    ]


@pytest.mark.parametrize(
    ("name", "make_tracer_anywhere"),
    [
        pytest.param(name, *tracer.values, marks=tracer.marks, id=f"{name}-{tracer.values[0]}")
        for name in CASES
        for tracer in tracers_with(name)
    ],
    indirect=["make_tracer_anywhere"],
)
def test_structures_equal_brute_force(make_tracer_anywhere, name):
    case = case_of(name)
    tracer = make_tracer_anywhere(case.scene)
    is_brief = takes_long(tracer) and name not in ALL_OPTIONS
    assert_expected_of(tracer, rays_of(case), expected_of(name), is_brief=is_brief)


def test_each_structure_has_each_case_in_ci_and_each_tracer_some():
    assert {TRACERS[one]["structure"] for one in CODE_PATHS} == {*STRUCTURES}
    for tracer in TRACERS:
        count = sum(not is_exhaustive(tracer, name) for name in CASES)
        assert count == len(CASES) if tracer in CODE_PATHS else count >= 5


def test_each_structure_and_each_case_is_in_a_default_run():
    assert {TRACERS[one]["structure"] for one in EVERYDAY} == {*STRUCTURES}
    assert {*EVERYDAY} <= {*CODE_PATHS}
    for name in CASES:
        assert sum(is_everyday(tracer, name) for tracer in TRACERS) >= 3


def test_brute_force_agrees_with_float64(case):
    tracer = rs.Tracer(case.scene, "brute")
    rays = rays_of(case)
    verdict = judge(case.vertices, case.faces, case.origins, case.directions, *case.limits())
    check_counts(verdict, tracer.count_hits(**rays))
    hits = tracer.first_hit(**rays)
    check_first(verdict, hits.t, hits.prim_id)


def test_the_oracle_is_rarely_in_doubt():
    """A comparison that tolerates any difference would always pass."""
    for name in ("random_soup", "closed_mesh", "huge_offset", "tiny_scale", "limited_intervals"):
        case = CASES[name](np.random.default_rng(1))
        verdict = judge(case.vertices, case.faces, case.origins, case.directions, *case.limits())
        assert verdict.sure.sum() > 100
        assert verdict.doubt.sum() < 0.02 * verdict.sure.sum(), name


def test_queries_agree_with_each_other(case):
    """any = first exists; count = rows; first = first row; k rows = the first k of all."""
    tracer = rs.Tracer(case.scene)
    rays = rays_of(case)
    hits, many = tracer.first_hit(**rays), tracer.multi_hit(**rays)
    np.testing.assert_array_equal(tracer.any_hit(**rays), hits.is_hit)
    np.testing.assert_array_equal(many.counts > 0, hits.is_hit)
    np.testing.assert_array_equal(many.counts, tracer.count_hits(**rays))
    first_rows = many.ray_splits[:-1][hits.is_hit]
    for column in ("t", "u", "v", "prim_id"):
        np.testing.assert_array_equal(
            getattr(many, column)[first_rows], getattr(hits, column)[hits.is_hit]
        )
    same_ray = np.diff(many.ray_id) == 0
    assert (np.diff(many.t)[same_ray] >= 0).all()
    three = tracer.multi_hit(**rays, max_hits=3)
    within = np.arange(len(many.t)) - many.ray_splits[many.ray_id] < 3
    np.testing.assert_array_equal(three.prim_id, many.prim_id[within])


@pytest.mark.parametrize(
    "make_tracer_anywhere", [*EVERY_TREE, *EVERY_GRAPHICS_TRACER], indirect=True
)
def test_no_triangles_at_all(make_tracer_anywhere):
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    only_degenerate = rs.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])
    for scene in (empty, only_degenerate, rs.Scene()):
        tracer = make_tracer_anywhere(scene)
        rays = {"origins": np.zeros((5, 3)), "directions": np.ones((5, 3))}
        hits = tracer.first_hit(**rays)
        assert np.isinf(hits.t).all()
        assert (hits.prim_id == -1).all()
        assert (hits.mesh_id == -1).all()
        assert np.isnan(hits.positions).all()
        assert not tracer.any_hit(**rays).any()
        assert not tracer.count_hits(**rays).any()
        assert tracer.multi_hit(**rays).ray_splits.tolist() == [0] * 6


def test_no_rays_at_all(make_tracer_anywhere):
    tracer = make_tracer_anywhere(CASES["one_triangle"](np.random.default_rng(0)).scene)
    for shape in ((0, 3), (4, 0, 3)):
        hits = tracer.first_hit(np.zeros(shape), np.zeros(shape))
        assert hits.t.shape == shape[:-1]
        assert tracer.any_hit(np.zeros(shape), np.zeros(shape)).shape == shape[:-1]
        assert tracer.multi_hit(np.zeros(shape), np.zeros(shape)).ray_splits.tolist() == [0]


def test_invalid_rays_miss_and_say_so(make_tracer_anywhere):
    tracer = make_tracer_anywhere(CASES["random_soup"](np.random.default_rng(0)).scene)
    bad = [np.nan, np.inf, -np.inf]
    good = ([0.5, 0.5, -5.0], [0.0, 0.0, 1.0])
    origins, directions = [], []
    for axis in range(3):
        for value in bad:
            for which in range(2):
                ray = [list(good[0]), list(good[1])]
                ray[which][axis] = value
                origins.append(ray[0])
                directions.append(ray[1])
    origins += [good[0], good[0], good[0]]
    directions += [[0, 0, 0], [-0.0, 0, 0], good[1]]
    hits = tracer.first_hit(origins, directions)
    invalid = np.arange(len(origins)) < len(origins) - 1
    np.testing.assert_array_equal(hits.status == rs.RayStatus.INVALID, invalid)
    assert (hits.prim_id[invalid] == -1).all()
    assert hits.prim_id[-1] >= 0
    assert not tracer.any_hit(origins, directions)[invalid].any()
    many = tracer.multi_hit(origins, directions)
    assert many.counts[invalid].sum() == 0
    np.testing.assert_array_equal(many.status, hits.status)
    nan_limit = tracer.first_hit([good[0]] * 2, [good[1]] * 2, t_min=[np.nan, 0], t_max=[9, np.nan])
    assert (nan_limit.status == rs.RayStatus.INVALID).all()
    assert not nan_limit.is_hit.any()


@pytest.mark.parametrize("make_tracer_anywhere", tracers_with("random_soup"), indirect=True)
def test_the_size_of_blocks_and_the_number_of_threads_change_nothing(
    make_tracer_anywhere, monkeypatch
):
    case, expected = case_of("random_soup"), expected_of("random_soup")
    tracer, rays = make_tracer_anywhere(case.scene), rays_of(case)
    # A block takes the multipass machine hundreds of passes, however few rays it has.
    is_brief = takes_long(tracer)
    small = 200 if is_brief else 7
    for block, threads in ((1 << 20, 1), (small, 2), (399, 3)):
        monkeypatch.setattr("raystream.machines.ray_block.RAYS_PER_BLOCK", block)
        try:
            rs.set_thread_count(threads)
            assert_expected_of(tracer, rays, expected, is_brief=is_brief)
        finally:
            rs.set_thread_count(None)


@pytest.mark.parametrize(
    ("max_hits", "error"), [(2.5, TypeError), ("3", TypeError), (-1, ValueError)]
)
def test_max_hits_is_checked(max_hits, error):
    tracer = rs.Tracer(rs.Scene())
    with pytest.raises(error):
        tracer.multi_hit([0, 0, 0], [1, 0, 0], max_hits=max_hits)
    assert tracer.multi_hit([0, 0, 0], [1, 0, 0], max_hits=2**70).t.size == 0
    with pytest.raises(ValueError, match="crossings"):
        tracer.count_hits([0, 0, 0], [1, 0, 0], crossings="walls")


def test_more_hits_than_memory_are_refused(monkeypatch):
    """Nothing is cut off silently, and the system need not kill the process."""
    tracer = rs.Tracer(CASES["one_triangle"](np.random.default_rng(0)).scene)
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 10)
    monkeypatch.setattr("raystream.kernels.hits.CHECKED_HITS", 1)
    refused = r"multi_hit: [\d,]+ hits would take .* give max_hits"
    rays = np.full((10, 3), [0.2, 0.2, 1.0]), [0, 0, -1]
    with pytest.raises(MemoryError, match=refused):
        tracer.multi_hit(*rays)
    # Room for a buffer of four hits, but not for all ten.
    monkeypatch.setattr("raystream.structures.single_kernels.FIRST_CAPACITY", 4)
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 4 * 16)
    assert len(tracer.multi_hit(rays[0][:3], rays[1]).t) == 3
    with pytest.raises(MemoryError, match=refused):
        tracer.multi_hit(*rays)
    monkeypatch.setattr("raystream.core.memory.available_memory", lambda: 10)
    with pytest.raises(MemoryError, match="an image of 100x100 would"):
        rs.render(rs.Scene(), size=(100, 100))
