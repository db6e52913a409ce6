"""Assembly: pieces of a machine, the meshes made of them, and how fine they are for a count."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import raystream as rs
from engine.outlines import Outline, bevelled, circle
from engine.part import Part, copies, merged
from engine.solids import block, prism, revolved, tube

__all__ = [
    "ALONG_X",
    "EXTRUDED_X",
    "UPRIGHT",
    "Detail",
    "Piece",
    "Solid",
    "assemble",
    "bar",
    "bolt",
    "extrude",
    "fitted",
    "piece",
    "sweep",
    "toward",
    "turn",
]

#: Turns a solid of revolution, whose axis is y, to the x axis.
ALONG_X = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

#: Turns a prism along z, with an outline (x, y), to one along x, with the outline (y, z).
EXTRUDED_X = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

#: Turns a prism along z to one along y.
UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

#: With less, pipes would not fit into their flanges.
LEAST_QUALITY = 6.0

#: Width of bevels, metres.
BEVEL = 0.0006


class Detail(NamedTuple):
    """How finely solids are divided.

    Parameters
    ----------
    quality : float
        Vertices on a circle of 40 mm radius; more than 0.
    smooth : bool
        Whether edges have bevels and vertices normals.
    """

    quality: float
    smooth: bool

    @property
    def bevel(self) -> float:
        """Width of bevels, metres; 0 if there are none."""
        return BEVEL if self.smooth else 0.0

    @property
    def steps(self) -> int:
        """Divisions of a straight edge of a profile."""
        return max(1, round(self.quality / 120))

    def around(self, radius: float) -> int:
        """Return the number of vertices on a circle of a radius in metres."""
        return max(4 if radius < 0.012 else 6, round(self.quality * (radius / 0.04) ** 0.5))

    def along(self, count: int) -> int:
        """Return the number of steps along a curve that has `count` by default."""
        return max(3, round(count * self.quality / 32))


class Solid(NamedTuple):
    """A closed shape that is not yet made: its number of triangles is known before."""

    triangles: int
    make: Callable[[], Part]


class Piece(NamedTuple):
    """Copies of a solid.

    Parameters
    ----------
    name : str
        The mesh they belong to; ``{}`` becomes the number of the copy, from 1.
    material : int
    solid : Solid
    matrices, offsets : ndarray of shape (N, 3, 3) and (N, 3), float64
    flipped : bool
        Whether it is a cavity of the mesh.
    spare : bool
        Whether some of the copies may be left out.
    """

    name: str
    material: int
    solid: Solid
    matrices: NDArray[np.float64]
    offsets: NDArray[np.float64]
    flipped: bool
    spare: bool

    @property
    def triangles(self) -> int:
        """Number of triangles of all copies."""
        return self.solid.triangles * len(self.offsets)


def piece(
    name: str,
    material: int,
    solid: Solid,
    offsets: ArrayLike = (0.0, 0.0, 0.0),
    matrices: ArrayLike | None = None,
    *,
    flipped: bool = False,
    spare: bool = False,
) -> Piece:
    """Place copies of a solid; a single offset, or a single matrix, serves all of them."""
    matrix = np.eye(3) if matrices is None else np.asarray(matrices, np.float64)
    offset = np.atleast_2d(np.asarray(offsets, np.float64))
    count = max(len(offset), len(matrix) if matrix.ndim == 3 else 1)
    return Piece(
        name,
        material,
        solid,
        np.broadcast_to(matrix, (count, 3, 3)),
        np.broadcast_to(offset, (count, 3)),
        flipped,
        spare,
    )


def turn(detail: Detail, corners: ArrayLike, *, plain: bool = False) -> Solid:
    """Revolve a profile (radius, y) about the y axis; `plain` ones have no bevels."""
    corner = np.asarray(corners, np.float64)
    solid = corner[0, 0] == 0.0
    profile = bevelled(
        corner,
        detail.bevel,
        closed=not solid,
        steps=detail.steps,
        crease=np.pi if plain else 0.6,
    )
    segments = detail.around(float(corner[:, 0].max()))
    rings = len(profile.points) - (2 if solid else 0)
    return Solid(2 * rings * segments, lambda: revolved(profile, segments))


def bar(detail: Detail, low: ArrayLike, high: ArrayLike) -> Solid:
    """Make a box."""
    first, last = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if not detail.smooth:
        return Solid(12, lambda: block(first, last))
    half, middle = (last - first) / 2, (last + first) / 2
    corners = [(-half[0], -half[1]), (half[0], -half[1]), (half[0], half[1]), (-half[0], half[1])]
    solid = extrude(detail, bevelled(corners, BEVEL), float(2 * half[2]))
    offset = middle - [0.0, 0.0, half[2]]
    return Solid(solid.triangles, lambda: copies(solid.make(), [np.eye(3)], [offset]))


def extrude(
    detail: Detail, outline: Outline, depth: float, opening: Outline | None = None
) -> Solid:
    """Extrude an outline along z."""
    # Less than half an outline's bevels: at its corners, the ends of edges must not meet.
    bevel = min(0.4 * detail.bevel, 0.3 * depth)
    rings = (4 if bevel else 2) * (1 if opening is None else 2)
    triangles = 2 * rings * len(outline.points)
    return Solid(triangles, lambda: prism(outline, depth, bevel, opening))


def bolt(detail: Detail, radius: float, height: float) -> Solid:
    """Make the head of a bolt, along z: hexagonal, or triangular if there are few triangles."""
    corners = circle(radius, 6 if detail.quality >= 6 else 3).points
    return extrude(detail, bevelled(corners, detail.bevel, crease=np.pi), height)


def sweep(
    detail: Detail,
    path: NDArray[np.float64],
    radius: float,
    bore: float = 0.0,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
) -> Solid:
    """Sweep a rod, or a pipe, along a path."""
    bevel = min(detail.bevel, 0.3 * (radius - bore))
    segments = max(detail.around(radius), min(6, round(detail.quality / 2)), 4)
    rings = (len(path) + (2 if bevel else 0)) * (2 if bore else 1)
    return Solid(
        2 * rings * segments,
        lambda: tube(path, radius, segments, bore=bore, bevel=bevel, up=up),
    )


def toward(direction: ArrayLike) -> NDArray[np.float64]:
    """Return a rotation that turns the y axis to a direction other than the z axis."""
    along = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return np.stack([across, along, np.cross(across, along)], axis=1)


def fitted(plan: Callable[[Detail], list[Piece]], triangles: int, smooth_from: int) -> list[Piece]:
    """Choose the pieces of a machine, and how fine they are, for a number of triangles.

    Parameters
    ----------
    plan : callable
        ``plan(detail)`` returns its pieces, always as many, the most important first.
    triangles : int
        Target count, which is not exceeded.
    smooth_from : int
        Count from which there are bevels and normals.
    """
    smooth = triangles >= smooth_from
    low, high = LEAST_QUALITY, 2.0 * LEAST_QUALITY
    least = plan(Detail(low, smooth))
    if _count(least) > triangles:
        return _most_important(least, triangles)
    while _count(plan(Detail(high, smooth))) <= triangles:
        high *= 2.0
    while high > 1.02 * low:
        middle = (low + high) / 2
        if _count(plan(Detail(middle, smooth))) <= triangles:
            low = middle
        else:
            high = middle
    pieces = plan(Detail(low, smooth))
    # The rest goes to pieces that would have become finer next.
    rest = triangles - _count(pieces)
    for index, finer in enumerate(plan(Detail(1.2 * low + 1.0, smooth))):
        more = finer.triangles - pieces[index].triangles
        if 0 < more <= rest:
            pieces[index] = finer
            rest -= more
    return pieces


def assemble(pieces: Sequence[Piece], offset: ArrayLike) -> list[rs.Mesh]:
    """Make the meshes of all pieces, in order of their first pieces, moved by an offset."""
    parts: dict[str, list[tuple[Part, int]]] = {}
    for item in pieces:
        template = item.solid.make()
        if item.flipped:
            template = template.flipped()
        places = item.offsets + np.asarray(offset)
        if "{}" not in item.name:
            made = copies(template, item.matrices, places)
            parts.setdefault(item.name, []).append((made, item.material))
            continue
        for copy in range(len(places)):
            made = copies(template, item.matrices[[copy]], places[[copy]])
            parts.setdefault(item.name.format(copy + 1), []).append((made, item.material))
    return [_mesh(name, group) for name, group in parts.items()]


def _mesh(name: str, group: list[tuple[Part, int]]) -> rs.Mesh:
    """Make a mesh of parts and their materials."""
    whole = merged([part for part, _ in group])
    ids = np.repeat([material for _, material in group], [len(part.faces) for part, _ in group])
    return rs.Mesh(whole.vertices, whole.faces, normals=whole.normals, material_ids=ids, name=name)


def _count(pieces: Sequence[Piece]) -> int:
    return sum(item.triangles for item in pieces)


def _most_important(pieces: list[Piece], triangles: int) -> list[Piece]:
    """Return those that fit, the first ones first."""
    chosen, rest = [], triangles
    for item in pieces:
        copies = min(len(item.offsets), rest // item.solid.triangles)
        if copies < len(item.offsets) and not (item.spare and copies):
            continue
        item = item._replace(matrices=item.matrices[:copies], offsets=item.offsets[:copies])
        chosen.append(item)
        rest -= item.triangles
    return chosen
