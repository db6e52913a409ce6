"""Forest: hilly ground with trees of many tiny triangles."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight
from raystream.scene.material import Material
from raystream.scene.procedural.layout import floor_cells
from raystream.scene.procedural.parts import Part, instance, merge, to_mesh, yaw
from raystream.scene.procedural.shapes import grid
from raystream.scene.procedural.size import MAX_INSTANCED_TRIANGLES, check_triangles
from raystream.scene.procedural.tree import LEAST_TRIANGLES, Tree, tree
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 1_000_000

#: Side of the ground area per tree, metres.
SPACING = 4.2

#: Number of tree models; every other one is a conifer.
KINDS = 6

#: Most cells of the ground along a side, in a forest of instances: half a million triangles.
MOST_CELLS = 512

#: The mean shade of trees.
MEAN_TINT = 0.8

MATERIALS = (
    Material("ground", diffuse=(0.15, 0.17, 0.06)),
    Material("bark", diffuse=(1.0, 1.0, 1.0)),
    Material("leaf", diffuse=(1.0, 1.0, 1.0)),
)


def forest(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make a forest, in place of the one in Purcell 2002.

    Trunks and branches are closed; leaves have two triangles each. There are a few models of
    trees, instanced in different sizes and shades.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by less than a third below 500, by less than
        5 % above. More triangles give more trees on more ground, and more leaves per tree.

    Returns
    -------
    Scene
        In metres, y up, three meshes (ground, wood, leaves), a sun and a sky. The camera
        looks down on the forest's edge; see also `inside_camera` and `top_camera`.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Purcell 2002, section 4 (Forest Top Down, Forest Inside).
    """
    target = check_triangles(triangles)
    cells = _cells(target)
    planting = _planting(target - 2 * cells * cells)
    wood, leaves = _trees(planting)
    ground = _ground(cells, planting.half)
    meshes = [to_mesh(ground, "ground"), to_mesh(wood, "wood"), to_mesh(leaves, "leaves")]
    return Scene(meshes, materials=MATERIALS, **_surroundings(planting.half))


def instanced_forest(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make the same forest of instances: its memory is that of the ground and of a few trees.

    Parameters
    ----------
    triangles : int
        As of `forest`, in all instances. The ground has at most half a million.

    Returns
    -------
    Scene
        The trees stand where those of `forest` do, if that has no finer ground. All of a kind have
        the same shade.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    target = check_triangles(triangles, MAX_INSTANCED_TRIANGLES)
    cells = min(_cells(target), MOST_CELLS)
    planting = _planting(target - 2 * cells * cells)
    order = np.argsort(planting.kinds, kind="stable")
    transforms = np.zeros((1 + len(order), 3, 4))
    transforms[0, :, :3] = np.eye(3)
    transforms[1:, :, :3], transforms[1:, :, 3] = planting.turns[order], planting.base[order]
    objects = [[to_mesh(_ground(cells, planting.half), "ground")]]
    tint = np.full((1, 3), MEAN_TINT)
    for kind in range(KINDS):
        model = _model(planting, kind)
        place = np.eye(3)[None], np.zeros((1, 3))
        parts = {"wood": model.wood, "leaves": model.leaves}
        objects.append(
            [to_mesh(instance(one, *place, colors=tint), name) for name, one in parts.items()]
        )
    return Scene.instances(
        objects,
        transforms,
        np.append(0, 1 + planting.kinds[order]),
        materials=MATERIALS,
        **_surroundings(planting.half),
    )


def _cells(target: int) -> int:
    """Cells of the ground along a side."""
    return max(1, math.isqrt(target // 40))


def _surroundings(half: float) -> dict[str, Any]:
    """Lights, background, camera and name of the scene."""
    # Above the edge, so that both the crowns and the ground between the trunks are visible.
    eye = (0.5 * half, 0.5 * half + 8.0, 1.2 * half + 10.0)
    return {
        "lights": (
            DirectionalLight((0.8, -0.7, -0.6), (4.2, 3.8, 3.1)),
            EnvironmentLight((0.42, 0.5, 0.6)),
        ),
        "background": (0.55, 0.7, 0.88),
        "camera": Camera(eye, (0.0, 2.0, 0.1 * half), fov=42.0),
        "name": "forest",
    }


def inside_camera(scene: Scene) -> Camera:
    """Return the view from between the trees, near the ground, along the path.

    Parameters
    ----------
    scene : Scene
        Made by `forest`.
    """
    half = _half(scene)
    z = 0.8 * half
    x = float(_path(z, half))
    ahead = float(_path(0.2 * half, half))
    eye = (x, float(_height(x, z, half)) + 1.7, z)
    return Camera(eye, (ahead, float(_height(ahead, 0.2 * half, half)) + 3.5, 0.2 * half), fov=60.0)


def top_camera(scene: Scene) -> Camera:
    """Return the view of the whole forest from straight above.

    Parameters
    ----------
    scene : Scene
        Made by `forest`.
    """
    return Camera((0.0, 3.0 * _half(scene) + 12.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 40.0)


def _half(scene: Scene) -> float:
    """Half the side of the wooded square: the ground reaches 2.4 times as far."""
    return float(np.abs(scene.meshes[0].vertices).max() / 2.4)


def _height(x: ArrayLike, z: ArrayLike, half: float) -> NDArray[np.float64]:
    """Ground height: low waves among the trees, hills around them."""
    x, z = np.asarray(x, np.float64), np.asarray(z, np.float64)
    waves = 0.9 * np.sin(0.11 * x + 0.7) * np.cos(0.13 * z) + 0.35 * np.sin(0.31 * x - 0.23 * z)
    far = np.clip(np.hypot(x, np.minimum(z, 0.0)) / (2.4 * half) - 0.42, 0.0, None)
    hills = 1.0 + 0.35 * np.sin(3.1 * x / half) + 0.25 * np.sin(5.3 * (x - z) / half)
    return waves + 0.5 * half * far * hills


def _path(z: ArrayLike, half: float) -> NDArray[np.float64]:
    """Return the x of the path into the forest at z."""
    return 0.12 * half * np.sin(3.0 * np.asarray(z, np.float64) / half) + 0.02 * half


def _ground(cells: int, half: float) -> Part:
    lines = np.linspace(-2.4 * half, 2.4 * half, cells + 1)
    return grid(lines, lines, _height(lines[None, :], lines[:, None], half))


class _Planting(NamedTuple):
    """The trees of a forest.

    Attributes
    ----------
    triangles : int
        Of each tree.
    half : float
        Half the side of the wooded square.
    base, turns, kinds, tints : ndarray
        Of each tree: where it stands, its matrix, its model, and its shade.
    """

    triangles: int
    half: float
    base: NDArray[np.float64]
    turns: NDArray[np.float32]
    kinds: NDArray[np.int64]
    tints: NDArray[np.float64]


def _planting(wanted: int) -> _Planting:
    """Plan trees of a total number of triangles."""
    size = max(float(LEAST_TRIANGLES), 8.0 * math.sqrt(wanted)) if wanted > 400 else LEAST_TRIANGLES
    count = max(1, round(wanted / size))
    half = max(6.0, 0.5 * SPACING * math.sqrt(1.1 * count))
    generator = np.random.default_rng(1987)
    spots, _ = floor_cells(
        math.ceil(1.1 * count), (-half, -half), (half, half), generator, jitter=0.3
    )
    # Remove the trees nearest to the path, except in the back.
    gap = (
        np.abs(spots[:, 0] - _path(spots[:, 1], half))
        + np.maximum(-0.4 * half - spots[:, 1], 0.0) * 2.0
    )
    spots = spots[np.sort(np.argsort(-gap, kind="stable")[:count])]
    base = np.stack([spots[:, 0], _height(spots[:, 0], spots[:, 1], half), spots[:, 1]], axis=1)
    base[:, 1] -= 0.05  # roots reach below the ground
    turns = yaw(generator.uniform(0.0, 2 * np.pi, count), generator.uniform(0.7, 1.2, count))
    # Patches of one kind, with a few of the others.
    field = np.sin(0.15 * spots[:, 0] + 1.0) + np.cos(0.17 * spots[:, 1])
    conifer = field + generator.normal(0.0, 0.8, count) > 0.2
    kinds = 2 * generator.integers(0, KINDS // 2, count) + ~conifer
    tints = generator.uniform(0.72, 1.0, (count, 1)) * generator.uniform(0.85, 1.0, (count, 3))
    return _Planting(wanted // count, half, base, turns, kinds, tints)


def _model(planting: _Planting, kind: int) -> Tree:
    """A tree of a kind, at the origin."""
    return tree(planting.triangles, kind % 2 == 0, np.random.default_rng(kind))


def _trees(planting: _Planting) -> tuple[Part, Part]:
    """Wood and leaves of all trees."""
    turns, base, tints = planting.turns, planting.base, planting.tints
    wood, leaves = [], []
    for kind in range(KINDS):
        own = planting.kinds == kind
        model = _model(planting, kind)
        wood.append(instance(model.wood, turns[own], base[own], colors=tints[own]))
        leaves.append(instance(model.leaves, turns[own], base[own], colors=tints[own]))
    return merge(wood), merge(leaves)
