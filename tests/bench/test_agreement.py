"""Agreement, by cases computed by hand."""

from __future__ import annotations

import numpy as np

from raystream.bench.agreement import compare, count_hits
from raystream.bench.contenders.base import AllHits, FirstHits


def first(*t: float) -> FirstHits:
    return FirstHits(np.array(t, np.float32), np.zeros(len(t), np.int32))


def multi(*counts: int) -> AllHits:
    splits = np.concatenate([[0], np.cumsum(counts)])
    return AllHits(splits, np.ones(splits[-1]), np.zeros(splits[-1], int))


def test_first_hits():
    ours = first(1.0, 1.0, np.inf, np.inf, 2.0)
    theirs = first(1.0 + 5e-5, 1.001, 1e37, 3.0, np.inf)
    assert compare(ours, theirs) == (3 / 5, 3)
    assert compare(ours, ours) == (0.0, 3)


def test_shapes_may_differ():
    ours, theirs = first(1, 2, 3, 4), first(1, 2, 3, 4)
    assert compare(FirstHits(*(array.reshape(2, 2) for array in ours)), theirs).differing == 0.0


def test_any_hits():
    ours, theirs = np.array([True, False, True, True]), np.array([True, True, True, True])
    assert compare(ours, theirs) == (1 / 4, 4)


def test_all_hits_by_their_number():
    assert compare(multi(2, 0, 1), multi(2, 1, 0)) == (2 / 3, 3)
    assert count_hits(multi(2, 0, 1)) == 3


def test_no_rays():
    assert compare(first(), first()) == (0.0, 0)
