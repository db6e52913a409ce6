"""The steps of a search in the BVH, run one at a time on rays whose state is in memory."""

import copy
from typing import NamedTuple

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import dented_sphere, lattice_soup, soup, sticks
from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, scratch
from raystream.kernels.hits import HitArrays, Sink, hit_addresses
from raystream.kernels.leaf_block import BLOCK, PRIM_IDS, block_ray, intersect_block, triangle_count
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import SceneFrame, prepare_ray
from raystream.kernels.search import Search, SearchGoal, begin_search, is_full, sort_hits, wants_any
from raystream.kernels.tally import COLUMNS, LEAVES, STEPS, TESTS, add_to, new_tallies, tally_of
from raystream.machines import Branching
from raystream.structures.bvh.layout import MAX_DEPTH, WIDTH
from raystream.structures.bvh.statistics import statistics
from raystream.structures.bvh.steps import (
    begin,
    is_leaf,
    leaf_blocks,
    next_entry,
    stack_half,
    visit,
)
from raystream.structures.bvh.traversal import traverse
from raystream.structures.bvh.walks.single import STACK_BYTES

_ONE = np.uint64(1)
_NONE = np.uint64(0)
_INF = np.float32(np.inf)

# Next steps of a ray.
_POP, _VISIT, _INTERSECT, _DONE = range(4)

#: Written on each half of a stack, and how many bytes of it follow those that are needed.
_CANARY = 0xA5
_CANARY_BYTES = 64


class States(NamedTuple):
    """State of each ray's search; all of shape (N,)."""

    stage: np.ndarray
    top: np.ndarray
    child: np.ndarray
    block: np.ndarray
    end: np.ndarray
    count: np.ndarray
    t_far: np.ndarray


def new_states(rays):
    count = len(rays.t_max)
    stage = np.full(count, _POP, np.int32)
    top, block, end, found = (np.zeros(count, np.uint64) for _ in range(4))
    return States(stage, top, np.zeros(count, np.int32), block, end, found, rays.t_max.copy())


class Slots(NamedTuple):
    """First row and number of the hits that each ray wants, of shape (N,), uint64."""

    first: np.ndarray
    capacity: np.ndarray


@kernel
def set_off(tree, rays, states, stacks, stride, half):
    for i in range(len(states.stage)):
        stack = address(stacks) + np.uint64(i) * np.uint64(stride)
        states.top[i] = begin(tree, rays.t_min[i], rays.t_max[i], stack, np.uint64(half))


@device
def rows_of(out):
    """Addresses of hits, or None."""
    if out is None:
        return None
    return hit_addresses(out)


@kernel
def run_pass(
    tree, max_coordinate, rays, states, stacks, stride, half, surfaces, slots, out, tallies
):
    """One step of each ray. Returns how many were not done."""
    o, d = rays.origins, rays.directions
    half_bytes = np.uint64(half)
    active = 0
    for i in range(len(states.stage)):
        stage = states.stage[i]
        if stage == _DONE:
            continue
        active += 1
        stack = address(stacks) + np.uint64(i) * np.uint64(stride)
        top, t_min, t_far = states.top[i], rays.t_min[i], states.t_far[i]
        first, capacity = slots.first[i], slots.capacity[i]
        tally = tally_of(address(tallies), np.uint64(i))
        line = block_ray(prepare_ray(o[i], d[i], max_coordinate))
        if stage == _POP:
            found, child, top = next_entry(stack, half_bytes, top, t_far)
            states.top[i], states.child[i] = top, child
            if not found:
                stage = _DONE
            elif is_leaf(child):
                add_to(tally, LEAVES, _ONE)
                states.block[i], states.end[i] = leaf_blocks(tree, child)
                stage = _INTERSECT
            else:
                stage = _VISIT
        elif stage == _VISIT:
            add_to(tally, STEPS, _ONE)
            child = states.child[i]
            to = rows_of(out)
            goal = SearchGoal(capacity, to, first, surfaces)
            is_any = wants_any(begin_search(t_min, t_far, goal, tally, None, None))
            states.top[i] = visit(tree, child, line, t_min, t_far, is_any, stack, half_bytes, top)
            stage = _POP
        else:
            block = states.block[i]
            add_to(tally, TESTS, triangle_count(block + PRIM_IDS))
            count, to = states.count[i], rows_of(out)
            search = Search(
                t_min, t_far, count, SearchGoal(capacity, to, first, surfaces), tally, None, None
            )
            search = intersect_block(block, line, search, t_min, _INF)
            states.count[i], states.t_far[i] = search.hit_count, search.t_far
            states.block[i] = block + BLOCK
            if is_full(search):
                stage = _DONE
            elif block + BLOCK == states.end[i]:
                stage = _POP
        states.stage[i] = stage
    return active


@kernel
def fused(tree, max_coordinate, rays, surfaces, slots, out, counts, tallies):
    """`traverse` for each ray; the number of its hits."""
    o, d = rays.origins, rays.directions
    stack = scratch(STACK_BYTES)
    for i in range(len(counts)):
        ray = prepare_ray(o[i], d[i], max_coordinate)
        first, capacity = slots.first[i], slots.capacity[i]
        t_min, t_max, tally = rays.t_min[i], rays.t_max[i], tally_of(address(tallies), np.uint64(i))
        goal = SearchGoal(capacity, rows_of(out), first, surfaces)
        search = begin_search(t_min, t_max, goal, tally, None, None)
        search = traverse(tree, ray, search, stack)
        counts[i] = search.hit_count


@kernel
def sort_all(slots, counts, out):
    to = hit_addresses(out)
    for i in range(len(counts)):
        sort_hits(to, slots.first[i], counts[i])


def new_hits(slots, keep):
    """Hits of t = inf and no triangle; None if none are kept."""
    if not keep:
        return None
    out = HitArrays.empty(int((slots.first + slots.capacity).max()))
    for array, miss in zip(out, (np.inf, 0, 0, -1), strict=True):
        array[:] = miss
    return out


def run_fused(structure, rays, surfaces, keep, slots):
    """Counts, hits and tallies of `traverse`."""
    count, out = len(rays.t_max), new_hits(slots, keep)
    counts, tallies = np.zeros(count, np.uint64), new_tallies(count)
    max_coordinate = structure.triangles.max_coordinate
    arguments = surfaces, slots, out, counts, tallies
    fused(structure.view, max_coordinate, rays, *arguments)
    return counts, out, tallies


def run_steps(structure, rays, surfaces, keep, slots):
    """The same of passes over all rays; checks that no stack is overrun."""
    count, out = len(rays.t_max), new_hits(slots, keep)
    states, tallies = new_states(rays), new_tallies(count)
    need = structure.stack_half
    half = need + _CANARY_BYTES
    stacks = np.full((count, 2, half), _CANARY, np.uint8)
    where = stacks, 2 * half, half
    set_off(structure.view, rays, states, *where)
    constants = surfaces, slots, out, tallies
    max_coordinate = structure.triangles.max_coordinate
    while run_pass(structure.view, max_coordinate, rays, states, *where, *constants):
        pass
    assert (stacks[:, :, need:] == _CANARY).all()
    return states.count, out, tallies


def both(structure, rays, surfaces, keep, slots):
    """Counts, sorted hits and tallies, the same ones from both."""
    arguments = structure, rays, surfaces, keep, slots
    counts, out, tallies = run_fused(*arguments)
    again, again_out, again_tallies = run_steps(*arguments)
    assert_same_bits(again, counts)
    assert_same_bits(again_tallies, tallies)
    if keep:
        for hits in (out, again_out):
            sort_all(slots, counts, hits)
        for column, other in zip(again_out, out, strict=True):
            assert_same_bits(column, other)
    return counts, out, tallies


def local_rays(triangles, count, rng):
    """Rays from around the triangles, most of them aimed at a point of one."""
    corners = triangles.corners[triangles.prim_ids]
    low, high = ([-1] * 3, [1] * 3) if not len(corners) else triangles.bounds
    size = np.max(np.subtract(high, low))
    origins = low + rng.random((count, 3)) * np.subtract(high, low)
    # Not so far outside that a machine would advance the origins, as the steps do not.
    away = np.clip(rng.normal(size=(count, 3)), -1.5, 1.5) * size
    origins += away * rng.choice([0, 0.01, 1], (count, 1))
    targets = rng.normal(size=(count, 3)) * size
    if len(corners):
        weights = rng.dirichlet([1, 1, 1], count)
        aimed = corners[rng.integers(len(corners), size=count)]
        targets[count // 8 :] = (weights[:, :, None] * aimed).sum(axis=1)[count // 8 :]
    directions = (targets - origins).astype(np.float32)
    directions[np.abs(directions).max(axis=1) == 0] = 1
    directions = np.ldexp(directions, 1 - np.frexp(np.abs(directions).max(axis=1))[1][:, None])
    t_min = np.where(rng.random(count) < 0.8, 0, rng.random(count) * size).astype(np.float32)
    t_max = np.where(rng.random(count) < 0.8, np.inf, rng.random(count) * size)
    return LocalRays(origins.astype(np.float32), directions, t_min, t_max.astype(np.float32))


def nested(count=1200):
    """Triangles that grow by a factor from one to the next: the deepest trees there are."""
    base = np.array([[0, 0, 0], [1, 0, 0.1], [0, 1, 0.2]])
    sizes = 2.0 ** np.linspace(0, -60, count)
    vertices = (base[None] * sizes[:, None, None] + sizes[:, None, None] * 3).reshape(-1, 3)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def coincident(count=500):
    """A triangle many times over, and a few others."""
    vertices, faces = soup(20, 5)
    return vertices, np.vstack([faces, np.repeat(faces[:1], count, axis=0)])


MESHES = {
    "soup": (soup(400, 1), {}),
    "small triangles": (soup(3000, 2, 0.02), {}),
    "closed mesh": (dented_sphere(3), {}),
    "ties": (lattice_soup(150), {}),
    "leaves of 1": (soup(400, 3), {"max_leaf_size": 1}),
    "leaves of 32": (soup(400, 4), {"max_leaf_size": 32}),
    "nested": (nested(), {"max_leaf_size": 1}),
    "nested, fast": (nested(), {"quality": "fast"}),
    "coincident": (coincident(), {"max_leaf_size": 1}),
    "sticks": (sticks(1500, 0.01), {}),
    "one triangle": (soup(1), {}),
    "none": ((np.zeros((0, 3)), np.zeros((0, 3), int)), {}),
}


@pytest.fixture(params=MESHES)
def pair(request):
    """A BVH, and brute force."""
    (vertices, faces), options = MESHES[request.param]
    scene = rs.Scene.from_arrays(vertices, faces)
    return rs.Tracer(scene, **options).structure, rs.Tracer(scene, "brute").structure


def slots_for(ray_count, capacity):
    """Room for as many hits for each ray."""
    each = np.full(ray_count, capacity, np.uint64)
    return Slots(np.arange(ray_count, dtype=np.uint64) * np.uint64(capacity), each)


def answered(structure, kind, rays, surfaces=False, most=UNLIMITED):
    """Hits of the branching machine for local rays, one by one."""
    query, local = Query(kind, surfaces, most), copy.copy(structure)
    local.frame, local.many_ray_kernels = SceneFrame.identity(structure.triangles), {}
    sink = Sink.of(query, len(rays.t_max))
    Branching(local).run(query, RayBatch(*rays), sink)
    return sink


def test_steps_give_the_bits_of_brute_force_and_the_tallies_of_traverse(pair, rng):
    structure, brute = pair
    rays = local_rays(structure.triangles, 300, rng)
    count = len(rays.t_max)
    one, unlimited = slots_for(count, 1), Slots(*np.zeros((2, count), np.uint64))
    unlimited.capacity[:] = UNLIMITED

    expected = answered(brute, Kind.FIRST_HIT, rays).hits
    _, first, _ = both(structure, rays, False, True, one)
    for column, wanted in zip(first, expected, strict=True):
        assert_same_bits(column, wanted)
    seen, _, _ = both(structure, rays, False, False, one)
    assert_same_bits(seen != 0, answered(brute, Kind.ANY_HIT, rays).seen)

    for surfaces in (False, True):
        wanted = answered(brute, Kind.COUNT_HITS, rays, surfaces).counts
        counts, _, tallies = both(structure, rays, surfaces, False, unlimited)
        assert_same_bits(counts.astype(np.int64), wanted)
        assert (tallies[:, COLUMNS.index("tests")] >= counts).all()
        for most in (3, max(1, wanted.max(initial=0))):
            splits = np.zeros(count + 1, np.int64)
            np.cumsum(np.minimum(wanted, most), out=splits[1:])
            rows = Slots(splits[:-1].astype(np.uint64), np.diff(splits).astype(np.uint64))
            some = Slots(rows.first, np.maximum(rows.capacity, 1))  # a miss keeps none
            filled = answered(brute, Kind.MULTI_HIT, rays, surfaces, most)
            assert_same_bits(filled.splits, splits)
            _, many, _ = both(structure, rays, surfaces, True, some)
            for column, right in zip(many, filled.hits, strict=True):
                assert_same_bits(column[: splits[-1]], right)


def test_the_tally_counts_real_triangles_of_leaves_entered():
    vertices, faces = coincident(0)
    one = np.repeat(faces[:1], 30, axis=0)
    for triangle_count_, leaf_size in ((3, 4), (30, 32), (1, 1)):
        scene = rs.Scene.from_arrays(vertices, one[:triangle_count_])
        structure = rs.Tracer(scene, max_leaf_size=leaf_size).structure
        corners = structure.triangles.corners[0]
        origin = corners.mean(axis=0) - np.float32(4) * np.array([1, 0.2, 0.3], np.float32)
        direction = np.array([1, 0.2, 0.3], np.float32)
        limits = np.array([0, 0, 0, 1], np.float32), np.array([np.inf, 1, -1, 0], np.float32)
        rays = LocalRays(np.tile(origin, (4, 1)), np.tile(direction, (4, 1)), *limits)
        slots = Slots(np.zeros(4, np.uint64), np.full(4, UNLIMITED, np.uint64))
        counts, _, tallies = both(structure, rays, False, False, slots)
        assert counts.tolist() == [triangle_count_, 0, 0, 0]
        met = [1, 1, triangle_count_, 0, 0, 0, 0, 0]
        assert tallies.tolist() == [met, [1] + [0] * 7, [0] * 8, [0] * 8]


def test_a_stack_needs_no_more_than_its_tree_is_deep(pair):
    structure, _ = pair
    depth = int(statistics(structure.tree)["depth"])
    assert depth <= MAX_DEPTH
    need = stack_half(structure.tree)
    assert need == structure.stack_half
    assert need % 32 == 0
    most = 4 * ((WIDTH - 1) * max(depth, 1) + 1)
    assert 32 <= need <= -(-most // 32) * 32 <= STACK_BYTES // 2
