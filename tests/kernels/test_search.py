"""The heap of nearest hits, by itself."""

import numpy as np
import pytest

from raystream.jit.cpu import kernel
from raystream.kernels.hits import HitArrays, hit_addresses
from raystream.kernels.search import keep_hit, sort_hits


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
