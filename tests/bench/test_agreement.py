"""Agreement, by cases computed by hand."""

from __future__ import annotations

import numpy as np

from raystream.bench.agreement import compare, count_hits, outcome
from raystream.bench.contenders.base import AllHits, Closest, FirstHits, Points


def first(*t: float) -> np.ndarray:
    return outcome(FirstHits(np.array(t, np.float32), np.zeros(len(t), np.int32)))


def multi(*counts: int) -> np.ndarray:
    splits = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return outcome(AllHits(splits, np.ones(splits[-1]), np.zeros(splits[-1], int)))


def test_first_hits():
    ours = first(1.0, 1.0, np.inf, np.inf, 2.0)
    theirs = first(1.0 + 5e-5, 1.001, 1e37, 3.0, np.inf)
    assert compare("first", ours, theirs) == (3 / 5, 3)
    assert compare("first", ours, ours) == (0.0, 3)


def test_shapes_may_differ():
    t, prim_id = np.ones((2, 2), np.float32), np.zeros((2, 2), np.int32)
    assert compare("first", outcome(FirstHits(t, prim_id)), first(1, 1, 1, 1)).differing == 0.0
    assert outcome(np.array([[True], [False]])).shape == (2,)


def test_any_hits():
    ours, theirs = np.array([True, False, True, True]), np.array([True, True, True, True])
    assert compare("any", outcome(ours), outcome(theirs)) == (1 / 4, 4)


def test_all_hits_by_their_number():
    assert compare("multi", multi(2, 0, 1), multi(2, 1, 0)) == (2 / 3, 3)
    assert count_hits("multi", multi(2, 0, 1)) == 3


def test_distances_of_points_in_units_of_the_scene():
    given = Points(np.zeros((3, 3), np.float32), 10.0)
    ours = outcome(Closest(np.array([1.0, 2.0, np.inf])), given)
    assert ours.tolist() == [0.1, 0.2, np.inf]
    theirs = outcome(Closest(None, np.array([[1.000009, 0, 0], [0, 2.0001, 0], [5, 0, 0]])), given)
    assert theirs[2] == 0.5
    assert compare("closest", ours, theirs) == (2 / 3, 3)
    assert compare("closest", ours, np.full(3, np.nan)).differing == 1.0
    assert count_hits("closest", ours) == 2


def test_no_rays():
    assert compare("first", first(), first()) == (0.0, 0)
