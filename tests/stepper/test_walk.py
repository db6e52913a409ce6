"""Walks match the machine, and the ray is inside the named boxes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from meshes import soup
from raystream.kernels.tally import COLUMNS
from raystream.machines.records import RayState
from raystream.stepper import walk
from raystream.stepper.maps import map_of
from raystream.structures.kdtree.traversals.short_stack import PLACES
from stepper import stadium

RAYS = stadium.rays()


@pytest.fixture(scope="module")
def plan():
    return stadium.stadium()


@pytest.fixture(scope="module")
def tracers(plan):
    return stadium.tracers(plan)


@pytest.fixture(scope="module")
def walks(plan, tracers):
    """The walk of each ray through each structure, by the tracer's key."""
    return {key: [walk(tracer, *plan.ray(*ray)) for ray in RAYS] for key, tracer in tracers.items()}


FLAT = ("grid", "kdtree-stack", "kdtree-restart", "kdtree-backtrack", "graph")
WALKED = (*FLAT, "bvh")


@pytest.mark.parametrize("key", WALKED)
def test_a_walk_is_what_the_tracer_does(plan, tracers, walks, key):
    """The hit's bits and all counts are those of the branching machine, which has no steps."""
    tracer = tracers[key]
    assert tracer.machine == "branching"
    rays = [plan.ray(*ray) for ray in RAYS]
    origins, directions = (np.array(column) for column in zip(*rays, strict=True))
    hits = tracer.first_hit(origins, directions)
    counters = tracer.counters
    assert 0 < np.count_nonzero(hits.prim_id >= 0) < len(RAYS)
    for i, walked in enumerate(walks[key]):
        assert np.float32(walked.t).tobytes() == hits.t[i].tobytes()
        assert walked.prim_id == hits.prim_id[i]
        assert walked.counts == {name: getattr(counters, name)[i] for name in COLUMNS}
        added = dict.fromkeys(COLUMNS, 0)
        for step in walked.steps:
            for name, n in step.counts.items():
                added[name] += n
        assert added == walked.counts


@pytest.mark.parametrize("key", WALKED)
def test_steps_tell_their_counts(walks, key):
    """The recorded details agree with the machine's own counts."""
    for walked in walks[key]:
        ran = [step.kernel for step in walked.steps]
        assert sum(len(step.tested) for step in walked.steps) == walked.counts["tests"]
        assert (
            len(walked.cells)
            == (walked.counts["leaves" if walked.structure in ("kdtree", "bvh") else "steps"])
        )
        assert ran.count("shade") == walked.counts["shadings"] == (walked.prim_id >= 0)
        if walked.structure == "kdtree":
            assert ran.count("down") == walked.counts["steps"]
            assert ran.count("up") == walked.counts["backtrack_steps"]
        restarts = [
            step for step in walked.steps if step.kernel == "continue" and step.to.number == 0
        ]
        assert len(restarts) == walked.counts["restarts"]


@pytest.mark.parametrize("key", WALKED)
def test_steps_follow_each_other(walks, key):
    for walked in walks[key]:
        steps = walked.steps
        assert steps[0].before is RayState.STARTING
        assert steps[-1].after is RayState.DONE
        assert steps[0].at is None
        for one, after in itertools.pairwise(steps):
            assert one.after is after.before
            assert one.to == after.at
            assert after.t <= one.t
        assert (steps[-1].t, steps[-1].prim_id) == (walked.t, walked.prim_id)


@pytest.mark.parametrize("key", WALKED)
def test_the_ray_is_in_the_box_that_is_named(plan, walks, key):
    """At the middle of its interval it is in the box of the cell, leaf or sector, or very near."""
    corners = plan.scene.triangles.corners.reshape(-1, 3).astype(float)
    box = corners.min(axis=0), corners.max(axis=0)
    for walked in walks[key]:
        origin, direction = np.array(walked.origin), np.array(walked.direction)
        for step in walked.steps:
            spot = step.at
            if spot is None or spot.kind == "split" or step.kernel == "up":
                continue  # going up, the interval is what is left of the ray
            if key == "bvh" and spot.t_in > spot.t_out and spot.number == 0:
                assert walked.prim_id == -1  # the ray misses the root
                continue
            # The last cell of an axis reaches on without end: up to the side of the scene's box.
            sides = np.where(direction > 0.0, box[1], box[0])
            ahead = np.divide(sides - origin, direction, np.full(3, np.inf), where=direction != 0.0)
            middle = origin + direction * (spot.t_in + min(spot.t_out, ahead.min())) / 2.0
            assert (middle >= np.array(spot.low) - 1e-3).all()
            assert (middle <= np.array(spot.high) + 1e-3).all()


@pytest.mark.parametrize("key", WALKED)
def test_the_nearest_hit_was_tested(walks, key):
    for walked in walks[key]:
        tested = {prim_id for step in walked.steps for prim_id in step.tested}
        assert walked.prim_id in tested | {-1}
        seen = -1
        for step in walked.steps:
            if step.prim_id != seen:
                assert step.kernel == "intersect"
                assert step.prim_id in step.tested
                seen = step.prim_id


def test_grid_cells_are_neighbors(tracers, walks):
    nx, ny, _ = tracers["grid"].structure.lattice.counts
    longest = 0
    for walked in walks["grid"]:
        cells = np.array([(cell % nx, cell // nx % ny) for cell in walked.cells]).reshape(-1, 2)
        assert (np.abs(np.diff(cells, axis=0)).sum(axis=1) == 1).all()
        longest = max(longest, len(cells))
    assert longest > nx // 2


def test_the_three_traversals_see_the_same_leaves(walks):
    """Foley 2005, section 4.1, and with the same triangles tested."""
    most = 0
    for one, two, three in zip(
        walks["kdtree-stack"], walks["kdtree-restart"], walks["kdtree-backtrack"], strict=True
    ):
        assert one.cells == two.cells == three.cells
        tests = [[step.tested for step in w.steps if step.tested] for w in (one, two, three)]
        assert tests[0] == tests[1] == tests[2]
        assert len(set(one.cells)) == len(one.cells)
        assert two.counts["restarts"] == three.counts["backtracks"]
        most = max(most, len(one.cells))
    assert most > 4


def test_the_stack_is_what_continue_pops(walks):
    pushed = 0
    for walked in walks["kdtree-stack"]:
        stack = ()
        for step in walked.steps:
            if step.kernel == "continue" and step.after not in (RayState.DONE, RayState.SHADING):
                assert (stack[0].number, stack[0].t_out) == (step.to.number, step.to.t_out)
                assert step.stack == stack[1:]
            elif len(step.stack) > len(stack):
                assert step.kernel == "down"
                assert step.stack[1:] == stack
                pushed += 1
                # It begins where the near child ends, and ends where their parent does.
                assert step.stack[0].t_in == step.to.t_out
                assert step.stack[0].t_out == step.at.t_out
            else:
                assert step.stack == stack
            stack = step.stack
    assert pushed > 10
    for key in ("kdtree-restart", "kdtree-backtrack"):
        assert not any(step.stack for walked in walks[key] for step in walked.steps)


def test_a_bvh_puts_children_aside_the_nearest_on_top(walks):
    put = 0
    for walked in walks["bvh"]:
        waiting = ()
        for step in walked.steps:
            numbers = [spot.number for spot in step.stack]
            starts = [spot.t_in for spot in step.stack]
            if step.kernel == "traverse" and step.at is not None and step.at.kind == "node":
                added = step.stack[: max(len(numbers) + 1 - len(waiting), 0)]
                assert [spot.t_in for spot in added] == sorted(spot.t_in for spot in added)
                if step.to is not None and added:
                    assert step.to.t_in <= starts[0]
                    put += 1
            else:  # what is too far is left out as soon as a nearer hit is known
                assert numbers == [number for number in waiting if number in numbers]
            waiting = numbers if step.to is None else [step.to.number, *numbers]
    assert put > 10


@pytest.mark.parametrize("key", WALKED)
def test_a_walk_can_end_early(plan, tracers, walks, key):
    ray, longest = max(zip(RAYS, walks[key], strict=True), key=lambda pair: len(pair[1].steps))
    short = walk(tracers[key], *plan.ray(*ray), max_steps=3)
    assert (short.is_whole, longest.is_whole) == (False, True)
    assert short.steps == longest.steps[:3]
    assert sum(short.counts.values()) <= sum(longest.counts.values())


@pytest.mark.parametrize("key", FLAT)
def test_boxes_fill_the_space_and_reach_from_the_floor_to_the_top(plan, tracers, key):
    """Cells, leaves or sectors lie side by side: a ray in between walks in two dimensions."""
    structure = tracers[key].structure
    chart = map_of(structure)
    counts = {
        "grid": lambda: structure.lattice.cell_count,
        "kdtree": lambda: len(structure.tree.nodes),
        "graph": lambda: structure.graph.sector_count,
    }
    numbers = range(counts[structure.name]())
    boxes = np.array([chart.box(n) for n in numbers if chart.kind(n) != "split"])
    assert len(boxes) > 20
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    areas = np.prod(boxes[:, 1, :2] - boxes[:, 0, :2], axis=1)
    assert areas.min() >= 0.0
    assert areas.sum() == pytest.approx(np.prod((high - low)[:2]), rel=1e-5)
    assert boxes[:, 0, 2].max() < 0.01 * plan.z
    assert boxes[:, 1, 2].min() > 1.99 * plan.z


def test_sectors_are_left_through_the_face_that_is_named(walks):
    """Boxes share the plane of the face, whose links lead there."""
    crossings = 0
    for walked in walks["graph"]:
        for step in walked.steps:
            if step.at is None or step.at.number == step.to.number:
                assert step.face is None
                continue
            side, axis = step.face.split()
            k = "xyz".index(axis)
            assert (walked.direction[k] > 0.0) == (side == "high")
            mine = step.at.high if side == "high" else step.at.low
            theirs = step.to.low if side == "high" else step.to.high
            assert mine[k] == theirs[k]
            assert step.to.t_in == pytest.approx(step.at.t_out, abs=1e-5)
            crossings += 1
    assert crossings > 20


def test_foleys_layout_gives_the_same_walk(plan, walks):
    """Nodes are numbered by their rows in the tree, whatever a search calls them."""
    for traversal in ("stack", "backtrack"):
        tree = rs.KdTree(layout="foley", traversal=traversal, **stadium.TREE)
        tracer = rs.Tracer(plan.scene, tree)
        for ray, same in zip(RAYS[:6], walks[f"kdtree-{traversal}"], strict=False):
            assert walk(tracer, *plan.ray(*ray)) == same


def test_a_short_stack_forgets_and_begins_again(rng):
    scene = rs.Scene.from_arrays(*soup(300, 1))
    options = {"traversal": "short-stack", "intersection_cost": 12.0}
    tracer = rs.Tracer(scene, "kdtree", **options)
    dropped = popped = restarted = 0
    for origin, toward in rng.uniform(-1.0, 1.0, (20, 2, 3)):
        stack = ()
        for step in walk(tracer, 2.0 * origin, toward - 2.0 * origin).steps:
            ends = [spot.t_out for spot in step.stack]
            assert ends == sorted(ends)
            assert len(ends) <= PLACES
            if step.kernel == "down" and len(stack) == PLACES and step.stack != stack:
                assert step.stack[1:] == stack[:-1]
                dropped += 1
            if step.counts.get("restarts"):
                assert not stack
                restarted += 1
            elif step.kernel == "continue" and stack:
                popped += step.stack == stack[1:]
            stack = step.stack
    assert dropped > 0
    assert popped > 0
    assert restarted > 0


def test_two_levels_of_a_grid(plan):
    tracer = rs.Tracer(plan.scene, "grid", resolution=(6, 5, 1), levels=2, counters=True)
    assert len(tracer.structure.fine.cells)
    first_fine = tracer.structure.lattice.cell_count
    chart, deepest = map_of(tracer.structure), 0
    for ray in RAYS[:8]:
        ray = plan.ray(*ray)
        walked = walk(tracer, *ray)
        assert walked.t == tracer.first_hit(*ray).t
        assert walked.counts["tests"] == tracer.counters.tests
        for step in walked.steps:
            for prim_id in step.tested:
                wall = plan.walls[prim_id // 2]
                low, high = chart.box(step.at.number)[:, :2]
                assert (wall.max(axis=0) >= low - 0.01).all()
                assert (wall.min(axis=0) <= high + 0.01).all()
            deepest = max(deepest, step.at.number if step.at else 0)
    assert deepest >= first_fine
    fine = tracer.structure.fine
    sizes = np.prod(fine.counts, axis=1)
    firsts = first_fine + np.cumsum(sizes) - sizes
    for cell, first, last in zip(fine.cells, firsts, firsts + sizes - 1, strict=True):
        corners = [chart.box(int(first))[0], chart.box(int(last))[1]]
        assert chart.box(int(cell)) == pytest.approx(np.array(corners))


def test_a_scene_far_away_walks_the_same():
    """The machine works in its local frame; walks are in world space."""
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    near = stadium.prisms(square)
    far = stadium.prisms(square + 1e6)
    for structure in ("grid", "kdtree", "graph"):
        ways = []
        for plan, shift in ((near, 0.0), (far, 1e6)):
            tracer = rs.Tracer(plan.scene, structure)
            ways.append(walk(tracer, *plan.ray([shift + 1.0, shift + 1.25], [1.0, 0.5])))
        a, b = ways
        assert [step.kernel for step in a.steps] == [step.kernel for step in b.steps]
        assert a.t == b.t == 3.0
        for one, other in zip(a.steps, b.steps, strict=True):
            assert one.to.t_in == other.to.t_in
            assert np.subtract(other.to.low, one.to.low)[:2] == pytest.approx(1e6)


def test_what_is_no_walk_is_said():
    plan = stadium.prisms([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    tracer = rs.Tracer(plan.scene, "grid")
    with pytest.raises(ValueError, match="expected one ray, got 2"):
        walk(tracer, np.zeros((2, 3)), [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="is invalid"):
        walk(tracer, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="grid, kdtree, graph or bvh, got one of 'brute'"):
        walk(rs.Tracer(plan.scene, "brute"), [0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
