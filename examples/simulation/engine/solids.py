"""Solids: turned, extruded and swept ones, and boxes. They share vertices: no edge is open."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.outlines import Outline
from engine.part import Part

__all__ = ["block", "prism", "revolved", "tube"]

#: Triangles of a box; vertex i is at the high end of axis k where bit k of i is set.
BOX_FACES = np.array(
    [
        [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5],  # low x, high x
        [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3],  # low y, high y
        [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6],  # low z, high z
    ],
    np.int32,
)  # fmt: skip

#: Row i says on which axes vertex i of a box is at the high end.
BOX_CORNERS = (np.arange(8)[:, None] >> np.arange(3)) & 1 == 1


def block(low: ArrayLike, high: ArrayLike) -> Part:
    """Make an axis-parallel box from opposite corners: 12 triangles, closed."""
    corners = np.where(BOX_CORNERS, np.asarray(high, np.float32), np.asarray(low, np.float32))
    return Part(corners, BOX_FACES)


def revolved(profile: Outline, segments: int) -> Part:
    """Revolve a profile about the y axis; closed.

    Parameters
    ----------
    profile : Outline
        Points (radius, y). One that begins and ends on the axis, and leads upwards, makes a
        solid; a closed one that does not touch the axis makes a ring.
    segments : int
        Vertices per circle: 2 segments triangles for each point off the axis.
    """
    points, normals = profile
    solid = points[0, 0] == 0.0
    inner = slice(1, -1) if solid else slice(None)
    angle = np.arange(segments) * (2 * np.pi / segments)
    around = np.stack([np.cos(angle), np.ones(segments), np.sin(angle)], axis=1)[None]
    rings = points[inner][:, [0, 1, 0]][:, None] * around
    poles = np.array([[0.0, points[0, 1], 0.0], [0.0, points[-1, 1], 0.0]]) if solid else None
    if normals is None:
        return _stacked(rings, None, poles)
    return _stacked(rings, normals[inner][:, [0, 1, 0]][:, None] * around, poles)


def prism(
    outline: Outline, depth: float, bevel: float = 0.0, opening: Outline | None = None
) -> Part:
    """Extrude an outline from z = 0 to `depth`; closed.

    Parameters
    ----------
    outline : Outline
        K points (x, y). All of them must be visible from the origin, unless there is an opening.
    depth : float
    bevel : float
        Width of the bevels at both ends; they need normals.
    opening : Outline, optional
        Hole through the prism, with as many points, in the same directions.

    Returns
    -------
    Part
        4 K triangles; twice as many with bevels, twice as many again with an opening.
    """
    rings, normals = _walls(outline, depth, bevel)
    if opening is None:
        poles = np.array([[0.0, 0.0, depth], [0.0, 0.0, 0.0]])
        return _stacked(rings, normals, poles)
    inside, inward = _walls(opening, depth, -bevel)
    rings = np.concatenate([rings, inside[::-1]])
    if normals is None or inward is None:
        return _stacked(rings, None)
    inward[:, :, :2] *= -1.0
    return _stacked(rings, np.concatenate([normals, inward[::-1]]))


def tube(
    path: ArrayLike,
    radius: float,
    segments: int,
    *,
    bore: float = 0.0,
    bevel: float = 0.0,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Part:
    """Sweep a disc or an annulus along a path, with flat ends; closed.

    Parameters
    ----------
    path : array_like of shape (K, 3), float
        At least two points.
    radius : float
        Less than the path's radius of curvature.
    segments : int
        Vertices per circle: 2 K segments triangles, with bevels 2 (K + 2) segments; twice as
        many with a bore.
    bore : float
        Inner radius; 0 makes a rod.
    bevel : float
        Width of the bevels at the ends; 0 leaves all faces flat.
    up : tuple of float
        Any direction to which no part of the path is parallel.
    """
    center = np.asarray(path, np.float64)
    tangent = np.gradient(center, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    # The rows of a wall: its centres, and the tangents there.
    middle, along = center, tangent
    if bevel:
        ends = center[[0, -1]] + bevel * np.array([[1.0], [-1.0]]) * tangent[[0, -1]]
        middle = np.concatenate([center[:1], ends[:1], center[1:-1], ends[1:], center[-1:]])
        along = np.concatenate([tangent[:1], tangent, tangent[-1:]])
    across = np.cross(up, along)
    across /= np.linalg.norm(across, axis=1)[:, None]
    angle = np.arange(segments)[None, :, None] * (2 * np.pi / segments)
    spokes = np.cos(angle) * across[:, None] - np.sin(angle) * np.cross(along, across)[:, None]

    def wall(size: float, inset: float) -> NDArray[np.float64]:
        sizes = np.full((len(middle), 1, 1), size)
        sizes[[0, -1]] -= inset
        return middle[:, None] + sizes * spokes

    rings, normals = wall(radius, bevel), spokes.copy()
    normals[0], normals[-1] = -tangent[0], tangent[-1]
    poles = center[[0, -1]]
    if bore:
        inward = -spokes[::-1]
        inward[0], inward[-1] = tangent[-1], -tangent[0]
        rings = np.concatenate([rings, wall(bore, -bevel)[::-1]])
        normals = np.concatenate([normals, inward])
    return _stacked(rings, normals if bevel else None, None if bore else poles)


def _quads(*corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Split quadrilaterals, given by four arrays of vertex indices, into triangles."""
    p, q, r, s = (corner.reshape(-1) for corner in corners)
    return np.stack([p, q, r, p, r, s], axis=1).reshape(-1, 3)


def _capped_faces(ring_count: int, segments: int) -> NDArray[np.int32]:
    """Join rings, and their ends to a first and a last vertex."""
    ids = 1 + np.arange(ring_count * segments, dtype=np.int32).reshape(ring_count, segments)
    after = np.roll(ids, -1, axis=1)
    low = np.zeros(segments, np.int32)
    high = np.full(segments, ring_count * segments + 1, np.int32)
    bottom = np.stack([low, ids[0], after[0]], axis=1)
    sides = _quads(ids[:-1], ids[1:], after[1:], after[:-1])
    top = np.stack([high, after[-1], ids[-1]], axis=1)
    return np.concatenate([bottom, sides, top]).astype(np.int32)


def _walls(
    outline: Outline, depth: float, bevel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Place an outline at the ends of a prism, and around both of its bevels."""

    def raised(points: NDArray[np.float64], z: float) -> NDArray[np.float64]:
        return np.concatenate([points, np.full((len(points), 1), z)], axis=1)

    points, normals = outline
    if normals is None:
        return np.stack([raised(points, depth), raised(points, 0.0)]), None
    side, inset, cut = raised(normals, 0.0), outline.enlarged(-bevel).points, abs(bevel)
    up = np.broadcast_to([0.0, 0.0, 1.0], side.shape)
    rings = [
        *(raised(inset, depth), raised(points, depth - cut)),
        *(raised(points, cut), raised(inset, 0.0)),
    ]
    return np.stack(rings), np.stack([up, side, side, -up])


def _stacked(
    rings: NDArray[np.float64],
    normals: NDArray[np.float64] | None,
    poles: NDArray[np.float64] | None = None,
) -> Part:
    """Join rings of vertices, each to the next, and close the ends.

    Parameters
    ----------
    rings : ndarray of shape (R, N, 3), float64
        Clockwise, seen from the last of them.
    normals : ndarray of shape (R, N, 3), float64, or None
    poles : ndarray of shape (2, 3), float64, or None
        Centres of the end faces; None joins the last ring to the first.
    """
    ring_count, segments = rings.shape[:2]
    vertices = rings.reshape(-1, 3)
    slopes = None if normals is None else normals.reshape(-1, 3)
    if poles is None:
        ids = np.arange(len(vertices), dtype=np.int32).reshape(ring_count, segments)
        above, after = np.roll(ids, -1, axis=0), np.roll(ids, -1, axis=1)
        faces = _quads(ids, above, np.roll(above, -1, axis=1), after)
    else:
        faces = _capped_faces(ring_count, segments)
        vertices = np.concatenate([poles[:1], vertices, poles[1:]])
        if slopes is not None:
            ends = slopes[[0, -1]]
            slopes = np.concatenate([ends[:1], slopes, ends[1:]])
    return Part(
        vertices.astype(np.float32), faces, None if slopes is None else slopes.astype(np.float32)
    )
