"""Find the rows of an image in a list of its rays, and form packets of 16 rows.

People flatten images, and leave out pixels: rays from visible points follow each other in the
order of the pixels, without those that missed, so that rows have different lengths. Rays of a row
lie next to each other, and a row starts near the start of the row above. So a ray j starts a row
if it is near the row's start s, and far from the ray before it: if

    closeness(j) = |ray j - ray s|**2 / |ray j - ray j-1|**2

is small, where differences of origins are relative to the scene's size, and those of directions to
their length. Rows are found one after another, each first where the length of the one above it
says. If the first rows have one length, and rows at some places of the batch begin where it says,
it is the image's width, and the others are not looked at. Whatever is found, each ray is in
exactly one packet: a wrong guess costs time only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x16,
    load,
    mask_bits,
    narrow,
    reduce_min,
    select,
    store,
)
from raystream.kernels.aligned import array_address
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, load_direction, load_origin
from raystream.structures.bvh.packets.load import read_lanes
from raystream.structures.bvh.packets.rays import (
    GROUPS,
    PACKET_RAYS,
    PacketOrder,
    group_rows,
)

#: Rows of smaller batches are not looked for: it takes some ten microseconds.
LEAST_RAYS = 8192

#: Rays beyond the start of the first row in which the second one is searched for: images are not
#: wider.
_WIDEST = 16384

#: The next row is looked for one block of 16 rays before and behind its likely start, then
#: among all rays from a quarter to twice the row's length away.
_NEARBY = np.uint64(1)

#: `closeness` of a ray that starts a row without doubt, and with some.
_CLEAR = np.float32(0.02)
_DOUBTFUL = np.float32(0.25)

#: Rows of one length after which the batch is taken for an image of that width, and places where
#: this is checked.
_SAME_ROWS = np.uint64(8)
_CHECKS = np.uint64(16)

#: Rows of a batch that are this short on average are tiles, or none, which would take long to find.
_MANY_ROWS = np.uint64(256)
_SHORT_ROW = np.uint64(40)

#: Packets at which orders are compared.
_SAMPLES = 16

#: Tiles are used if they are this much smaller than packets of consecutive rays. (A tile of 16 x 16
#: rays is 0.17 times as long as 256 rays in a row.)
_WORTHWHILE = 0.7

_TINY = np.float64(1e-30)
_EIGHT, _LANES = np.uint64(8), np.uint64(16)
_COUNT_BITS = np.uint64(5)


class Cut(NamedTuple):
    """A place where a batch may be divided: whole packets have the rays before it.

    Attributes
    ----------
    packet, ray : int
    """

    packet: int
    ray: int


class BatchOrder(NamedTuple):
    """The packets of a batch, and where it may be divided.

    Attributes
    ----------
    packets : PacketOrder
    bands : ndarray of shape (rows of packets + 1, 2), int64, or None
        The first packet and ray of each row of packets, where the width does not say it.
    kept : object
        To be kept alive while the order is used.
    """

    packets: PacketOrder
    bands: NDArray[np.int64] | None = None
    kept: object = None

    def cut(self, ray: int) -> Cut:
        """The last cut that is not behind a ray, or the end."""
        order = self.packets
        if ray >= int(order.ray_count):
            return Cut(order.packet_count, int(order.ray_count))
        if self.bands is not None:
            at = int(np.searchsorted(self.bands[:, 1], ray, side="right")) - 1
            return Cut(*self.bands[at].tolist())
        side, width = int(GROUPS), int(order.width)
        if width == 0:
            packet = ray // PACKET_RAYS
            return Cut(packet, packet * PACKET_RAYS)
        band = ray // (width * side)
        return Cut(band * -(-width // side), band * width * side)


def find_order(source: RaySource, count: int, frame: SceneFrame) -> BatchOrder:
    """The packets of a flat batch of coherent rays.

    Parameters
    ----------
    source : RaySource
        Packed.
    count : int
        Number of rays.
    frame : SceneFrame

    Returns
    -------
    BatchOrder
        Tiles of an image's rows if they are found, else 256 rays in a row.
    """
    straight = BatchOrder(PacketOrder.of_rows(0, count))
    if count < LEAST_RAYS:
        return straight
    starts = np.empty(count // 16 + 2, np.uint64)
    row_count, width = find_starts(source, count, frame, array_address(starts), len(starts) - 1)
    if width >= 16:
        order = BatchOrder(PacketOrder.of_rows(width, count))
    elif row_count >= 2:
        starts[row_count] = count
        order = order_of(starts[: row_count + 1])
    else:
        return straight
    # Rows end with groups of fewer rays, and packets of rows of different lengths have gaps.
    gaps = order.packets.packet_count / straight.packets.packet_count
    size = _extent(order.packets, source, frame)
    if size * gaps <= _WORTHWHILE * _extent(straight.packets, source, frame):
        return order
    return straight


def order_of(starts: NDArray[np.uint64]) -> BatchOrder:
    """Tiles of rows of different lengths.

    Parameters
    ----------
    starts : ndarray of shape (rows + 1,), uint64
        The index of each row's first ray, and the number of rays.
    """
    lengths = np.diff(starts)
    side = int(GROUPS)
    first_rows = np.arange(0, len(lengths), side)
    across = (np.maximum.reduceat(lengths, first_rows) + _LANES - ONE_U64) // _LANES
    bands = np.zeros((len(first_rows) + 1, 2), np.int64)
    np.cumsum(across, out=bands[1:, 0])
    bands[:-1, 1], bands[-1, 1] = starts[first_rows], starts[-1]
    packet_count = int(bands[-1, 0])
    table = np.empty(max(packet_count * side, 1), np.uint64)
    fill_table(len(lengths), array_address(starts), array_address(table))
    at = np.uint64(array_address(table))
    packets = PacketOrder(ZERO_U64, np.uint64(starts[-1]), packet_count, at)
    return BatchOrder(packets, bands, table)


def _extent(order: PacketOrder, source: RaySource, frame: SceneFrame) -> float:
    """Mean extent of a sample of packets."""
    total, used = sum_extents(order.packet_count, source, order, frame)
    return float(total) / max(used, 1)


@device
def _ray_at(source, i):
    return load_origin(source, i) + load_direction(source, i)


@device
def _rays_at(source, first):
    rays = read_lanes(source, first, f32x16, np.float32)
    return rays.origin + rays.direction


@device
def _square_distance(a, b, weights):
    """Weighted square of the distance of two rays, or of 16 from 16."""
    ax, ay, az, adx, ady, adz = a
    bx, by, bz, bdx, bdy, bdz = b
    x, y, z = ax - bx, ay - by, az - bz
    dx, dy, dz = adx - bdx, ady - bdy, adz - bdz
    return (x * x + y * y + z * z) * weights[0] + (dx * dx + dy * dy + dz * dz) * weights[1]


@device
def _weights(source, frame):
    """Weights of the squares of differences of origins and of directions."""
    low, high = frame.low, frame.high
    size = np.float64(max(high[0] - low[0], high[1] - low[1], high[2] - low[2]))
    dx, dy, dz = load_direction(source, ZERO_U64)
    length = dx * dx + dy * dy + dz * dz
    origin_weight = frame.scale * frame.scale / max(size * size, _TINY)
    return origin_weight, np.float64(1.0) / max(length, _TINY)


@device
def _best_of(source, start, first, end, count, weights):
    """The ray from first to end that most probably starts the row after that from `start`.

    Blocks of 16 are examined, some rays beyond the end too.

    Returns
    -------
    index : uint64
    closeness : float32
        inf if there is none.
    """
    above = _ray_at(source, start)
    best, closeness, best_score = ZERO_U64, INF_F32, INF_F32
    at = max(first, ONE_U64)
    while at < end and at + _LANES <= count:
        rays, before = _rays_at(source, at), _rays_at(source, at - ONE_U64)
        near = narrow(_square_distance(rays, above, weights))
        far = narrow(_square_distance(rays, before, weights) + _TINY)
        ratio = near / far
        ratio = select(ratio == ratio, ratio, f32x16(INF_F32))
        least = reduce_min(ratio)
        score = least * np.float32(at - start + _LANES)
        if score < best_score:
            best_score, closeness = score, least
            best = at + count_trailing_zeros(mask_bits(ratio == least))
        at += _LANES
    return best, closeness


@device
def _is_row(source, start, width, count, weights):
    """Whether rows begin at an index and a width later."""
    best, closeness = _best_of(source, start, start + width - _EIGHT, start + width, count, weights)
    return best == start + width and closeness <= _DOUBTFUL


@kernel
def find_starts(source, ray_count, frame, starts, most):
    """Find where an image's rows start in a batch of its rays.

    Parameters
    ----------
    source : RaySource
        Packed.
    ray_count : int
    frame : SceneFrame
    starts : int
        Address of a uint64 per row: written.
    most : int
        Most rows.

    Returns
    -------
    row_count : int
        0 if none were found, or all have one length.
    width : int
        The rows' length if all have one, else 0.
    """
    count, most_rows = np.uint64(ray_count), np.uint64(most)
    weights = _weights(source, frame)
    start, rows, same, doubtful, length = ZERO_U64, ZERO_U64, ZERO_U64, ZERO_U64, ZERO_U64
    store(np.uint64(starts), ZERO_U64)
    while True:
        rows += ONE_U64
        if rows >= most_rows or doubtful > _EIGHT + rows // np.uint64(4):
            return 0, 0
        if rows > _MANY_ROWS and start < rows * _SHORT_ROW:
            return 0, 0
        found, closeness = ZERO_U64, INF_F32
        if length != ZERO_U64 and rows % _EIGHT != ZERO_U64:
            likely = start + length
            first = max(likely, _NEARBY * _LANES + start + ONE_U64) - _NEARBY * _LANES
            found, closeness = _best_of(
                source, start, first, likely + _NEARBY * _LANES, count, weights
            )
        if closeness > _CLEAR:
            first, end = start + ONE_U64 + length // np.uint64(4), start + np.uint64(_WIDEST)
            if length != ZERO_U64:
                end = start + length + length + np.uint64(64)
            found, closeness = _best_of(source, start, first, end, count, weights)
        if closeness > _DOUBTFUL:
            doubtful += ONE_U64
            if closeness == INF_F32 or start + length + length // np.uint64(4) >= count:
                break  # this is the last row
        same = same + ONE_U64 if found - start == length and closeness <= _DOUBTFUL else ZERO_U64
        length = found - start
        start = found
        store(np.uint64(starts) + rows * _EIGHT, start)
        if same == _SAME_ROWS and start == rows * length:
            is_image = True
            whole = count // length - ONE_U64
            for k in range(_CHECKS):
                if not _is_row(source, k * whole // _CHECKS * length, length, count, weights):
                    is_image = False
            if is_image:
                return 0, np.int64(length)
    return np.int64(rows), 0


@kernel
def fill_table(row_count, starts, table):
    """Write the groups of tiles of 16 rows; see `PacketOrder`.

    Parameters
    ----------
    row_count : int
    starts : int
        Address of a uint64 per row, the index of its first ray, and of the number of rays.
    table : int
        Address of a uint64 for each group: written.
    """
    rows, to = np.uint64(row_count), np.uint64(table)
    for band in range(ZERO_U64, rows, GROUPS):
        band_end = min(band + GROUPS, rows)
        longest = ZERO_U64
        for row in range(band, band_end):
            at = np.uint64(starts) + row * _EIGHT
            longest = max(longest, load(np.uint64, at + _EIGHT) - load(np.uint64, at))
        for x in range(ZERO_U64, longest, _LANES):
            for row in range(band, band + GROUPS):
                entry = ZERO_U64
                if row < band_end:
                    at = np.uint64(starts) + row * _EIGHT
                    first, end = load(np.uint64, at) + x, load(np.uint64, at + _EIGHT)
                    if first < end:
                        entry = first << _COUNT_BITS | min(end - first, _LANES)
                store(to, entry)
                to += _EIGHT


@kernel
def sum_extents(packet_count, source, order, frame):
    """Sum of the extents of a sample of packets, and their number, to compare orders.

    Parameters
    ----------
    packet_count : int
    source : RaySource
    order : PacketOrder
    frame : SceneFrame
    """
    weights = _weights(source, frame)
    total, used = np.float64(0.0), 0
    for sample in range(_SAMPLES):
        number = np.uint64((sample + sample + 1) * packet_count // (_SAMPLES + _SAMPLES))
        begin, count, g = ZERO_U64, ZERO_U64, ZERO_U64
        # The first group that has rays: where rows end, groups are empty, and may be past the end.
        while g < GROUPS and count == ZERO_U64:
            begin, count = group_rows(order, number, g)
            g += ONE_U64
        if count == ZERO_U64:
            continue
        a = _ray_at(source, begin)
        farthest = _square_distance(_ray_at(source, begin + count - ONE_U64), a, weights)
        for other in range(g, GROUPS):
            begin, count = group_rows(order, number, other)
            if count != ZERO_U64:
                first_distance = _square_distance(_ray_at(source, begin), a, weights)
                end_distance = _square_distance(
                    _ray_at(source, begin + count - ONE_U64), a, weights
                )
                farthest = max(farthest, first_distance, end_distance)
        total += np.sqrt(farthest)
        used += 1
    return total, used
