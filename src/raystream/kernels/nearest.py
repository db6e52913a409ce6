"""The search for the triangles nearest to a point: the few best so far, in rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.jit.views import view
from raystream.kernels.point_triangle import foot_of, triangle_features

#: A triangle that was found: its squared distance, prim_id, and where its corners are: address
#: of the first number, and bytes from a number to the next.
ROW = np.dtype([("squared", "f8"), ("place", "u8"), ("prim_id", "i4"), ("stride", "i4")])
NearestRow = view(ROW)


#: prim_id after all others, for a limit without a triangle.
_LAST = np.int32(2**31 - 1)

#: Below infinity, which empty lanes have.
_MOST = np.float64(np.finfo(np.float64).max)


class NearestSearch(NamedTuple):
    """The nearest triangles so far, by squared distance, then prim_id.

    Attributes
    ----------
    rows : uint64
        Address of `capacity` rows, of which `found_count` are used, in order.
    capacity, found_count : uint64
    limit : float64
        Squared distance beyond which no triangle is wanted.
    limit_id : int32
        At this distance only lower prim_ids are wanted.
    """

    rows: np.uint64
    capacity: np.uint64
    found_count: np.uint64
    limit: np.float64
    limit_id: np.int32


@device
def begin_nearest(rows, capacity, limit):
    """Begin a search for up to `capacity` triangles within a squared distance, inclusive."""
    return NearestSearch(rows, capacity, ZERO_U64, min(limit, _MOST), _LAST)


@device
def is_wanted(search, squared, prim_id):
    """Whether a triangle would be kept."""
    return squared < search.limit or (squared == search.limit and prim_id < search.limit_id)


@device
def _is_before(row, squared, prim_id):
    return row.squared < squared or (row.squared == squared and row.prim_id < prim_id)


@device
def offer_nearest(search, squared, prim_id, place, stride):
    """Keep a wanted triangle, unless it has been kept already.

    Parameters
    ----------
    search : NearestSearch
    squared : float64
    prim_id : int32
    place : uint64
    stride : int32
        See `ROW`.

    Returns
    -------
    NearestSearch
    """
    at = search.found_count
    while at != ZERO_U64 and not _is_before(
        NearestRow(search.rows, at - ONE_U64), squared, prim_id
    ):
        at -= ONE_U64
    if at != search.found_count and NearestRow(search.rows, at).prim_id == prim_id:
        return search
    count = min(search.found_count + ONE_U64, search.capacity)
    move = count - ONE_U64
    while move != at:
        source, target = NearestRow(search.rows, move - ONE_U64), NearestRow(search.rows, move)
        target.squared, target.place = source.squared, source.place
        target.prim_id, target.stride = source.prim_id, source.stride
        move -= ONE_U64
    row = NearestRow(search.rows, at)
    row.squared, row.place, row.prim_id, row.stride = squared, place, prim_id, stride
    limit, limit_id = search.limit, search.limit_id
    if count == search.capacity:
        last = NearestRow(search.rows, count - ONE_U64)
        limit, limit_id = last.squared, last.prim_id
    return NearestSearch(search.rows, search.capacity, count, limit, limit_id)


@device
def _number(place, stride, k):
    return np.float64(load(np.float32, place + np.uint64(stride) * np.uint64(k)))


@device
def corners_at(place, stride):
    """The corners of a triangle, see `ROW`: three triples of float64."""
    return (
        (_number(place, stride, 0), _number(place, stride, 1), _number(place, stride, 2)),
        (_number(place, stride, 3), _number(place, stride, 4), _number(place, stride, 5)),
        (_number(place, stride, 6), _number(place, stride, 7), _number(place, stride, 8)),
    )


@device
def offer_triangle(search, point, prim_id, place, stride):
    """Offer a triangle, see `ROW`, to the search of a point; returns the search."""
    a, b, c = corners_at(place, stride)
    return offer_squared(search, triangle_features(point, a, b, c).squared, prim_id, place, stride)


@device
def offer_squared(search, squared, prim_id, place, stride):
    """Offer a primitive at a squared distance, see `ROW`; returns the search."""
    if is_wanted(search, squared, prim_id):
        search = offer_nearest(search, squared, prim_id, place, stride)
    return search


class RowShape(NamedTuple):
    """What the primitives of rows are: how far a point is from them.

    Attributes
    ----------
    measure : device function
        ``measure(view, frame, point, row)``: the squared distance of a `NearestRow`, with the bits
        that the search had.
    foot : device function
        ``foot(view, frame, point, row)``: the nearest point, a `point_triangle.Foot`.
    """

    measure: Callable[..., Any]
    foot: Callable[..., Any]


def triangle_rows(corners: Callable[..., Any]) -> RowShape:
    """The shape of triangles; ``corners(view, frame, row)`` are three triples of float64."""

    @device
    def measure(view, frame, point, row):
        a, b, c = corners(view, frame, row)
        return triangle_features(point, a, b, c).squared

    @device
    def foot(view, frame, point, row):
        a, b, c = corners(view, frame, row)
        return foot_of(triangle_features(point, a, b, c), a, b, c)

    return RowShape(measure, foot)


@device
def _corners(view, frame, row):
    return corners_at(row.place, row.stride)


#: Triangles in float32, local frame.
TRIANGLES = triangle_rows(_corners)


def offer_again(measure: Callable[..., Any]) -> Callable[..., Any]:
    """Make the function that offers what another search found: a good limit from the start.

    Parameters
    ----------
    measure : device function
        See `RowShape`.

    Returns
    -------
    device function
        ``offer(search, view, frame, point, others, count) -> search``. `others` is the address of
        `count` rows, not the search's own.
    """

    @device
    def offer(search, view, frame, point, others, count):
        for k in range(count):
            row = NearestRow(others, k)
            squared = measure(view, frame, point, row)
            search = offer_squared(search, squared, row.prim_id, row.place, row.stride)
        return search

    return offer
