"""The leaf block: four triangles side by side. Its layout, its writer and its test.

The leaves of the BVH, the kd-tree and the graph are rows of blocks. Single rays are
tested against them here and nowhere else, on the CPU and on CUDA, on both machines. Packets and
groups (`structures.bvh`) read the same blocks with code of their own: their lanes are 16 rays
against one triangle, or a block is tested against many rays at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, SHIFT_32, TWO_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    count_trailing_zeros,
    f32x4,
    i32x4,
    load,
    mask_bits,
    popcount,
    scratch,
    store,
)
from raystream.jit.threads import parallel_for
from raystream.jit.views import view
from raystream.kernels.aligned import aligned_array
from raystream.kernels.ray import component
from raystream.kernels.search import is_full, offer
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle_lanes import (
    extents,
    intersect_lanes,
    plane_distance,
    planes_along,
    shear_vertices,
    signs_agree,
    slab_interval,
)

#: Triangles in a block. It holds vectors of four numbers, one per triangle: x, y, z of vertex 0,
#: of vertex 1 and of vertex 2; then `prim_id`, as the bits of an int32. Unused lanes have
#: prim_id -1 and coordinates NaN; they are the last ones of their block.
BLOCK_SIZE = 4

#: A block: coordinates by corner and axis, then prim_ids; and the same with a lane index.
_BLOCK = np.dtype([("corners", "f4", (3, 3, 4)), ("prim_ids", "i4", (4, 1))])
Block = view(_BLOCK)
BlockLanes = view([("corners", "f4", (3, 3, 4, 1)), ("prim_ids", "i4", (4, 1))])

#: Hits of a block's triangles; and the same with a lane index.
HITS = np.dtype([("t", "f4", 4), ("u", "f4", 4), ("v", "f4", 4)])
Hits = view(HITS)
HitLanes = view([("t", "f4", (4, 1)), ("u", "f4", (4, 1)), ("v", "f4", (4, 1))])

#: Size of a block.
BLOCK_BYTES = _BLOCK.itemsize
BLOCK_FLOATS = BLOCK_BYTES // 4

#: Bytes of a block and of its coordinates along one axis; offsets of its second and third corners
#: and of its prim_ids.
BLOCK = np.uint64(BLOCK_BYTES)
AXIS = np.uint64(16)
SECOND = np.uint64(48)
THIRD = np.uint64(96)
PRIM_IDS = np.uint64(144)

#: Stride of the array of all triangles' corners.
TRIANGLE_BYTES = np.uint64(36)

#: Blocks that one call of `_fill_blocks` writes.
_CHUNK = 1 << 14

_NAN = np.float32(np.nan)
_LANES = np.uint64(BLOCK_SIZE)

# Where `test_block` leaves u and v, after t.
_U = np.uint64(16)
_V = np.uint64(32)


# Writing


@device
def clear_block(block):
    """Write a block without triangles."""
    for k in range(np.uint64(9)):
        store(block + k * AXIS, f32x4(_NAN))
    store(block + PRIM_IDS, i32x4(np.int32(-1)))


@device
def write_corners(block, lane, prim_id, corners):
    """Copy the corners of a triangle to a lane of a block."""
    at, corner = block + (lane << SHIFT_32), corners + np.uint64(prim_id) * TRIANGLE_BYTES
    for k in range(np.uint64(9)):
        store(at + k * AXIS, load(np.float32, corner + (k << SHIFT_32)))


@device
def write_triangle(block, lane, prim_id, corners):
    """Write a triangle to a lane of a block.

    Parameters
    ----------
    block : uint64
        Address.
    lane : uint64
        0 to 3.
    prim_id : int32
    corners : uint64
        Address of the corners of all triangles, `TRIANGLE_BYTES` each.
    """
    write_corners(block, lane, prim_id, corners)
    store(block + PRIM_IDS + (lane << SHIFT_32), prim_id)


@device
def write_block(block, prim_ids, corners):
    """Write the triangles whose four prim_ids are at an address; -1 for an unused lane."""
    clear_block(block)
    for lane in range(_LANES):
        prim_id = load(np.int32, prim_ids + (lane << SHIFT_32))
        if prim_id >= np.int32(0):
            write_triangle(block, lane, prim_id, corners)


@kernel
def _fill_blocks(begin, end, prim_ids, corners, blocks):
    """Write blocks begin to end.

    Parameters
    ----------
    begin, end : int
    prim_ids : ndarray of shape (B, 4), int32
    corners : ndarray of shape (F, 3, 3), float32
    blocks : ndarray of shape (B, 40), float32
    """
    id_at, corner_at, block_at = address(prim_ids), address(corners), address(blocks)
    for block in range(np.uint64(begin), np.uint64(end)):
        write_block(block_at + block * BLOCK, id_at + block * AXIS, corner_at)


def filled_blocks(prim_ids: NDArray[np.int32], corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Make the blocks of triangles, on all threads.

    Parameters
    ----------
    prim_ids : ndarray of shape (B, 4), int32
        The triangles of each block; -1 for an unused lane.
    corners : ndarray of shape (F, 3, 3), float32
        Of all triangles.

    Returns
    -------
    ndarray of shape (B, 40), float32
        Aligned to a cache line.
    """
    blocks = aligned_array(len(prim_ids), BLOCK_FLOATS)

    def fill(begin: int, end: int) -> None:
        _fill_blocks(begin, end, prim_ids, corners, blocks)

    parallel_for(fill, len(prim_ids), _CHUNK)
    return blocks


# Reading


@device
def blocks_end(block, count):
    """Address after the blocks of `count` triangles that begin at `block`."""
    return block + ((count + _LANES - ONE_U64) >> TWO_U64) * BLOCK


@device
def triangle_count(prim_ids):
    """Triangles in a block, by the address of its prim_ids."""
    return popcount(mask_bits(load(i32x4, prim_ids) >= i32x4(np.int32(0))))


class BlockRay(NamedTuple):
    """A ray as the block test takes it; triples are in the order of its frame.

    Attributes
    ----------
    axis : triple of uint64
        Byte offset of each axis in a corner.
    inv, near, far : triple of float32
        Reciprocal direction, and the constants of the slab distances.
    origin, direction, shear : triple of float32
    """

    axis: tuple[np.uint64, np.uint64, np.uint64]
    inv: tuple[np.float32, np.float32, np.float32]
    near: tuple[np.float32, np.float32, np.float32]
    far: tuple[np.float32, np.float32, np.float32]
    origin: tuple[np.float32, np.float32, np.float32]
    direction: tuple[np.float32, np.float32, np.float32]
    shear: tuple[np.float32, np.float32, np.float32]


@device
def _in_frame(ray, x, y, z):
    return component(ray.kx, x, y, z), component(ray.ky, x, y, z), component(ray.kz, x, y, z)


@device
def block_ray(ray):
    """The `BlockRay` of a `kernels.ray.Ray`."""
    return BlockRay(
        (ray.kx * AXIS, ray.ky * AXIS, ray.kz * AXIS),
        (
            component(ray.kx, ray.inv_x, ray.inv_y, ray.inv_z),
            component(ray.ky, ray.inv_x, ray.inv_y, ray.inv_z),
            ray.sz,
        ),
        _in_frame(ray, ray.near_x, ray.near_y, ray.near_z),
        _in_frame(ray, ray.far_x, ray.far_y, ray.far_z),
        (ray.ox, ray.oy, ray.oz),
        (ray.dx, ray.dy, ray.dz),
        (ray.sx, ray.sy, ray.sz),
    )


@device
def _corner(at, axis):
    return load(f32x4, at + axis[0]), load(f32x4, at + axis[1]), load(f32x4, at + axis[2])


@device
def test_block(block, ray, t_min, t_far, surfaces, lanes):
    """Test the four triangles of a block against a ray.

    Parameters
    ----------
    block : uint64
        Address.
    ray : BlockRay
    t_min, t_far : float32
        Closed interval in which a hit is wanted.
    surfaces : bool
        The rule at edges and vertices, see `kernels.triangle.intersect`.
    lanes : uint64
        Address of 48 bytes: t, u and v of the lanes that are hit are written.

    Returns
    -------
    uint64
        Bits of the lanes that are hit.
    """
    a = _corner(block, ray.axis)
    b = _corner(block + SECOND, ray.axis)
    c = _corner(block + THIRD, ray.axis)
    o, s = ray.origin, ray.shear
    sheared = shear_vertices(a, b, c, o, (s[0], s[1]))
    candidates = signs_agree(sheared)
    if not any_lane(candidates):
        return ZERO_U64
    back = ray.inv[0] < ZERO_F32, ray.inv[1] < ZERO_F32, ray.inv[2] < ZERO_F32
    box = slab_interval(planes_along(*extents(a, b, c), back), ray.inv, ray.near, ray.far)
    plane, then = ((a, b, c, o, ray.direction), plane_distance), ((lanes,), _store_hits)
    return intersect_lanes(sheared, candidates, box, (t_min, t_far), plane, surfaces, then)


@device
def _store_hits(hit, t, u, v, lanes):
    store(lanes, t)
    store(lanes + _U, u)
    store(lanes + _V, v)
    return mask_bits(hit)


@device
def intersect_block(block, ray, search, t_in, t_out):
    """Test the triangles of a block against a ray, and offer their hits to a search.

    Parameters
    ----------
    block : uint64
        Address.
    ray : BlockRay
    search : Search
    t_in, t_out : float32
        A hit counts where t_in <= t < t_out: the part of the ray in the leaf, for structures
        whose leaves do not overlap; from ``search.t_min`` to inf for others.

    Returns
    -------
    Search
    """
    lanes = scratch(64)
    bits = test_block(block, ray, t_in, min(search.t_far, t_out), search.goal.surfaces, lanes)
    while bits != ZERO_U64:
        at = count_trailing_zeros(bits) << SHIFT_32
        bits &= bits - ONE_U64
        t = load(np.float32, lanes + at)
        if t < t_out:  # else the next leaf's
            u, v = load(np.float32, lanes + (_U + at)), load(np.float32, lanes + (_V + at))
            search = offer(search, t, u, v, load(np.int32, block + (PRIM_IDS + at)))
            if is_full(search):
                break
    return search


@device
def search_blocks(block, end, ray, search, t_in, t_out):
    """Test the blocks of a leaf, until the search is full; see `intersect_block`."""
    while block != end:
        add_to(search.counters, TESTS, triangle_count(block + PRIM_IDS))
        search = intersect_block(block, ray, search, t_in, t_out)
        if is_full(search):
            break
        block += BLOCK
    return search
