"""Vectors of any layout are copied as they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.kernels.adjacent_rows import adjacent_rows, rows_of

STEPS = st.sampled_from((1, 2, 3, -1, -2))


@st.composite
def layouts(draw):
    """Vectors in a layout of their own: cut from a larger array, reversed, transposed."""
    dtype = draw(st.sampled_from((np.float32, np.float64, np.float16, ">f4")))
    shape = draw(st.tuples(*[st.integers(0, 40)] * draw(st.integers(1, 2))))
    steps = [draw(STEPS) for _ in range(len(shape) + 1)]
    axes = draw(st.permutations(range(len(shape) + 1)))
    lengths = [
        n * abs(step) + draw(st.integers(0, 2)) for n, step in zip((*shape, 3), steps, strict=True)
    ]
    whole = np.random.default_rng(1).random([lengths[axis] for axis in axes]).astype(dtype)
    cut = whole.transpose(np.argsort(axes))[tuple(slice(None, None, step) for step in steps)]
    return cut[tuple(slice(0, n) for n in (*shape, 3))]


@given(layouts())
def test_any_layout_is_copied(vectors):
    copied = adjacent_rows(vectors)
    assert copied.flags.c_contiguous
    assert copied.dtype == vectors.dtype
    np.testing.assert_array_equal(copied, vectors)


def test_many_vectors_are_copied_by_all_threads(rng):
    whole = rng.random((300, 700, 4))
    for vectors in (whole[..., 1:], whole.transpose(1, 0, 2)[..., 2::-1], whole[0, :, :3]):
        np.testing.assert_array_equal(adjacent_rows(vectors), vectors)


def test_numbers_that_are_not_aligned_are_copied():
    records = np.zeros(5, np.dtype([("tag", "u1"), ("place", "f4", 3)]))
    records["place"] = np.arange(15).reshape(5, 3)
    assert not records["place"].flags.aligned
    np.testing.assert_array_equal(adjacent_rows(records["place"]), records["place"])


def test_only_images_that_cannot_be_viewed_as_rows_are_copied():
    image = np.zeros((20, 30, 4), np.float32)
    for kept in (image[..., :3], image[0, :, :3], [[1.0, 2.0, 3.0]], image.astype(int)[:, 5:, :3]):
        assert rows_of(kept) is kept
    for copied in (image[:, 5:, :3], image[..., :3].transpose(1, 0, 2)):
        assert rows_of(copied).flags.c_contiguous


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_queries_of_any_layout_agree(rng, dtype):
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(100, 1)))
    origins = (rng.random((50, 70, 3)) * 3 - 1).astype(dtype)
    directions = (rng.random((50, 70, 3)) - origins).astype(dtype)
    expected = tracer.first_hit(origins, directions)
    records = np.concatenate([origins, directions], axis=-1)
    split = tracer.first_hit(records[..., :3], records[..., 3:])
    turned = tracer.first_hit(
        np.asfortranarray(origins),
        np.ascontiguousarray(directions.transpose(1, 0, 2)).transpose(1, 0, 2),
    )
    across = tracer.first_hit(origins.transpose(1, 0, 2), directions.transpose(1, 0, 2))
    for column in ("t", "u", "v", "prim_id", "status"):
        values = getattr(expected, column)
        assert_same_bits(getattr(split, column), values)
        assert_same_bits(getattr(turned, column), values)
        assert_same_bits(getattr(across, column), np.ascontiguousarray(values.T))
