"""The stratified numbers: one in each cell, row and column."""

from __future__ import annotations

import math

import numpy as np
import pytest

from chi_square import assert_follows
from raystream.jit.cpu import kernel
from raystream.rendering.sampling import stratified
from raystream.rendering.sampling.sampler import Sampler


@pytest.mark.parametrize("count", [1, 2, 4, 6, 12, 16, 64, 100, 110, 1024])
@pytest.mark.parametrize("dimension", [0, 2, 776])
def test_one_sample_in_each_stratum(count, dimension):
    """Of counts that fill a grid: each cell, and each of the fine rows and columns."""
    for pixel in range(8):
        points = Sampler.of("stratified", 5, count).numbers(pixel, np.arange(count), dimension, 2)
        points = points.astype(np.float64)
        columns = math.isqrt(count)
        cells = (points * [columns, count // columns]).astype(int)
        assert len(np.unique(cells, axis=0)) == count
        for k in range(2):
            assert np.array_equal(np.sort((points[:, k] * count).astype(int)), np.arange(count))


@pytest.mark.parametrize("count", [3, 5, 7, 13, 99, 1000])
def test_other_counts_leave_cells_empty_but_share_none(count):
    columns = math.isqrt(count)
    rows = -(-count // columns)
    for pixel in range(8):
        points = Sampler.of("stratified", 5, count).numbers(pixel, np.arange(count), 0, 2)
        cells = (points.astype(np.float64) * [columns, rows]).astype(int)
        assert len(np.unique(cells, axis=0)) == count
        for k in range(2):
            fine = (points[:, k].astype(np.float64) * columns * rows).astype(int)
            assert len(np.unique(fine)) == count


def test_samples_beyond_the_count_are_another_set():
    points = Sampler.of("stratified", 5, 64).numbers(3, np.arange(192), 0, 2).reshape(3, 64, 2)
    for block in points:
        assert len(np.unique((block * 8).astype(int), axis=0)) == 64
    assert (np.sort(points[0], axis=0) != np.sort(points[1], axis=0)).mean() > 0.99


@kernel
def shuffle(length, keys, out):
    for k in range(len(keys)):
        for x in range(length):
            out[k, x] = stratified._shuffled(np.uint32(x), np.uint32(length), keys[k])


def shuffles(length, count=1 << 15):
    out = np.empty((count, length), np.uint32)
    shuffle(length, np.arange(count, dtype=np.uint32), out)
    return out.astype(int)


@pytest.mark.parametrize("length", [1, 2, 3, 5, 8, 31, 100, 1025])
def test_a_shuffle_is_one_to_one(length):
    assert (np.sort(shuffles(length, 500), axis=1) == np.arange(length)).all()


@pytest.mark.parametrize("length", [7, 8, 11, 16, 33])
def test_each_goes_anywhere(length):
    """Any two places are equally likely for two that were neighbours."""
    orders = shuffles(length)
    for x in range(0, length, 5):
        pairs = orders[:, x] * length + orders[:, (x + 1) % length]
        counts = np.bincount(pairs, minlength=length**2).reshape(length, length)
        off = ~np.eye(length, dtype=bool)
        assert not counts[~off].any()
        assert_follows(counts[off], np.full(off.sum(), len(orders) / off.sum()))
