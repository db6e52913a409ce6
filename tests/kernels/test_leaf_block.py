"""The leaf block: its contents, and a test with the bits of a triangle list's."""

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import lattice_soup, soup
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.kernels.hits import HitArrays, hit_addresses
from raystream.kernels.leaf_block import (
    BLOCK,
    BLOCK_FLOATS,
    BLOCK_SIZE,
    PRIM_IDS,
    block_ray,
    blocks_end,
    filled_blocks,
    intersect_block,
    triangle_count,
)
from raystream.kernels.ray import prepare_ray
from raystream.kernels.search import SearchGoal, begin_search
from raystream.kernels.triangle_list import intersect_list

_NONE = np.uint64(0)
_ONE = np.uint64(1)


def numbers_of(count):
    """Numbers of triangles in blocks, -1 in unused lanes."""
    padded = np.full(-(-count // BLOCK_SIZE) * BLOCK_SIZE, -1, np.int32)
    padded[:count] = np.arange(count)[::-1]
    return padded.reshape(-1, BLOCK_SIZE)


@pytest.mark.parametrize("count", [0, 1, 4, 7])
def test_a_block_holds_corners_side_by_side(count, rng):
    corners = rng.random((9, 3, 3), dtype=np.float32)
    prim_ids = numbers_of(count)
    blocks = filled_blocks(prim_ids, corners)
    assert blocks.shape == (len(prim_ids), BLOCK_FLOATS)
    assert not count or blocks.ctypes.data % 64 == 0
    assert_same_bits(blocks[:, 36:].view(np.int32), prim_ids)
    held = blocks[:, :36].reshape(-1, 3, 3, BLOCK_SIZE).transpose(0, 3, 1, 2)
    assert_same_bits(held[prim_ids >= 0], corners[prim_ids[prim_ids >= 0]])
    assert np.isnan(held[prim_ids < 0]).all()


@kernel
def count_triangles(blocks, counts):
    for i in range(np.uint64(len(blocks))):
        counts[i] = triangle_count(address(blocks) + i * BLOCK + PRIM_IDS)


def test_the_triangles_of_a_block_are_counted(rng):
    blocks = filled_blocks(numbers_of(7), rng.random((9, 3, 3), dtype=np.float32))
    counts = np.empty(2, np.int64)
    count_triangles(blocks, counts)
    assert counts.tolist() == [4, 3]


@kernel
def in_parts(blocks, count, max_coordinate, origins, directions, parts, surfaces, out, counts):
    """The hits of each ray in parts of its length, kept and counted."""
    first = address(blocks)
    end = blocks_end(first, np.uint64(count))
    to = hit_addresses(out)
    room = np.uint64(len(out.t)) // np.uint64(len(counts))
    for i in range(np.uint64(len(counts))):
        o, d = origins[i], directions[i]
        ray = block_ray(prepare_ray(o, d, max_coordinate))
        inf = np.float32(np.inf)
        keeping = SearchGoal(room, to, i * room, surfaces)
        kept = begin_search(parts[0], inf, keeping, None, None, None)
        counting = SearchGoal(room, None, _NONE, surfaces)
        counted = begin_search(parts[0], inf, counting, None, None, None)
        for k in range(len(parts) - 1):
            block = first
            while block != end:
                kept = intersect_block(block, ray, kept, parts[k], parts[k + 1])
                counted = intersect_block(block, ray, counted, parts[k], parts[k + 1])
                block += BLOCK
        counts[i] = kept.hit_count if counted.hit_count == kept.hit_count else -1


@kernel
def in_a_list(prim_ids, corners, max_coordinate, origins, directions, t_min, surfaces, out, counts):
    """The same of a list, without parts."""
    to, end = hit_addresses(out), np.uint64(len(prim_ids))
    room = np.uint64(len(out.t)) // np.uint64(len(counts))
    inf = np.float32(np.inf)
    for i in range(np.uint64(len(counts))):
        o, d = origins[i], directions[i]
        ray = prepare_ray(o, d, max_coordinate)
        goal = SearchGoal(room, to, i * room, surfaces)
        search = begin_search(t_min, inf, goal, None, None, None)
        search = intersect_list(
            address(prim_ids), address(corners), _NONE, end, ray, search, t_min, inf
        )
        counts[i] = search.hit_count


@pytest.mark.ci
@pytest.mark.parametrize("surfaces", [False, True])
@pytest.mark.parametrize("mesh", [soup(11, 3), lattice_soup(30)], ids=["soup", "lattice"])
def test_parts_of_a_ray_give_the_bits_of_a_list(mesh, surfaces, rng):
    triangles = rs.Scene.from_arrays(*mesh).triangles
    count, rays = len(triangles.prim_ids), 300
    low, high = triangles.bounds
    origins = (low + rng.random((rays, 3)) * (high - low)).astype(np.float32)
    aimed = triangles.corners[rng.choice(triangles.prim_ids, rays)]
    aimed[: rays // 2] = aimed[: rays // 2].mean(axis=1, keepdims=True)
    directions = (aimed[:, 0] - origins).astype(np.float32)  # half of them at corners
    directions[np.abs(directions).max(axis=1) == 0] = 1
    largest = np.abs(directions).max(axis=1)
    directions = np.ldexp(directions, 1 - np.frexp(largest)[1][:, None])
    padded = np.full(-(-count // BLOCK_SIZE) * BLOCK_SIZE, -1, np.int32)
    padded[:count] = triangles.prim_ids
    blocks = filled_blocks(padded.reshape(-1, BLOCK_SIZE), triangles.corners)
    shared = triangles.max_coordinate, origins, directions
    expected, right = HitArrays.empty(rays * count), np.empty(rays, np.int64)
    t_min = np.float32(0)
    in_a_list(triangles.prim_ids, triangles.corners, *shared, t_min, surfaces, expected, right)
    assert right.max() > 1
    # Parts that end at hits: each hit is in one of them.
    ends = [expected.t[i * count : i * count + right[i]] for i in range(rays)]
    parts = np.concatenate([[0], np.unique(np.concatenate(ends))[::40], [np.inf]])
    parts = np.unique(parts.astype(np.float32))
    out, counts = HitArrays.empty(rays * count), np.empty(rays, np.int64)
    in_parts(blocks, count, *shared, parts, surfaces, out, counts)
    assert_same_bits(counts, right)
    for i in range(rays):
        rows = slice(i * count, i * count + right[i])
        order = np.lexsort([expected.prim_id[rows], expected.t[rows]])
        other = np.lexsort([out.prim_id[rows], out.t[rows]])
        for column, wanted in zip(out, expected, strict=True):
            assert_same_bits(column[rows][other], wanted[rows][order])
