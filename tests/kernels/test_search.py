"""The heap of nearest hits, and the set of triangles seen, by themselves."""

import numpy as np
import pytest

from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.kernels.hits import HitArrays, hit_addresses
from raystream.kernels.search import (
    ADDED,
    FULL,
    SEEN,
    SeenSet,
    clear_seen,
    keep_hit,
    mark_seen,
    sort_hits,
)


@kernel
def offer(t, prim_id, capacity, first, out):
    to = hit_addresses(out)
    count, t_far = np.uint64(0), np.float32(np.inf)
    for i in range(len(t)):
        if t[i] <= t_far:
            u, v = np.float32(i), np.float32(-i)
            count, t_far = keep_hit(
                to, np.uint64(first), count, np.uint64(capacity), t[i], u, v, prim_id[i], t_far
            )
    sort_hits(to, np.uint64(first), count)
    return count, t_far


@pytest.mark.parametrize("count", [1, 2, 3, 7, 100, 1000])
@pytest.mark.parametrize("capacity", [1, 2, 3, 10, 999, 1000, 2000])
def test_the_nearest_are_kept_in_order(count, capacity, rng):
    t = rng.integers(0, max(2, count // 3), count).astype(np.float32)
    prim_id = rng.permutation(count).astype(np.int32)
    out = HitArrays.empty(capacity + 5)
    for column in out:
        column[:] = -7
    kept, t_far = offer(t, prim_id, capacity, 3, out)
    order = np.lexsort([prim_id, t])[:capacity]
    assert kept == len(order)
    rows = slice(3, 3 + kept)
    np.testing.assert_array_equal(out.t[rows], t[order])
    np.testing.assert_array_equal(out.prim_id[rows], prim_id[order])
    np.testing.assert_array_equal(out.u[rows], order)
    np.testing.assert_array_equal(out.v[rows], -order)
    assert t_far == (t[order[-1]] if count >= capacity else np.inf)
    for column in out:  # the rows of others
        assert (column[:3] == -7).all()
        assert (column[3 + capacity :] == -7).all()


def test_the_columns_are_one_piece_of_memory():
    out = HitArrays.empty(9)
    assert out.prim_id.dtype == np.int32
    assert all(column.base is out.t.base for column in out)
    assert out.part(slice(2, 5)).u.shape == (3,)


@kernel
def mark(table, prim_ids, answers):
    seen = SeenSet(address(table), np.uint64(len(table) - 1))
    clear_seen(seen)
    for i in range(len(prim_ids)):
        answers[i] = mark_seen(seen, prim_ids[i])


def test_triangles_seen_before(rng):
    prim_ids = rng.integers(0, 2**31 - 1, 5000).astype(np.int32)
    prim_ids[::3] = prim_ids[rng.integers(0, 5000, len(prim_ids[::3]))]
    prim_ids[:4] = 0, 2**31 - 2, 0, 2**31 - 2
    answers = np.empty(5000, np.uint64)
    mark(np.empty((1 << 14) + 1, np.int32), prim_ids, answers)
    first = np.zeros(5000, bool)
    first[np.unique(prim_ids, return_index=True)[1]] = True
    np.testing.assert_array_equal(answers, np.where(first, ADDED, SEEN))


def test_a_set_without_places_remembers_nothing():
    answers = np.empty(40, np.uint64)
    mark(np.empty(1, np.int32), np.zeros(40, np.int32), answers)
    assert (answers == ADDED).all()


def test_a_set_that_is_full_says_so():
    prim_ids = np.arange(40, dtype=np.int32) * 64
    answers = np.empty(40, np.uint64)
    mark(np.empty(65, np.int32), prim_ids, answers)
    assert (answers[:32] == ADDED).all()
    assert (answers[32:] == FULL).all()
