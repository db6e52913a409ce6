"""A search that continues from structure to structure, each with some of the triangles."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import lattice_soup, soup
from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.cpu import device
from raystream.jit.simd import store
from raystream.kernels.hits import HitArrays, Sink
from raystream.kernels.queries import ray_queries
from raystream.kernels.ray import SceneFrame
from raystream.kernels.search import is_full
from raystream.machines.batch import trace_batch
from raystream.structures import STRUCTURES, build_structure
from raystream.structures.brute.traversal import traverse as in_brute
from raystream.structures.bvh.traversal import traverse as in_bvh
from raystream.structures.bvh.walks.single import STACK_BYTES
from raystream.structures.graph.traversal import traverse as in_graph
from raystream.structures.grid.traversal import traverse as in_grid
from raystream.structures.kdtree.traversal import traverse as in_kdtree
from raystream.structures.single_kernels import with_single

_NOWHERE = np.uint64(0)


class Views(NamedTuple):
    """Each structure's arrays, in the order of the search."""

    kdtree: object
    grid: object
    bvh: object
    graph: object
    brute: object


@device
def in_all(views, ray, search, stack):
    search = in_kdtree(views.kdtree, ray, search, stack)
    if not is_full(search):
        search = in_grid(views.grid, ray, search, stack)
    if not is_full(search):
        search = in_bvh(views.bvh, ray, search, stack)
    if not is_full(search):
        store(stack, _NOWHERE)  # not what the BVH left there
        search = in_graph(views.graph, ray, search, stack)
    if not is_full(search):
        search = in_brute(views.brute, ray, search, stack)
    return search


QUERIES = ray_queries(in_all, STACK_BYTES)

OPTIONS = {"bvh": {"max_leaf_size": 1}}


def parts_of(triangles):
    """A structure of each kind for every fifth triangle."""
    number = np.arange(len(triangles))
    for k, name in enumerate(Views._fields):
        solid = (number % len(Views._fields) == k) & np.isin(number, triangles.prim_ids)
        corners = triangles.corners[solid]
        bounds = np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])
        some = Triangles.from_solid(
            triangles.corners,
            triangles.mesh_splits,
            triangles.center,
            triangles.scale,
            solid,
            0,
            bounds,
        )
        yield build_structure(name, some, **OPTIONS.get(name, {}))


@pytest.fixture(params=["soup", "ties"])
def case(request, rng):
    """Brute force for all triangles; structures with some each, in turn; and rays."""
    mesh = soup(600, 1) if request.param == "soup" else lattice_soup(150)
    triangles = rs.Scene.from_arrays(*mesh).triangles
    parts = list(parts_of(triangles))
    assert {part.name for part in parts} == set(STRUCTURES)
    count = 400
    low, high = triangles.bounds
    origins = (low + rng.random((count, 3)) * (high - low)).astype(np.float32)
    directions = rng.uniform(1, 2, (count, 3)) * rng.choice([-1, 1], (count, 3))
    t_min = np.where(rng.random(count) < 0.8, 0, 0.2).astype(np.float32)
    t_max = np.where(rng.random(count) < 0.8, np.inf, 0.5).astype(np.float32)
    batch = RayBatch(origins, directions.astype(np.float32), t_min, t_max)
    brute = build_structure("brute", triangles)
    arrays = Views(*(part.view for part in parts))
    together = SimpleNamespace(
        queries=QUERIES,
        view_for=lambda *_: arrays,
        frame=SceneFrame.of(triangles),
        rays_per_call=100,
        least_rays=256,
        many_ray_kernels={},
        options=None,
        parts=parts,  # whose arrays are read by address
    )
    together.batch_kernels = with_single(together)
    return brute, together, batch


def answers(case, query, fill=None):
    """The hits of brute force, and of all structures together."""
    *structures, batch = case
    for structure in structures:
        sink = Sink.of(query, len(batch))
        if fill is not None:
            sink.splits, sink.hits = fill, HitArrays.empty(int(fill[-1]))
        trace_batch(structure, query, batch, sink)
        yield sink


def test_the_nearest_hit_of_all(case):
    expected, found = answers(case, Query(Kind.FIRST_HIT))
    assert (expected.hits.prim_id >= 0).any()
    for column, right in zip(found.hits, expected.hits, strict=True):
        assert_same_bits(column, right)


def test_any_hit_of_all(case):
    expected, found = answers(case, Query(Kind.ANY_HIT))
    assert_same_bits(found.seen, expected.seen)


@pytest.mark.parametrize("limit", [1, 3, UNLIMITED])
@pytest.mark.parametrize("surfaces", [False, True])
def test_counts_of_all(case, surfaces, limit):
    expected, found = answers(case, Query(Kind.COUNT_HITS, surfaces, limit))
    assert_same_bits(found.counts, expected.counts)


@pytest.mark.parametrize("most", [2, 50])
def test_the_nearest_hits_of_all(case, most):
    counted, _ = answers(case, Query(Kind.COUNT_HITS, limit=most))
    splits = np.concatenate([[0], np.cumsum(counted.counts)])
    expected, found = answers(case, Query(Kind.MULTI_HIT), splits)
    for column, right in zip(found.hits, expected.hits, strict=True):
        assert_same_bits(column, right)
