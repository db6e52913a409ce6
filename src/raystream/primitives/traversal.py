"""Rays through a scene of triangles, height fields and spheres: one search through all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.views import address_of
from raystream.kernels.leaf_block import block_ray
from raystream.kernels.queries import Searches, note_status
from raystream.kernels.ray import Ray, prepare_ray
from raystream.kernels.ray_source import load_direction, load_limits, load_origin, local_ray
from raystream.kernels.search import begin_search, is_full
from raystream.primitives.field import FIELD_BYTES, traverse_all_cells, traverse_field
from raystream.primitives.records import FieldRecord, PrimitiveAddresses, SphereBlock
from raystream.primitives.sphere import ExactRay, exact_ray, intersect_spheres
from raystream.structures.brute.traversal import traverse as traverse_brute
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.traversal import STACK_BYTES as TREE_BYTES
from raystream.structures.bvh.traversal import traverse as traverse_bvh
from raystream.structures.bvh.traversal import tree_traversal

_TREE = np.uint64(TREE_BYTES)

#: Memory of a traversal: of the trees in turn, then of height fields.
STACK_BYTES = TREE_BYTES + FIELD_BYTES


class RayScene(NamedTuple):
    """The primitives with the ray in float64."""

    primitives: PrimitiveAddresses
    exact: ExactRay


class _SphereTree(NamedTuple):
    """The spheres' tree with a ray; by the names that `tree_traversal` reads."""

    nodes: np.uint64
    leaves: np.uint64
    ray: Ray
    exact: ExactRay


@device
def _search_spheres(tree, child, line, search, stack):  # noqa: ARG001
    block = leaf_address(tree.leaves, child)
    return intersect_spheres(block, tree.ray, tree.exact, search)


_traverse_spheres = device(tree_traversal(_search_spheres))


@device
def traverse_trees(scene, ray, search, stack):
    """Search the trees of triangles, of each height field and of spheres, one after another."""
    held = scene.primitives
    search = traverse_bvh(held, ray, search, stack)
    line = block_ray(ray)
    for k in range(held.field_count):
        if is_full(search):
            return search
        field = FieldRecord(held.fields, k)
        search = traverse_field(field, ray, line, search, stack + _TREE)
    if is_full(search):
        return search
    tree = _SphereTree(held.sphere_nodes, held.sphere_blocks, ray, scene.exact)
    return _traverse_spheres(tree, ray, search, stack)


@device
def traverse_all(scene, ray, search, stack):
    """Search all primitives, without trees."""
    held = scene.primitives
    if not (search.t_min <= search.t_far):
        return search
    search = traverse_brute(held, ray, search, stack)
    line = block_ray(ray)
    for k in range(held.field_count):
        if is_full(search):
            return search
        field = FieldRecord(held.fields, k)
        search = traverse_all_cells(field, ray, line, search, stack + _TREE)
    for k in range(held.block_count):
        if is_full(search):
            return search
        block = address_of(SphereBlock(held.sphere_blocks, k))
        search = intersect_spheres(block, ray, scene.exact, search)
    return search


def primitive_searches(traverse) -> Searches:
    """Make the searches of a ray with a traversal; see `kernels.queries.searches`."""

    @device
    def of_numbers(numbers, scene, goal):
        ox, oy, oz, dx, dy, dz, t_min, t_max = numbers
        frame = scene.frame
        ray = local_ray(ox, oy, oz, dx, dy, dz, t_min, t_max, frame)
        exact = exact_ray((ox, oy, oz), (dx, dy, dz), ray.t_offset / ray.t_scale, frame)
        local = prepare_ray(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, frame.max_coordinate)
        search = begin_search(
            ray.t_min,
            ray.t_max,
            goal.capacity,
            goal.hits,
            goal.first_row,
            goal.surfaces,
            goal.counters,
            None,
            None,
        )
        found = traverse(RayScene(scene.arrays, exact), local, search, scene.stack)
        return found, ray

    @device
    def of_batch(i, scene, goal):
        ox, oy, oz = load_origin(scene.source, i)
        dx, dy, dz = load_direction(scene.source, i)
        t_min, t_max = load_limits(scene.source, i)
        search, ray = of_numbers((ox, oy, oz, dx, dy, dz, t_min, t_max), scene, goal)
        note_status(scene.status, i, ray.status)
        return search, ray

    return Searches(of_batch, of_numbers)
