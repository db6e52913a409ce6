"""Walks through the trees of instances, spheres, height fields and float64, which nest.

One stack serves all trees of a scene: where a ray enters an instance, the root of its object's tree
is the next entry. Boxes are tested in float64, grown as in traversals. What a leaf's primitives
give is read from all hits of the ray, so that it has the tracer's bits.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.geometry.fields.levels import BLOCK_CELLS
from raystream.kernels.ray import PAD, SceneFrame
from raystream.machines.records import RayState
from raystream.structures.bvh.layout import CHILDREN_AT, WIDTH

#: Low bits of a leaf's link, below its first block: in float64, whose blocks count twice, one more.
_BITS, _BITS64 = 3, 4

#: Where a leaf block in float64 has its prim_ids, as int32.
_IDS64 = slice(72, 76)


class Place(NamedTuple):
    """A node, leaf or instance.

    Attributes
    ----------
    number : int
        In the order in which they are found.
    kind : str
        ``"node"``, ``"leaf"`` or ``"instance"``.
    box : ndarray of shape (2, 3), float64
        Around it, world space.
    t_in, t_out : float
        The ray's interval in it, in direction lengths; empty if the ray misses it.
    inside : callable
        Returns the children of a node, the root of an instance's object, or the pairs
        (instance_id, prim_id) in a leaf.
    """

    number: int
    kind: str
    box: NDArray[np.float64]
    t_in: float
    t_out: float
    inside: Callable[[], list[Any]]


class Frame:
    """A local frame of a tree, and the ray there.

    Parameters
    ----------
    frame : SceneFrame
        Of the tree's structure.
    ray : ndarray of shape (2, 3), float64
        Origin and direction, world space.
    back : ndarray of shape (3, 4), float64
        From world space to the space that the frame is in.
    """

    def __init__(
        self, frame: SceneFrame, ray: NDArray[np.float64], back: NDArray[np.float64]
    ) -> None:
        linear, shift = back[:, :3] * frame.scale, (back[:, 3] - frame.center) * frame.scale
        self._ray = ray @ linear.T + [shift, np.zeros(3)]
        self._forward, self._shift = np.linalg.inv(linear).T, shift
        self._pad = float(PAD) * (float(frame.max_coordinate) + np.abs(self._ray[0]).max())

    def interval(self, box: NDArray[np.float64]) -> tuple[float, float]:
        """Where the ray is in a box of this frame, from 0 on."""
        origin, way = self._ray
        grown = box + [[-self._pad], [self._pad]]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort((grown - origin) / way, axis=0)
        t_in, t_out = np.nanmax([0.0, *ends[0]]), np.nanmin(ends[1])
        is_beside = (way == 0.0) & ((grown[0] > origin) | (grown[1] < origin))
        return float(t_in), -np.inf if is_beside.any() else float(t_out)

    def to_world(self, box: NDArray[np.float64]) -> NDArray[np.float64]:
        """The world's box around a box of this frame."""
        corners = np.array([*itertools.product(*box.T)])
        moved = (corners - self._shift) @ self._forward
        return np.array([moved.min(axis=0), moved.max(axis=0)])


class TreeMap:
    """The places of a scene's trees, for one ray.

    Parameters
    ----------
    structure : Structure
        Of a BVH of any kind of scene.
    ray : ndarray of shape (2, 3), float64
        Origin and direction, world space.
    """

    def __init__(self, structure: Any, ray: NDArray[np.float64]) -> None:
        self._structure, self._ray = structure, ray
        self._numbers = itertools.count()

    def roots(self) -> list[Place]:
        """The roots of the scene's trees, in the order in which they are searched."""
        return list(self._roots(self._structure, np.eye(3, 4), 0, lambda ids: ids))

    def _roots(
        self,
        structure: Any,
        back: NDArray[np.float64],
        instance: int,
        in_scene: Callable[[NDArray[np.int32]], NDArray[np.int32]],
    ) -> Iterator[Place]:
        """The roots of a structure's trees; ``in_scene(ids)`` are its prim_ids in the scene."""
        store, arrays = structure.triangles, structure.arrays
        frame = Frame(structure.frame, self._ray, back)

        def leaf_of(ids: NDArray[np.int32]) -> tuple[str, Callable[[], list[Any]]]:
            found = [(instance, one) for one in in_scene(ids[ids >= 0]).tolist()]
            return "leaf", lambda: found

        def triangles(code: int) -> tuple[str, Callable[[], list[Any]]]:
            row, ids = code >> _BITS, arrays["leaves"].view(np.int32)[:, -4:]
            if store.number_type is np.float64:
                row, ids = code >> _BITS64, arrays["leaves"].view(np.int32)[:, _IDS64]
            return leaf_of(ids[row : row + (code & 7) + 1])

        def spheres(code: int) -> tuple[str, Callable[[], list[Any]]]:
            numbers = arrays["sphere_blocks"]["numbers"][code >> _BITS]
            return leaf_of(store.split_ids(numbers)[0])

        if store.instances is not None:
            yield from self._wide(frame, arrays["nodes"], self._instance)
            return
        yield from self._wide(frame, arrays["nodes"], triangles)
        if store.has_primitives:
            fields = zip(store.local_fields, structure.levels, store.first_fields, strict=False)
            for local, levels, number in fields:
                yield self._field(frame, (local, levels, int(number)), leaf_of)
            yield from self._wide(frame, arrays["sphere_nodes"], spheres)

    def _instance(self, code: int) -> tuple[str, Callable[[], list[Any]]]:
        structure = self._structure
        instance = int(structure.trees.order[code >> _BITS])
        held, store = structure.triangles.instances, structure.triangles
        k = int(held.object_ids[instance])
        inside = structure.objects[k], held.inverses[instance], instance, partial(store.prims_of, k)
        return "instance", lambda: list(self._roots(*inside))

    def _place(
        self, frame: Frame, box: NDArray[Any], kind: str, inside: Callable[[], list[Any]]
    ) -> Place:
        own = np.asarray(box, np.float64)
        return Place(next(self._numbers), kind, frame.to_world(own), *frame.interval(own), inside)

    def _wide(
        self, frame: Frame, nodes: NDArray[np.float32], leaf: Callable[[int], Any]
    ) -> Iterator[Place]:
        """The root of a wide tree, if there is one; ``leaf(code)`` makes what is in a leaf."""
        links = nodes.view(np.int32)[:, CHILDREN_AT // 4 :][:, :WIDTH]
        planes = nodes[:, : CHILDREN_AT // 4].reshape(-1, 3, 2, WIDTH).transpose(0, 3, 2, 1)

        def inside(row: int) -> list[Place]:
            made = []
            for lane in np.flatnonzero(links[row]):
                link, box = int(links[row, lane]), planes[row, lane]
                kind, within = leaf(~link) if link < 0 else ("node", lambda n=link: inside(n))
                made.append(self._place(frame, box, kind, within))
            return made

        if len(nodes):
            boxes = planes[0, links[0] != 0]
            around = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
            yield self._place(frame, around, "node", lambda: inside(0))

    def _field(self, frame: Frame, field: Any, leaf_of: Callable[[Any], Any]) -> Place:
        """The root of the tree of a height field: its arrays, levels and first number."""
        local, levels, first = field
        columns, rows = len(local.x) - BLOCK_CELLS - 1, len(local.y) - 1

        def cells(column: int, row: int, size: int) -> tuple[slice, slice]:
            """The range of a node's cells along x and y."""
            first_x, first_y = column * size, row * size
            ends = min(first_x + size, columns), min(first_y + size, rows)
            return slice(first_x, ends[0]), slice(first_y, ends[1])

        def inside(level: int, column: int, row: int) -> list[Place]:
            own, made = levels.levels[level - 1], []
            group = int(own["first"]) + row * int(own["columns"]) + column
            for k in range(4):
                place = 2 * column + (k & 1), 2 * row + (k >> 1)
                across, along = cells(*place, int(own["size"]))
                low, high = levels.ranges[group, :, k]
                if not low <= high:
                    continue
                x, y = local.x[[across.start, across.stop]], local.y[[along.start, along.stop]]
                box = np.sort(np.array([x, y, [low, high]], np.float64).T, axis=0)
                kind, within = "node", lambda one=place: inside(level - 1, *one)
                if level == 1:
                    row_of, column_of = np.mgrid[along, across]
                    number = first + 2 * (row_of * columns + column_of)
                    kind, within = leaf_of(np.stack([number, number + 1], axis=-1))
                made.append(self._place(frame, box, kind, within))
            return made

        x, y = local.x[: columns + 1], local.y
        known = levels.ranges[-1]
        box = [[x.min(), y.min(), known[0].min()], [x.max(), y.max(), known[1].max()]]
        return self._place(frame, np.array(box), "node", lambda: inside(len(levels.levels), 0, 0))


class Visit(NamedTuple):
    """A step of a walk; see `walk.Step`, whose members have these names."""

    kernel: str
    before: RayState
    after: RayState
    at: Place | None
    to: Place | None
    tested: tuple[int, ...]
    t: float
    prim_id: int
    instance_id: int
    stack: tuple[Place, ...]
    counts: dict[str, int]


#: A hit: t, instance_id and prim_id.
Hit = tuple[float, int, int]
_MISS: Hit = (np.inf, -1, -1)


def visits(roots: list[Place], hits: dict[tuple[int, int], float]) -> Iterator[Visit]:
    """The steps of a ray to its nearest hit; `hits` has t by instance_id and prim_id."""
    stack, best, state = roots[::-1], _MISS, RayState.STARTING

    def step(kernel: str, at: Place | None, counts: dict[str, int], tested: Any = ()) -> Visit:
        """End a step: leave out what lies behind the hit, and take the next place."""
        nonlocal state
        while stack and stack[-1].t_in > best[0]:
            stack.pop()
        before, (t, instance_id, prim_id) = state, best
        state = RayState.TRAVERSING
        if not stack:
            state = RayState.DONE if prim_id < 0 else RayState.SHADING
        to = stack[-1] if stack else None
        hit = t, prim_id, instance_id
        return Visit(kernel, before, state, at, to, tested, *hit, tuple(stack[-2::-1]), counts)

    yield step("set up", None, {})
    while stack:
        at = stack.pop()
        inside = at.inside()
        if at.kind == "leaf":
            state, before = RayState.INTERSECTING, state
            waiting = tuple(stack[::-1])
            so_far = best[0], best[2], best[1]
            yield Visit("traverse", before, state, at, at, (), *so_far, waiting, {"leaves": 1})
            for instance_id, prim_id in inside:
                t = hits.get((instance_id, prim_id), np.inf)
                best = min(best, (t, instance_id, prim_id)) if t < np.inf else best
            tested = tuple(prim_id for _, prim_id in inside)
            yield step("intersect", at, {"tests": len(inside)}, tested)
            continue
        if at.kind == "node":
            entered = [one for one in inside if one.t_in <= min(one.t_out, best[0])]
            stack += sorted(entered, key=lambda one: -one.t_in)
            yield step("traverse", at, {"steps": 1})
        else:
            stack += inside[::-1]
            yield step("traverse", at, {"leaves": 1})
    if best != _MISS:
        t, instance_id, prim_id = best
        hit = t, prim_id, instance_id
        yield Visit("shade", state, RayState.DONE, None, None, (), *hit, (), {"shadings": 1})
