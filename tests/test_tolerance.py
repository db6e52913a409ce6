"""The comparison with other devices tolerates rounding and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from test_agreement import answers_of, case_of, rays_of
from tolerance import Tolerance, assert_close

CASE = case_of("random_soup")


@pytest.fixture
def expected():
    return answers_of(rs.Tracer(CASE.scene, "brute"), rays_of(CASE))


@pytest.fixture
def answers(expected):
    return {name: answer.copy() for name, answer in expected.items()}


@pytest.fixture
def check(answers, expected):
    return lambda: assert_close(answers, expected, Tolerance(CASE.scene, rays_of(CASE)))


def row_of(answers, query):
    """A row with a hit."""
    return np.flatnonzero(answers[f"{query}: prim_id"] >= 0)[3]


@pytest.mark.parametrize("query", ["first_hit", "multi_hit, triangles, 3"])
@pytest.mark.parametrize(("column", "off"), [("t", 3e-6), ("u", 5e-5), ("v", -5e-5)])
def test_last_digits_pass(answers, check, query, column, off):
    answers[f"{query}: {column}"] += np.float32(off)
    check()


@pytest.mark.parametrize("query", ["first_hit", "multi_hit, surfaces, None"])
@pytest.mark.parametrize(
    ("column", "off"), [("t", 1e-3), ("t", np.nan), ("u", 1e-3), ("v", 1e-3), ("prim_id", 1)]
)
def test_more_does_not(answers, check, query, column, off):
    answers[f"{query}: {column}"][row_of(answers, query)] += off
    with pytest.raises(AssertionError):
        check()


@pytest.mark.parametrize(
    "name", ["any_hit", "count_hits, triangles", "first_hit: status", "first_hit: mesh_id"]
)
def test_what_is_counted_is_exact(answers, check, name):
    answers[name][7] ^= True
    with pytest.raises(AssertionError):
        check()


def test_a_miss_is_no_hit(answers, check):
    row = row_of(answers, "first_hit")
    answers["first_hit: prim_id"][row] = -1
    answers["first_hit: t"][row] = np.inf
    with pytest.raises(AssertionError):
        check()


def test_hits_that_are_as_far_may_change_places():
    case = case_of("degenerate_and_duplicate")
    expected = answers_of(rs.Tracer(case.scene, "brute"), rays_of(case))
    query = "multi_hit, triangles, None"
    t, splits = expected[f"{query}: t"], expected[f"{query}: ray_splits"]
    ray_id = np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    tied = np.flatnonzero((t[1:] == t[:-1]) & (ray_id[1:] == ray_id[:-1]))[0]
    answers = {name: answer.copy() for name, answer in expected.items()}
    for column in ("prim_id", "u", "v"):
        rows = answers[f"{query}: {column}"]
        rows[[tied, tied + 1]] = rows[[tied + 1, tied]]
    assert_close(answers, expected, Tolerance(case.scene, rays_of(case)))
