"""Record one ray's walk on the multipass machine, kernel by kernel."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.scene_kinds import check_support
from raystream.kernels.hits import Sink
from raystream.kernels.tally import COLUMNS
from raystream.machines import MultipassBackend, PassSnapshot
from raystream.machines.ray_block import RayBlock, blocks
from raystream.machines.records import RayState
from raystream.stepper.maps import map_of
from raystream.stepper.structure_map import LocalSpot, Records, StructureMap
from raystream.stepper.tree_walk import Place, TreeMap, visits
from raystream.tracer import Tracer


class Spot(NamedTuple):
    """A cell, node or sector, and the ray's interval in it.

    Attributes
    ----------
    number : int
        In a grid the cell's number (the second level follows the first); in a kd-tree the node's
        row; in a graph the sector's number; in a BVH the node's row, or for a leaf the number of
        nodes plus its first block. In scenes with instances, spheres or height fields and in
        float64, places are numbered as they are found.
    kind : str
        ``"cell"``, ``"split"``, ``"node"``, ``"leaf"``, ``"sector"`` or ``"instance"``.
    low, high : tuple of three float
        Its box, world space; around the box of an instance's node, which may be turned.
    t_in, t_out : float
        In direction lengths. The interval of a ray that backtracks or restarts at the root ends
        where its search ends. The last cell of a grid along an axis is unbounded: its t_out may lie
        far behind its box, or be inf. Rays that miss a BVH's root also visit it: t_out is then
        below t_in.
    """

    number: int
    kind: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    t_in: float
    t_out: float


class Step(NamedTuple):
    """One run of a kernel on the ray.

    Attributes
    ----------
    kernel : str
        Its name; see `raystream.machines`.
    before, after : RayState
        State of the ray before and after the step.
    at : Spot or None
        Where the ray was: what the kernel visited. None for set-up.
    to : Spot or None
        Where the ray is now. None if it ended by missing the scene's box.
    face : str or None
        In a graph, the face through which it left its sector.
    tested : tuple of int
        The tested triangles.
    t : float
    prim_id : int
        The nearest hit so far; inf and -1 if there is none.
    stack : tuple of Spot
        The stack, next entry first.
    counts : dict of str to int
        Increments of the ray's counts by the names of `RayCounters`.
    instance_id : int
        Of the hit, in a scene with instances.
    """

    kernel: str
    before: RayState
    after: RayState
    at: Spot | None
    to: Spot | None
    face: str | None
    tested: tuple[int, ...]
    t: float
    prim_id: int
    stack: tuple[Spot, ...]
    counts: dict[str, int]
    instance_id: int = 0


class Walk(NamedTuple):
    """A ray's walk through a structure.

    Attributes
    ----------
    structure : str
        ``"grid"``, ``"kdtree"``, ``"graph"`` or ``"bvh"``.
    traversal : str or None
        Of a kd-tree.
    origin, direction : tuple of three float
        World space.
    steps : tuple of Step
    counts : dict of str to int
        The machine's counts of the ray; see `RayCounters`.
    t : float
    prim_id : int
        The hit; inf and -1 for a miss.
    is_whole : bool
        Whether the walk is complete; else hit and counts are those so far.
    instance_id : int
        Of the hit, in a scene with instances.
    """

    structure: str
    traversal: str | None
    origin: tuple[float, float, float]
    direction: tuple[float, float, float]
    steps: tuple[Step, ...]
    counts: dict[str, int]
    t: float
    prim_id: int
    is_whole: bool = True
    instance_id: int = 0

    @property
    def cells(self) -> list[int]:
        """The cells, leaves or sectors that the ray visited, in order."""
        visit = "leaf" if self.structure == "kdtree" else "traverse"
        spots = [step.at for step in self.steps if step.kernel == visit and step.at is not None]
        return [at.number for at in spots if self.structure != "bvh" or at.kind == "leaf"]


def walk(
    tracer: Tracer, origin: ArrayLike, direction: ArrayLike, *, max_steps: int | None = None
) -> Walk:
    """Follow one ray to its nearest hit.

    The multipass machine traces the ray with one step per pass, and its streams are read after
    each pass: the walk shows what the machine does. It has no such steps for scenes with instances,
    spheres or height fields and for float64. There, the walk follows the trees of the BVH by the
    rules of its traversal, with boxes tested in float64: one tree after another, and from the tree
    over the instances into that of an object.

    Parameters
    ----------
    tracer : Tracer
        With a grid, kd-tree, graph or BVH on the CPU, and any machine. Of other kinds of scene
        than triangles in float32: a BVH.
    origin, direction : array_like of shape (3,), real
        World space, scene units.
    max_steps : int, optional
        Maximum number of steps: a grid cell can list a large part of a scene [default: unlimited].

    Returns
    -------
    Walk

    Raises
    ------
    ValueError
        If the structure is not supported, there is more than one ray, or it is invalid: a zero
        direction or a non-finite number.

    Examples
    --------
    >>> import raystream as rs
    >>> from raystream.stepper import walk
    >>> tracer = rs.Tracer(rs.load("cornell"), "grid", resolution=4)
    >>> way = walk(tracer, [278, 273, -800], [0, 0, 1])
    >>> [step.kernel for step in way.steps][:2]
    ['set up', 'traverse']
    >>> tracer.first_hit([278, 273, -800], [0, 0, 1]).t.item() == way.t
    True
    """
    check_support("walk", tracer.structure.triangles)
    structure = tracer.structure
    batch = RayBatch(origin, direction, 0.0, np.inf)
    if len(batch) != 1:
        raise ValueError(f"walk: expected one ray, got {len(batch):,}")
    most = math.inf if max_steps is None else max_steps
    if structure.triangles.kinds:
        return _through_trees(tracer, origin, direction, most)
    chart = map_of(structure)
    query = Query(Kind.FIRST_HIT, counters=True)
    sink = Sink.of(query, 1)
    (block,) = blocks(batch, structure.frame, sink.status, None)
    if sink.status[0]:
        raise ValueError(f"walk: the ray from {origin!r} in direction {direction!r} is invalid")
    recorder = _Recorder(chart, block, most)
    is_whole = True
    try:
        MultipassBackend(structure).observed_by(recorder.record).run_local(query, block.rays, sink)
    except _MaxStepsError:
        is_whole = False
    hits, tallies = sink.hits, sink.tallies
    assert tallies is not None
    start, way = (np.asarray(array, np.float64).reshape(3) for array in (origin, direction))
    return Walk(
        structure.name,
        structure.options.as_json().get("traversal"),
        _triple(start),
        _triple(way),
        tuple(recorder.steps),
        dict(zip(COLUMNS, tallies[0].tolist(), strict=True)),
        recorder.world_t(float(hits.t[0])),
        int(hits.prim_id[0]),
        is_whole,
    )


def _through_trees(
    tracer: Tracer, origin: ArrayLike, direction: ArrayLike, max_steps: float
) -> Walk:
    """The walk through the trees of other kinds of scene than triangles in float32."""
    structure = tracer.structure
    if structure.name != "bvh":
        raise ValueError(f"walk: expected a tracer of a bvh, got one of {structure.name!r}")
    found = tracer.multi_hit(origin, direction)
    if found.status.any():
        raise ValueError(f"walk: the ray from {origin!r} in direction {direction!r} is invalid")
    ids = zip(found.instance_id.tolist(), found.prim_id.tolist(), strict=True)
    hits: dict[tuple[int, int], float] = {}
    for key, t in zip(ids, found.t.tolist(), strict=True):
        hits.setdefault(key, t)  # the first of two of a sphere
    ray = np.array([origin, direction], np.float64).reshape(2, 3)
    steps: list[Step] = []
    counts, is_whole = dict.fromkeys(COLUMNS, 0), True
    for one in visits(TreeMap(structure, ray).roots(), hits):
        if len(steps) >= max_steps:
            is_whole = False
            break
        at, to = (None if place is None else _spot(place) for place in (one.at, one.to))
        stack = tuple(map(_spot, one.stack))
        steps.append(Step(**{**one._asdict(), "at": at, "to": to, "stack": stack, "face": None}))
        for name, added in one.counts.items():
            counts[name] += added
    last = (steps[-1].t, steps[-1].prim_id) if steps else (math.inf, -1)
    ends = _triple(ray[0]), _triple(ray[1])
    instance_id = steps[-1].instance_id if steps else -1
    return Walk(structure.name, None, *ends, tuple(steps), counts, *last, is_whole, instance_id)


def _spot(place: Place) -> Spot:
    low, high = place.box
    return Spot(place.number, place.kind, _triple(low), _triple(high), place.t_in, place.t_out)


class _MaxStepsError(Exception):
    """Ends a walk at the maximum number of steps."""


class _Recorder:
    """Converts a machine's snapshots of one ray to steps."""

    def __init__(self, chart: StructureMap, block: RayBlock, max_steps: float) -> None:
        self.steps: list[Step] = []
        self._chart, self._max_steps = chart, max_steps
        self._block = block
        self._direction = block.rays.directions[0].astype(np.float64)
        self._place: Any = None
        self._state = RayState.STARTING
        self._spot: Spot | None = None
        self._counts = dict.fromkeys(COLUMNS, 0)

    def record(self, shown: PassSnapshot) -> None:
        """Record a pass."""
        assert shown.hits is not None
        assert shown.tallies is not None
        ray, place, state = (shown.streams[name][0].copy() for name in ("ray", "place", "state"))
        counts = dict(zip(COLUMNS, shown.tallies[0].tolist(), strict=True))
        t_far = float(shown.streams["found"][0]["t_far"])
        records = Records(ray, place, t_far, shown.stacks[0])
        if shown.kernel is not None:
            added = {name: n - self._counts[name] for name, n in counts.items()}
            after, at = RayState(int(state)), self._spot
            if len(self.steps) >= self._max_steps:
                raise _MaxStepsError
            # A ray that never entered has no position, and a finished ray keeps its position.
            is_over = at is None and after in (RayState.DONE, RayState.SHADING)
            spot = None if is_over else self._chart.spot(records)
            to = None if spot is None else self._world(spot)
            face = None
            if at is not None and to is not None and at.number != to.number:
                face = self._chart.way(at.number, to.number, self._direction)
            tested = self._chart.tested(self._place, added["tests"]) if added["tests"] else ()
            stack = () if to is None else self._chart.stack(records)
            step = Step(
                shown.kernel.name,
                self._state,
                after,
                at,
                to,
                face,
                tested,
                self.world_t(float(shown.hits.t[0])),
                int(shown.hits.prim_id[0]),
                tuple(self._world(spot) for spot in stack),
                {name: n for name, n in added.items() if n},
            )
            self.steps.append(step)
            self._spot, self._state = to, after
        self._place, self._counts = place, counts

    def world_t(self, t: float) -> float:
        """Convert a local distance to world direction lengths, as a query reports it."""
        if not math.isfinite(t):
            return t
        array = np.array([t], np.float32)
        self._block.to_world(array, np.array([0, 1]))
        return float(array[0])

    def _world(self, spot: LocalSpot) -> Spot:
        low, high = self._chart.box(spot.number)
        return Spot(
            spot.number,
            self._chart.kind(spot.number),
            _triple(low),
            _triple(high),
            self.world_t(spot.t_in),
            self.world_t(spot.t_out),
        )


def _triple(numbers: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = numbers.tolist()
    return x, y, z
