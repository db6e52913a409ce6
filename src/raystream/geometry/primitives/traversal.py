"""Rays through triangles, height fields, spheres and shapes: one search through all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.fields.cells import FIELD_BYTES, traverse_all_cells, traverse_field
from raystream.geometry.primitives.records import FieldRecord, PrimitiveAddresses, SphereBlock
from raystream.geometry.shapes.shape import intersect_shape, shape_of
from raystream.geometry.spheres.sphere import ExactRay, intersect_spheres, load_exact
from raystream.jit.cpu import device
from raystream.jit.views import address_of
from raystream.kernels.leaf_block import block_ray
from raystream.kernels.queries import RaySearches, note_status, ray_filter, searches_of
from raystream.kernels.ray import Ray, prepare_ray
from raystream.kernels.ray_source import load_ray
from raystream.kernels.search import begin_search, is_full
from raystream.kernels.shapes import ShapeRecord
from raystream.kernels.tally import tally_of
from raystream.structures.brute.traversal import traverse as traverse_brute
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.traversal import traverse as traverse_bvh
from raystream.structures.bvh.traversal import tree_traversal
from raystream.structures.bvh.walks.single import STACK_BYTES as TREE_BYTES

_TREE = np.uint64(TREE_BYTES)

#: Memory of a traversal: of the trees in turn, then of height fields.
STACK_BYTES = TREE_BYTES + FIELD_BYTES


class RayScene(NamedTuple):
    """The primitives with the ray in float64."""

    primitives: PrimitiveAddresses
    exact: ExactRay


class _ExactTree(NamedTuple):
    """A tree of spheres or shapes with a ray; by the names that `tree_traversal` reads."""

    nodes: np.uint64
    leaves: np.uint64
    ray: Ray
    exact: ExactRay


@device
def search_spheres(tree, child, line, search, stack):  # noqa: ARG001
    """Offer the hits of a leaf's spheres to a search."""
    block = leaf_address(tree.leaves, child)
    return intersect_spheres(block, tree.ray, tree.exact, search)


@device
def _search_shape(tree, child, line, search, stack):  # noqa: ARG001
    return intersect_shape(shape_of(tree.leaves, child), tree.ray, tree.exact, search)


_traverse_spheres = device(tree_traversal(search_spheres))
_traverse_shapes = device(tree_traversal(_search_shape))


@device
def _without(tree, ray, search, stack):  # noqa: ARG001
    return search


def trees_traversal(search_triangles, search_spheres, tree_bytes, search_shapes=_without):
    """Make the traversal of the trees of triangles, height fields, spheres and shapes, in turn.

    Parameters
    ----------
    search_triangles, search_spheres, search_shapes : device function
        Traversals of a tree, see `kernels.queries.ray_queries`: of the primitives' own, and of
        those with an `ExactRay` [default: shapes are not searched].
    tree_bytes : uint64
        Their memory, before that of height fields.
    """

    def traverse(scene, ray, search, stack):
        held = scene.primitives
        search = search_triangles(held, ray, search, stack)
        line = block_ray(ray)
        for k in range(held.field_count):
            if is_full(search):
                return search
            field = FieldRecord(held.fields, k)
            search = traverse_field(field, ray, line, search, stack + tree_bytes)
        if is_full(search):
            return search
        tree = _ExactTree(held.sphere_nodes, held.sphere_blocks, ray, scene.exact)
        search = search_spheres(tree, ray, search, stack)
        if is_full(search):
            return search
        tree = _ExactTree(held.shape_nodes, held.shapes, ray, scene.exact)
        return search_shapes(tree, ray, search, stack)

    return traverse


#: Search the trees of the processor's layout.
traverse_trees = device(trees_traversal(traverse_bvh, _traverse_spheres, _TREE, _traverse_shapes))


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
    for k in range(held.shape_count):
        if is_full(search):
            return search
        search = intersect_shape(ShapeRecord(held.shapes, k), ray, scene.exact, search)
    return search


def primitive_searches(traverse) -> RaySearches:
    """Make the searches of a ray with a traversal; see `kernels.queries.searches`."""

    @device
    def search_ray(i, scene, goal, memory):
        source, frame = scene.source, scene.frame
        ray = load_ray(source, i, frame)
        note_status(scene.status, i, ray.status)
        exact = load_exact(source, i, ray.t_offset / ray.t_scale, frame)
        local = prepare_ray(ray.origin, ray.direction, frame.max_coordinate)
        tally, filter_ = tally_of(scene.tallies, i), ray_filter(scene.filter, i, ray)
        search = begin_search(ray.t_min, ray.t_max, goal, tally, filter_, None)
        found = traverse(RayScene(scene.arrays, exact), local, search, memory)
        return found, ray

    return searches_of(search_ray)
