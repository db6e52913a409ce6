"""Tree: trunk, branches and leaves of one tree, with any number of triangles."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.procedural.parts import Part, instance, merge
from raystream.scene.procedural.shapes import lathe

BARK, LEAF = 1, 2

#: The fewest triangles of a closed trunk and crown.
LEAST_TRIANGLES = 14

#: Above this a tree has individual leaves.
LEAFY_TRIANGLES = 90

BARK_COLORS = ((0.23, 0.16, 0.11), (0.3, 0.25, 0.2))
LEAF_COLORS = ((0.07, 0.23, 0.08), (0.25, 0.4, 0.07))


class Tree(NamedTuple):
    """A tree at the origin, 8 to 11 metres tall.

    ``wood`` is smooth and closed. ``leaves`` is flat; individual leaves are open, the solid
    crown of a coarse tree is closed.
    """

    wood: Part
    leaves: Part


def tree(triangles: int, conifer: bool, generator: np.random.Generator) -> Tree:
    """Grow a tree.

    Parameters
    ----------
    triangles : int
        Number of triangles, at least `LEAST_TRIANGLES`; exact up to parity, or up to 12 below
        `LEAFY_TRIANGLES`.
    conifer : bool
        Whether the tree is pointed and dark rather than round and light.
    generator : numpy.random.Generator
        Source of variation between trees.
    """
    if triangles < LEAFY_TRIANGLES:
        return _simple(triangles, conifer)
    segments = int(np.clip(triangles**0.5 / 6, 3, 16))
    rings = 2 + min(segments // 2, 6)
    trunk = _trunk(rings, segments, conifer)
    branch_count = max(4, triangles // 45)
    starts, ends, spans = _branches(branch_count, conifer, generator)
    branches = _cones(starts, ends, 0.016 * spans + 0.008)
    wood = merge([trunk, branches]).painted(BARK)
    wood = _colored(wood, BARK_COLORS[0 if conifer else 1])
    leaf_count = (triangles - wood.triangle_count) // 2
    return Tree(wood, _leaves(leaf_count, starts, ends, conifer, generator))


def _colored(part: Part, color: tuple[float, float, float]) -> Part:
    return replace(part, colors=np.tile(np.asarray(color, np.float32), (len(part.vertices), 1)))


def _simple(triangles: int, conifer: bool) -> Tree:
    """A trunk of 6 triangles and a crown in one piece."""
    segments = int(np.clip((triangles - 6) / 2, 4, 7))
    rings = max(1, (triangles - 6) // (2 * segments))
    trunk = lathe([0.22], [0.0, 0.0, 6.0], 3).painted(BARK)
    turn = (np.arange(rings) + 1.0) / (rings + 1)
    if conifer:
        radii, heights = 2.2 * (1.0 - turn + turn[0]) / (1.0 + turn[0]), 1.2 + 9.0 * turn
        profile = lathe(
            radii, [1.2, *(heights - 9.0 * turn[0] + 0.4), 10.5], segments, smooth=False
        )
    else:
        radii, heights = 2.6 * np.sin(np.pi * turn), 5.4 - 2.9 * np.cos(np.pi * turn)
        profile = lathe(radii, [2.5, *heights, 8.3], segments, smooth=False)
    kind = 0 if conifer else 1
    return Tree(
        _colored(trunk, BARK_COLORS[kind]), _colored(profile.painted(LEAF), LEAF_COLORS[kind])
    )


def _trunk(rings: int, segments: int, conifer: bool) -> Part:
    top = 10.4 if conifer else 6.6
    rise = np.linspace(0.0, 0.97, rings)
    radii = (0.2 if conifer else 0.26) * (1.0 - rise) ** 0.8 + 0.1 * np.exp(-rise * 18.0)
    return lathe(radii, [0.0, *(rise * top), top], segments)


def _branches(
    count: int, conifer: bool, generator: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return starts (K, 3), ends (K, 3) and lengths (K,) of branches at about even angles."""
    share = (np.arange(count) + generator.random(count)) / count
    angle = np.arange(count) * 2.399963 + generator.normal(0.0, 0.3, count)
    if conifer:
        height = 1.3 + 8.8 * share
        length = 2.9 * (1.0 - share) ** 0.85 * generator.uniform(0.75, 1.1, count) + 0.25
        lift = -0.12 + 0.3 * share
    else:
        height = 2.4 + 4.0 * share**0.8
        length = 3.1 * np.sqrt(1.05 - share * share) * generator.uniform(0.55, 1.05, count)
        lift = 0.25 + 1.1 * share * generator.uniform(0.5, 1.0, count)
    direction = np.stack([np.cos(angle), lift, np.sin(angle)], axis=1)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    starts = np.stack([np.zeros(count), height, np.zeros(count)], axis=1)
    return starts, starts + direction * length[:, None], length


def _cones(
    starts: NDArray[np.float64], ends: NDArray[np.float64], radii: NDArray[np.float64]
) -> Part:
    """Return three-sided spindles of 6 triangles from start to end."""
    along = ends - starts
    side = np.cross(along, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    front = np.cross(side, along)
    front /= np.linalg.norm(front, axis=1)[:, None]
    matrices = np.stack([side * radii[:, None], along, front * radii[:, None]], axis=2)
    return instance(lathe([1.0], [0.0, 0.15, 1.0], 3), matrices, starts)


def _leaves(
    count: int,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    conifer: bool,
    generator: np.random.Generator,
) -> Part:
    """Return leaves of 2 triangles, folded at the midrib, along the branches."""
    along = ends - starts
    lengths = np.linalg.norm(along, axis=1)
    branch = generator.choice(len(starts), count, p=lengths / lengths.sum())
    along = along[branch]
    share = (1.08 * generator.random(count) ** (0.75 if conifer else 0.5))[:, None]
    spread = 0.12 if conifer else 0.36
    roots = starts[branch] + along * share
    roots = roots + generator.normal(0.0, spread, (count, 3))
    outward = along / lengths[branch, None]
    outward = outward + generator.normal(0.0, 0.55, (count, 3))
    outward[:, 1] -= 0.35
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    side = np.cross(outward, generator.normal(0.0, 0.35, (count, 3)) + [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    up = np.cross(side, outward)
    # Fewer leaves are larger, so that the density of the crown is constant.
    area = 190.0 if conifer else 200.0
    length = np.sqrt(area / count) * generator.uniform(0.75, 1.25, count)[:, None]
    width = (0.22 if conifer else 0.36) * length
    middle = roots + 0.45 * length * outward
    edge = 0.4 * width * up
    corners = np.stack(
        [
            roots,
            middle - width * side + edge,
            roots + length * outward,
            middle + width * side + edge,
        ],
        axis=1,
    )
    faces = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    faces = (faces[None] + 4 * np.arange(count, dtype=np.int32)[:, None, None]).reshape(-1, 3)
    # Leaves inside the crown are darker: light that bounces there has been partly absorbed.
    shade = (0.55 + 0.45 * share) * generator.uniform(0.8, 1.2, (count, 1))
    colors = np.clip(shade * LEAF_COLORS[0 if conifer else 1], 0.0, 1.0)
    return Part(
        corners.reshape(-1, 3).astype(np.float32),
        faces,
        np.full(len(faces), LEAF, np.int32),
        colors=np.repeat(colors, 4, axis=0).astype(np.float32),
    )
