"""Dividing rays into blocks."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from raystream.ray_files.blocks import divide

SHAPES = [(), (0,), (1,), (1000,), (1, 1000), (7, 11, 13), (3, 0, 5), (100, 1, 3), (2, 500)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("limit", [1, 7, 60, 10_000])
@pytest.mark.parametrize("chunk", [1, 5, 300])
def test_blocks_are_all_rays_in_order(shape, limit, chunk):
    rays = np.arange(math.prod(shape)).reshape(shape)
    blocks = divide(shape, [chunk] * len(shape), limit)
    reached = 0
    for block in blocks.after(0):
        assert block.begin == reached < block.end
        np.testing.assert_array_equal(rays[block.box].ravel(), np.arange(block.begin, block.end))
        assert block.shape == rays[block.box].shape
        assert all(part.start % n == 0 for part, n in zip(block.box, blocks.lengths, strict=True))
        assert block.end - block.begin <= 4 * limit
        reached = block.end
    assert reached == blocks.ray_count == rays.size


@pytest.mark.parametrize("shape", [(1000,), (7, 11, 13)])
def test_blocks_go_on_from_the_end_of_any(shape):
    blocks = divide(shape, [4] * len(shape), 60)
    all_blocks = list(blocks.after(0))
    assert len(all_blocks) > 5
    for number, block in enumerate(all_blocks):
        assert list(blocks.after(block.end)) == all_blocks[number + 1 :]


@pytest.mark.parametrize(
    ("length", "chunk", "limit", "step"),
    [
        (10_000, 100, 1000, 1000),  # whole chunks
        (10_000, 300, 1000, 900),
        (10_000, 3000, 1000, 3000),  # one, though it is longer than requested
        (10_000, 6000, 1000, 1000),  # a whole part of one
        (10_000, 5500, 1000, 917),
        (1010, 1, 1000, 505),  # no tiny rest
        (10, 100, 1000, 10),
    ],
)
def test_blocks_suit_chunks(length, chunk, limit, step):
    assert divide((length,), (chunk,), limit).lengths == (step,)


def test_blocks_of_many_axes_are_not_made_before_they_are_needed():
    blocks = divide((2**20, 2**20), (1, 2**10), 2**20)
    first = list(itertools.islice(blocks.after(0), 2))
    assert [(block.begin, block.end) for block in first] == [(0, 2**20), (2**20, 2**21)]
