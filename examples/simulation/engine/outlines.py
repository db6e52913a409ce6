"""Outlines: polylines in a plane with normals, from which solids are turned and extruded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Outline", "arc", "bevelled", "circle", "gear", "hole", "hull"]

#: Edges that meet at a larger angle, radians, have a bevel between them.
CREASE = 0.6


class Outline(NamedTuple):
    """Points in a plane, with the solid at their left.

    Parameters
    ----------
    points : ndarray of shape (K, 2), float64
        A closed outline is counter-clockwise; its last point is joined to the first.
    normals : ndarray of shape (K, 2), float64, or None
        Unit normals that point to the right, away from the solid; None for flat faces.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64] | None

    def enlarged(self, distance: float) -> Outline:
        """Move each point along its normal; without normals, nothing moves."""
        if self.normals is None:
            return self
        return Outline(self.points + distance * self.normals, self.normals)


def bevelled(
    corners: ArrayLike, bevel: float, *, closed: bool = True, steps: int = 1, crease: float = CREASE
) -> Outline:
    """Connect corners by straight edges, and replace sharp corners by short edges.

    Parameters
    ----------
    corners : array_like of shape (K, 2), float
    bevel : float
        Length cut from both edges at a sharp corner, at most 0.3 of the edge. Each end has the
        normal of its edge, so that flat and round faces are shaded as such. 0 cuts nothing,
        and adds no normals.
    closed : bool
        Whether an edge leads from the last corner to the first.
    steps : int
        Divisions of each edge.
    crease : float
        Angle between edges, radians, from which a corner is sharp.
    """
    corner = np.asarray(corners, np.float64)
    ahead = np.roll(corner, -1, axis=0) - corner
    length = np.hypot(ahead[:, 0], ahead[:, 1])
    if not closed:
        ahead[-1], length[-1] = ahead[-2], length[-2]
    ahead /= length[:, None]
    behind, before = np.roll(ahead, 1, axis=0), np.roll(length, 1)
    if not closed:
        behind[0] = ahead[0]
    if not bevel:
        return _divided(Outline(corner, None), steps, closed)
    sharp = np.einsum("kc,kc->k", ahead, behind) < np.cos(crease)
    cut = np.where(sharp, np.minimum(bevel, 0.3 * length), 0.0)[:, None]
    cut_before = np.where(sharp, np.minimum(bevel, 0.3 * before), 0.0)[:, None]
    points = np.stack([corner - cut_before * behind, corner + cut * ahead], axis=1)
    mean = (ahead + behind) * (1.0 / np.hypot(*(ahead + behind).T))[:, None]
    flat = sharp[:, None]
    tangents = np.stack([np.where(flat, behind, mean), np.where(flat, ahead, mean)], axis=1)
    kept = np.stack([np.ones_like(sharp), sharp], axis=1)
    tangent = tangents[kept]
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    return _divided(Outline(points[kept], normals), steps, closed)


def arc(
    center: tuple[float, float], radius: float, start: float, end: float, count: int
) -> NDArray[np.float64]:
    """Return points on an arc, both ends included; angles in degrees."""
    angle = np.radians(np.linspace(start, end, count))
    return np.asarray(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def circle(radius: float, count: int, *, smooth: bool = True) -> Outline:
    """Make a circle about the origin."""
    angle = np.arange(count) * (2 * np.pi / count)
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Outline(radius * around, around if smooth else None)


def hole(outline: Outline, radius: float) -> Outline:
    """Make a polygon about the origin with a corner in the direction of each of the outline's.

    Parameters
    ----------
    outline : Outline
    radius : float
        Radius of a circle that fits into it.
    """
    around = outline.points / np.hypot(*outline.points.T)[:, None]
    widest = np.einsum("kc,kc->k", around, np.roll(around, -1, axis=0)).min()
    size = radius / np.sqrt((1.0 + widest) / 2)  # divided by the cosine of half that angle
    return Outline(size * around, None if outline.normals is None else around)


def gear(root: float, tip: float, teeth: int, *, smooth: bool = True) -> Outline:
    """Make a circle about the origin with trapezoidal teeth, four points each."""
    angle = (np.arange(teeth)[:, None] + np.array([0.0, 0.22, 0.5, 0.72])) * (2 * np.pi / teeth)
    angle = angle.ravel()
    radius = np.tile([root, tip, tip, root], teeth)[:, None]
    points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return bevelled(points, 1e-4 if smooth else 0.0, crease=np.pi)


def hull(
    radii: tuple[float, float], center: tuple[float, float], count: int, *, smooth: bool = True
) -> Outline:
    """Wrap a band around two circles, the first about the origin.

    Parameters
    ----------
    radii : tuple of float
    center : tuple of float
        Centre of the second circle.
    count : int
        Points on each circle.
    """
    offset = np.asarray(center)
    distance = float(np.hypot(*offset))
    heading = np.degrees(np.arctan2(offset[1], offset[0]))
    # The normal of a common tangent makes this angle with the line between the centres.
    tangent = np.degrees(np.arccos((radii[0] - radii[1]) / distance))
    angles = np.concatenate(
        [
            np.linspace(heading + tangent, heading + 360.0 - tangent, count),
            np.linspace(heading - tangent, heading + tangent, count),
        ]
    )
    around = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    second = np.arange(2 * count)[:, None] >= count
    points = np.where(second, offset + radii[1] * around, radii[0] * around)
    return Outline(points, around if smooth else None)


def _divided(outline: Outline, steps: int, closed: bool) -> Outline:
    """Divide each edge evenly."""
    if steps == 1:
        return outline

    def between(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        share = (np.arange(steps) / steps)[None, :, None]
        after = np.roll(rows, -1, axis=0)
        divided = (rows[:, None] * (1.0 - share) + after[:, None] * share).reshape(-1, 2)
        return divided if closed else divided[: (len(rows) - 1) * steps + 1]

    points = between(outline.points)
    if outline.normals is None:
        return Outline(points, None)
    normals = between(outline.normals)
    return Outline(points, normals / np.hypot(*normals.T)[:, None])
