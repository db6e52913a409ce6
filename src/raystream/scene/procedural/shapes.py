"""Shapes: boxes, spheres, lathes, grids. Closed ones share vertices, so that no edge is open."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.procedural.parts import Part

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


def boxes(lows: ArrayLike, highs: ArrayLike, material_ids: ArrayLike = 0) -> Part:
    """Make N axis-parallel boxes: 12 N triangles, 8 N vertices, closed.

    Parameters
    ----------
    lows, highs : array_like of shape (N, 3), float
        Opposite corners; low < high on every axis.
    material_ids : int or array_like of shape (N,), integer
        Material of each box.

    Raises
    ------
    ValueError
        If a box has no volume.
    """
    low, high = np.asarray(lows, np.float32), np.asarray(highs, np.float32)
    if not (low < high).all():
        raise ValueError("boxes: low must be less than high on every axis")
    count = len(low)
    vertices = np.where(BOX_CORNERS[None], high[:, None, :], low[:, None, :])
    faces = BOX_FACES[None] + 8 * np.arange(count, dtype=np.int32)[:, None, None]
    ids = np.repeat(np.broadcast_to(np.asarray(material_ids, np.int32), count), 12)
    return Part(vertices.reshape(-1, 3), faces.reshape(-1, 3), ids)


def room(low: ArrayLike, high: ArrayLike, wall: int, floor: int) -> Part:
    """Make a box seen from inside: 12 triangles, closed.

    Parameters
    ----------
    low, high : array_like of shape (3,), float
        Opposite corners.
    wall, floor : int
        Material of the walls and the ceiling, and of the floor.
    """
    inside = boxes(np.asarray(low)[None], np.asarray(high)[None], wall).flipped()
    ids = inside.material_ids.copy()
    ids[[4, 5]] = floor
    return Part(inside.vertices, inside.faces, ids)


def box(divisions: tuple[int, int, int] = (1, 1, 1)) -> Part:
    """Make the box [-1, 1]^3 with each axis divided evenly; closed.

    Parameters
    ----------
    divisions : tuple of int
        Cells (a, b, c) along x, y and z: 4 (ab + bc + ca) triangles.
    """
    lattice, faces = _box_lattice(divisions)
    vertices = (2.0 * lattice / np.asarray(divisions) - 1.0).astype(np.float32)
    return Part(vertices, faces, np.zeros(len(faces), np.int32))


def sphere(divisions: int) -> Part:
    """Make the unit sphere from a box with `divisions` cells per side; smooth, closed.

    Unlike a latitude-longitude sphere, a projected box has no poles with tiny triangles. There
    are 12 divisions^2 triangles; at least 2 divisions look round.
    """
    lattice, faces = _box_lattice((divisions,) * 3)
    # Equal angles: cells near the box's corners would be small otherwise.
    points = np.tan((2.0 * lattice / divisions - 1.0) * (np.pi / 4))
    points /= np.sqrt((points * points).sum(axis=1))[:, None]
    vertices = points.astype(np.float32)
    return Part(vertices, faces, np.zeros(len(faces), np.int32), vertices)


def rounded_box(divisions: int, half_size: tuple[float, float, float], radius: float) -> Part:
    """Make a box with rounded edges, centred at the origin; smooth, closed.

    Parameters
    ----------
    divisions : int
        Cells per side: 12 divisions^2 triangles.
    half_size : tuple of float
        Half the extent on each axis.
    radius : float
        Radius of the edges; less than the smallest half extent.

    Raises
    ------
    ValueError
        If the radius is not positive, or leaves no flat part.
    """
    if not 0.0 < radius < min(half_size):
        raise ValueError(f"radius: expected more than 0 and less than {min(half_size)}")
    lattice, faces = _box_lattice((divisions,) * 3)
    # A third of the cells at either end bend around the edge, the rest stay flat.
    bend = max(1, divisions // 3) if divisions > 2 else 0
    inner = np.asarray(half_size) - radius
    middle = divisions - 2 * bend
    flat = np.clip((lattice - bend) / middle * 2.0 - 1.0, -1.0, 1.0)
    if bend:
        around = np.clip((np.abs(lattice - divisions / 2) - middle / 2) / bend, 0.0, 1.0)
    else:
        around = (np.abs(flat) == 1.0).astype(np.float64)
    normals = np.sign(flat) * np.tan(around * (np.pi / 4))
    normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
    vertices = (flat * inner + normals * radius).astype(np.float32)
    return Part(vertices, faces, np.zeros(len(faces), np.int32), normals.astype(np.float32))


def lathe(radii: ArrayLike, heights: ArrayLike, segments: int, *, smooth: bool = True) -> Part:
    """Make a surface of revolution about the y axis; closed.

    Parameters
    ----------
    radii : array_like of shape (K,), float
        Radius of each ring, from the lowest to the highest; positive.
    heights : array_like of shape (K + 2,), float
        y of the lower pole, of each ring, and of the upper pole.
    segments : int
        Vertices per ring, at least 3: 2 K segments triangles.
    smooth : bool
        Whether to add normals, derived from the profile.
    """
    radius = np.concatenate([[0.0], np.asarray(radii, np.float64), [0.0]])
    height = np.asarray(heights, np.float64)
    ring_count = len(radius) - 2
    angle = np.arange(segments) * (2 * np.pi / segments)
    around = np.stack([np.cos(angle), np.ones(segments), np.sin(angle)], axis=1)

    def rings(across: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
        points = np.stack([across, along, across], axis=1)
        inner = points[1:-1, None, :] * around[None]
        return np.concatenate([points[:1], inner.reshape(-1, 3), points[-1:]])

    vertices = rings(radius, height)
    faces = _lathe_faces(ring_count, segments)
    if smooth:
        rise, spread = np.gradient(height), np.gradient(radius)
        rise[[0, -1]] = 0.0
        spread[[0, -1]] = 1.0, -1.0
        normals = rings(rise, -spread)
        normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
        slopes = normals.astype(np.float32)
    else:
        slopes = None
    return Part(vertices.astype(np.float32), faces, np.zeros(len(faces), np.int32), slopes)


def grid(x: ArrayLike, z: ArrayLike, heights: ArrayLike) -> Part:
    """Make a height field that faces up; smooth.

    Parameters
    ----------
    x, z : array_like of shape (A,) and (B,), float
        Positions of the grid lines, increasing.
    heights : array_like of shape (B, A), float
        y at each grid point: 2 (A - 1)(B - 1) triangles.
    """
    x, z = np.asarray(x, np.float64), np.asarray(z, np.float64)
    y = np.asarray(heights, np.float64)
    vertices = np.stack(np.broadcast_arrays(x[None, :], y, z[:, None]), axis=-1)
    slope_z, slope_x = np.gradient(y, z, x)
    normals = np.stack([-slope_x, np.ones_like(y), -slope_z], axis=-1).reshape(-1, 3)
    normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
    ids = np.arange(y.size, dtype=np.int32).reshape(y.shape)
    faces = _quads(ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:])
    return Part(
        vertices.reshape(-1, 3).astype(np.float32),
        faces,
        np.zeros(len(faces), np.int32),
        normals.astype(np.float32),
    )


def patch(corners: ArrayLike, divisions: tuple[int, int] = (1, 1)) -> Part:
    """Make an evenly divided quadrilateral.

    Parameters
    ----------
    corners : array_like of shape (4, 3), float
        Counter-clockwise seen from the front.
    divisions : tuple of int
        Cells (a, b) from corner 0 to 1, and from 1 to 2: 2ab triangles.
    """
    corner = np.asarray(corners, np.float64)
    a, b = divisions
    s = (np.arange(a + 1) / a)[None, :, None]
    t = (np.arange(b + 1) / b)[:, None, None]
    points = (corner[0] * (1 - s) + corner[1] * s) * (1 - t)
    points = points + (corner[3] * (1 - s) + corner[2] * s) * t
    ids = np.arange((a + 1) * (b + 1), dtype=np.int32).reshape(b + 1, a + 1)
    faces = _quads(ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1])
    vertices = points.reshape(-1, 3).astype(np.float32)
    return Part(vertices, faces, np.zeros(len(faces), np.int32))


def vertex_normals(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Average the normals of the faces around each vertex, weighted by area; (V, 3), unit."""
    corners = vertices.astype(np.float64)[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(vertices), 3))
    for corner in range(3):
        np.add.at(normals, faces[:, corner], areas)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals.astype(np.float32)


def _quads(*corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Split quadrilaterals, given by four arrays of vertex indices, into triangles."""
    p, q, r, s = (corner.reshape(-1) for corner in corners)
    return np.stack([p, q, r, p, r, s], axis=1).reshape(-1, 3)


def _lathe_faces(ring_count: int, segments: int) -> NDArray[np.int32]:
    ids = 1 + np.arange(ring_count * segments, dtype=np.int32).reshape(ring_count, segments)
    after = np.roll(ids, -1, axis=1)
    low = np.zeros(segments, np.int32)
    high = np.full(segments, ring_count * segments + 1, np.int32)
    bottom = np.stack([low, ids[0], after[0]], axis=1)
    sides = _quads(ids[:-1], ids[1:], after[1:], after[:-1])
    top = np.stack([high, after[-1], ids[-1]], axis=1)
    return np.concatenate([bottom, sides, top]).astype(np.int32)


def _box_lattice(divisions: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the lattice points on the surface of a divided box, and its faces."""
    steps = np.array([1, divisions[0] + 1, (divisions[0] + 1) * (divisions[1] + 1)])
    faces = []
    for axis in range(3):
        across, along = (axis + 1) % 3, (axis + 2) % 3
        ids = (
            np.arange(divisions[across] + 1)[:, None] * steps[across]
            + np.arange(divisions[along] + 1)[None, :] * steps[along]
        )
        low = _quads(ids[:-1, :-1], ids[:-1, 1:], ids[1:, 1:], ids[1:, :-1])
        high = low[:, ::-1] + divisions[axis] * steps[axis]
        faces += [low, high]
    codes, index = np.unique(np.concatenate(faces), return_inverse=True)
    sizes = np.asarray(divisions) + 1
    lattice = codes[:, None] // steps % sizes
    return lattice, index.reshape(-1, 3).astype(np.int32)
