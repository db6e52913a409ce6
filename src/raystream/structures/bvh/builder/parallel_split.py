"""Split a large range of references on all threads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.jit.simd import address, f32x8, load, scratch, store
from raystream.jit.threads import chunk_size, parallel_for
from raystream.structures.bvh.builder.binary_tree import (
    add_to_side,
    is_left,
    no_sides,
    side_test,
    store_sides,
)
from raystream.structures.bvh.builder.binning import (
    BIN_COUNT,
    SUMS_BYTES,
    bin_frame,
    bin_refs,
    clear_bins,
    find_split,
)
from raystream.structures.bvh.builder.prim_refs import REF_BYTES, REF_FLOATS

#: Most references per call of a kernel.
_MOST = 1 << 15


def split_large(
    refs: NDArray[np.float32],
    target: NDArray[np.float32],
    begin: int,
    end: int,
    centroids: NDArray[np.float32],
) -> tuple[int, NDArray[np.float32]] | None:
    """Split a range in two by the surface area heuristic, moving its references to `target`.

    Parameters
    ----------
    refs, target : ndarray of shape (A, 8), float32
    begin, end : int
    centroids : ndarray of shape (8,), float32
        Bounds of their centroids.

    Returns
    -------
    middle : int
        End of the first part.
    part_bounds : ndarray of shape (2, 2, 8), float32
        Bounds of each part's references, and of their centroids.

    None if all centroids are equal; nothing is moved then.
    """
    chunk = chunk_size(end - begin, _MOST)
    chunk_count = -(-(end - begin) // chunk)
    sets = np.empty((chunk_count, 2, 3, BIN_COUNT, REF_FLOATS), np.float32)

    def fill(first: int, last: int) -> None:
        _fill_bins(begin + first, begin + last, refs, centroids, sets[first // chunk])

    parallel_for(fill, end - begin, chunk)
    bins = sets[:, 0]
    whole = bins.max(axis=0)
    whole[..., 7] = bins[..., 7].sum(axis=0, dtype=np.float64)
    axis, position = _find_split(whole)
    if axis < 0:
        return None
    left_counts = bins[:, axis, :position, 7].sum(axis=1, dtype=np.float64).astype(np.int64)
    middle = begin + int(left_counts.sum())
    sizes = np.full(chunk_count, chunk)
    sizes[-1] = end - begin - chunk * (chunk_count - 1)
    left_ends = begin + np.cumsum(left_counts)
    right_ends = middle + np.cumsum(sizes - left_counts)
    chunk_bounds = np.full((chunk_count, 2, 2, REF_FLOATS), -np.inf, np.float32)

    def move(first: int, last: int) -> None:
        row = first // chunk
        _move(
            begin + first,
            begin + last,
            refs,
            target,
            centroids,
            (axis, position),
            left_ends[row] - left_counts[row],
            right_ends[row] - (sizes[row] - left_counts[row]),
            chunk_bounds[row],
        )

    parallel_for(move, end - begin, chunk)
    return middle, chunk_bounds.max(axis=0)


@kernel
def _fill_bins(begin, end, refs, centroids, bins):
    if begin == end:
        return
    bin_at, ref_at = address(bins), address(refs)
    start, scale = bin_frame(load(f32x8, address(centroids)), np.int32(BIN_COUNT))
    clear_bins(bin_at, np.int32(BIN_COUNT))
    first = ref_at + np.uint64(begin) * np.uint64(REF_BYTES)
    last = ref_at + np.uint64(end) * np.uint64(REF_BYTES)
    bin_refs(first, last, start, scale, bin_at)


@kernel
def _find_split(bins):
    axis, position = find_split(address(bins), np.int32(BIN_COUNT), scratch(SUMS_BYTES))
    return np.int64(axis), np.int64(position)


@kernel
def _move(begin, end, refs, target, centroids, split, left_row, right_row, bounds):
    """Move the references of a chunk to their side: rows from left_row and right_row on.

    `split` is the axis and the position in its bins.
    """
    if begin == end:
        return
    axis = np.int32(split[0])
    test = side_test(load(f32x8, address(centroids)), np.int32(BIN_COUNT), axis, np.int32(split[1]))
    sides = no_sides()
    ref_at, target_at = address(refs), address(target)
    at = ref_at + np.uint64(begin) * np.uint64(REF_BYTES)
    last = ref_at + np.uint64(end) * np.uint64(REF_BYTES)
    left_at = target_at + np.uint64(left_row) * np.uint64(REF_BYTES)
    right_at = target_at + np.uint64(right_row) * np.uint64(REF_BYTES)
    while at != last:
        ref = load(f32x8, at)
        goes_left = is_left(ref, test, axis)
        sides = add_to_side(sides, ref, goes_left)
        store(right_at + (left_at - right_at) * goes_left, ref)
        left_at += goes_left * np.uint64(REF_BYTES)
        right_at += (np.uint64(1) - goes_left) * np.uint64(REF_BYTES)
        at += np.uint64(REF_BYTES)
    store_sides(address(bounds), sides)
