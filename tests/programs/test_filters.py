from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import EVERY_QUERY, assert_same_bits
from programs.layers import layers_rays, layers_scene, ranks, sums
from raystream.programs import Bound, rounds
from raystream.programs.filters import Filter
from strategies import scenes_and_rays


def most_are_ignored(hit):
    return hit.prim_id % 7 == 0


def few_are_ignored(hit):
    if hit.prim_id % 11 == 3:
        return rs.Decision.IGNORE
    return None


def entering(hit):
    return hit.is_entering


def of_one_mesh(hit):
    return rs.Decision.CONTINUE if hit.mesh_id == 2 else rs.Decision.IGNORE


def odd_rays(hit):
    return hit.ray % 2 == 1


def until_even(hit):
    if hit.prim_id % 2 == 0:
        return rs.Decision.STOP
    return rs.Decision.CONTINUE


@pytest.fixture(params=["large pieces", "small pieces"])
def pieces(request, monkeypatch):
    if request.param == "small pieces":
        monkeypatch.setattr(rounds, "FIRST_RAYS", 32)
        monkeypatch.setattr(rounds, "RAYS_PER_BLOCK", 50)
        monkeypatch.setattr(rounds, "FEW_HITS", 0)
        monkeypatch.setattr(rounds, "SEEN_SHARE", 1.0)


def check(tracer, origins, directions, exists, arguments, crossings="triangles", limits=None):
    """Compare all queries with multi_hit's rows, of which those exist that `exists` says."""
    limits = limits or {}
    rays = (origins, directions)
    many = tracer.multi_hit(*rays, crossings=crossings, **limits)
    kept = exists(many)
    counts = sums(many, np.ones(len(many.t)), kept).astype(np.int64)
    counted = tracer.count_hits(*rays, crossings=crossings, **limits, **arguments)
    assert_same_bits(counted, counts)
    for most in (None, 0, 1, 3, 20):
        found = tracer.multi_hit(*rays, max_hits=most, crossings=crossings, **limits, **arguments)
        assert_same_bits(found.status, many.status)
        rows = kept.copy()
        if most is not None:
            order = np.cumsum(kept) - kept  # kept rows before this one
            starts = np.append(order, kept.sum())[many.ray_splits[:-1]]
            rows &= order - starts[many.ray_id] < most
            counts = sums(many, np.ones(len(many.t)), rows).astype(np.int64)
        assert_same_bits(found.counts, counts)
        for name in ("t", "u", "v", "prim_id"):
            assert_same_bits(getattr(found, name), getattr(many, name)[rows])
    if crossings == "triangles":
        hits = tracer.first_hit(*rays, **limits, **arguments)
        assert_same_bits(hits.status, many.status)
        ids = many.ray_id[kept]
        rays_hit, first = np.unique(ids, return_index=True)
        for name, miss in (("t", np.inf), ("u", 0), ("v", 0), ("prim_id", -1)):
            values = getattr(many, name)
            expected = np.full(many.status.size, miss, values.dtype)
            expected[rays_hit] = values[kept][first]
            assert_same_bits(getattr(hits, name).ravel(), expected)
        assert_same_bits(tracer.any_hit(*rays, **limits, **arguments), hits.is_hit)


@pytest.mark.parametrize("make_tracer", EVERY_QUERY, indirect=True)
def test_every_tracer(make_tracer):
    tracer = make_tracer(layers_scene())
    check(
        tracer,
        *layers_rays(),
        lambda many: many.prim_id % 7 == 0,
        {"on_hit": most_are_ignored},
    )


@pytest.mark.parametrize("crossings", ["triangles", "surfaces"])
def test_filters(pieces, crossings):
    tracer = rs.Tracer(layers_scene())
    origins, directions = layers_rays()
    flat = directions.reshape(-1, 3)

    def is_entering(many):
        return (many.normals * flat[many.ray_id]).sum(axis=1) < 0

    cases = {
        most_are_ignored: lambda many: many.prim_id % 7 == 0,
        few_are_ignored: lambda many: many.prim_id % 11 != 3,
        entering: is_entering,
        of_one_mesh: lambda many: many.mesh_id == 2,
        odd_rays: lambda many: many.ray_id % 2 == 1,
    }
    for function, exists in cases.items():
        check(tracer, origins, directions, exists, {"on_hit": function}, crossings)


def by_all_numbers(hit):
    key = np.float64(hit.t) * 7.0 + np.float64(hit.u) * 1e5 + np.float64(hit.v) * 3e5
    return (np.int64(key) + hit.ray) % 3 != 0


@pytest.mark.parametrize("kernel", ["wavefront", "packet", "groups", "single"])
@pytest.mark.parametrize("shape", ["image", "list"])
def test_every_kernel_gives_filters_the_numbers_of_the_hits(kernel, shape, rng):
    """Also in tiles that are not full, and for rays from far away, at any scale."""
    origins, directions = layers_rays(37, 41)
    directions = directions * rng.uniform(0.3, 3.0, (*directions.shape[:2], 1))
    origins[5, ::7, 2] = -1e6
    origins[:, 20, 2] = -0.3e5
    if shape == "list":
        order = rng.permutation(origins.size // 3)
        origins, directions = (one.reshape(-1, 3)[order] for one in (origins, directions))
    vertices = [mesh.vertices * 3.7 for mesh in layers_scene().meshes]
    meshes = [
        rs.Mesh(moved, mesh.faces)
        for moved, mesh in zip(vertices, layers_scene().meshes, strict=True)
    ]
    tracer = rs.Tracer(rs.Scene(meshes), kernel=kernel)

    def exists(many):
        t, u, v = (getattr(many, name).astype(np.float64) for name in "tuv")
        return ((t * 7.0 + u * 1e5 + v * 3e5).astype(np.int64) + many.ray_id) % 3 != 0

    check(tracer, origins * 3.7, directions, exists, {"on_hit": by_all_numbers})


class Limits(NamedTuple):
    low: float
    is_open: bool


class Shares(NamedTuple):
    divisor: int
    is_open: bool


def of_named_constants(hit, constants):
    limits, (shares, factor) = constants
    if limits.is_open and hit.prim_id < limits.low:
        return False
    return (hit.prim_id * np.int64(factor.imag)) % shares.divisor != 0


def of_other_fields(hit, constants):
    return hit.prim_id % constants[0].divisor != 0


def test_constants_are_what_they_were():
    """Named tuples, booleans and complex numbers; the same function with other classes."""
    tracer, rays = rs.Tracer(layers_scene()), layers_rays()
    constants = Limits(np.float32(20.5), True), (Shares(np.uint8(7), False), 1 + 3j)
    check(
        tracer,
        *rays,
        lambda many: (many.prim_id >= 20.5) & (many.prim_id * 3 % 7 != 0),
        {"on_hit": Bound(of_named_constants, constants)},
    )
    constants = (Limits(20.5, False), (Shares(7, True), np.complex64(3j)))
    check(
        tracer,
        *rays,
        lambda many: many.prim_id * 3 % 7 != 0,
        {"on_hit": Bound(of_named_constants, constants)},
    )
    arguments = {"on_hit": Bound(of_other_fields, (Shares(5, True),))}
    check(tracer, *rays, lambda many: many.prim_id % 5 != 0, arguments)
    with pytest.raises(TypeError, match="constants: expected numbers and tuples"):
        tracer.first_hit(*rays, on_hit=Bound(with_constants, ("seven", (3,))))


def test_skipped_triangles(pieces):
    tracer = rs.Tracer(layers_scene())
    origins, directions = layers_rays()
    many = tracer.multi_hit(origins, directions)
    first = tracer.first_hit(origins, directions).prim_id
    check(
        tracer,
        origins,
        directions,
        lambda many: many.prim_id != first.ravel()[many.ray_id],
        {"skip_prim_ids": first},
    )
    rng = np.random.default_rng(3)
    skipped = rng.integers(-1, len(tracer.structure.triangles), (*first.shape, 6))
    skipped[..., 0] = first
    skipped[..., 1].flat[many.ray_id[ranks(many) == 1]] = many.prim_id[ranks(many) == 1]
    rows = skipped.reshape(-1, 6)

    def exists(many):
        return ~(rows[many.ray_id] == many.prim_id[:, None]).any(axis=1)

    check(tracer, origins, directions, exists, {"skip_prim_ids": skipped})
    check(
        tracer,
        origins,
        directions,
        lambda many: exists(many) & (many.prim_id % 7 == 0),
        {"skip_prim_ids": skipped, "on_hit": most_are_ignored},
    )


def test_a_filter_that_stops_keeps_its_hit():
    tracer = rs.Tracer(layers_scene())
    rays = layers_rays()
    many = tracer.multi_hit(*rays)
    is_even = many.prim_id % 2 == 0
    before = np.cumsum(is_even) - is_even
    starts = np.append(before, is_even.sum())[many.ray_splits[:-1]]
    kept = before == starts[many.ray_id]
    found = tracer.multi_hit(*rays, on_hit=until_even)
    assert_same_bits(found.prim_id, many.prim_id[kept])
    counts = tracer.count_hits(*rays, on_hit=until_even)
    np.testing.assert_array_equal(counts, sums(many, np.ones(len(many.t)), kept))


def with_constants(hit, constants):
    divisor, (rest,) = constants
    return hit.prim_id % divisor == rest


def test_constants_of_a_filter_need_no_new_code():
    tracer = rs.Tracer(layers_scene())
    rays = layers_rays()
    many = tracer.multi_hit(*rays)
    for divisor, rest in ((7, 0), (5, 3)):
        arguments = {"on_hit": Bound(with_constants, (divisor, (rest,)))}
        kept = many.prim_id % divisor == rest
        counts = tracer.count_hits(*rays, **arguments)
        np.testing.assert_array_equal(counts, sums(many, np.ones(len(many.t)), kept))
    filter_ = Filter.of(arguments["on_hit"], None, tracer.structure.triangles)
    program = filter_.program("count", np.uint64(0))
    program.compile()
    assert program.compiled_count <= 1
    with pytest.raises(TypeError, match=r"expected \(hit, constants\)"):
        tracer.count_hits(*rays, on_hit=Bound(of_one_mesh, (1,)))


@settings(max_examples=40)
@given(scenes_and_rays(), st.integers(0, 2**32 - 1))
def test_any_scene(case, seed):
    vertices, faces, origins, directions = case
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    rng = np.random.default_rng(seed)
    skipped = rng.integers(-1, max(len(faces), 1), (len(origins), 2)) if len(faces) else None
    limits = {"t_min": rng.choice([0.0, 0.5], len(origins)), "t_max": rng.choice([2.0, np.inf])}

    def exists(many):
        kept = many.prim_id % 11 != 3
        if skipped is not None:
            kept &= ~(skipped[many.ray_id] == many.prim_id[:, None]).any(axis=1)
        return kept

    arguments = {"on_hit": few_are_ignored, "skip_prim_ids": skipped}
    check(tracer, origins, directions, exists, arguments, "triangles", limits)


def test_rays_leave_the_triangles_that_they_start_on():
    """Rays start exactly on the surface, without the offset that spawn applies."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], float)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2], [3, 4, 5]]))
    here = tracer.first_hit([0.25, 0.25, -1.0], [0.0, 0.0, 1.0])
    away = here.positions, [0.0, 0.0, 1.0]
    assert tracer.first_hit(*away).prim_id == here.prim_id
    assert tracer.first_hit(*away, skip_prim_ids=here.prim_id).prim_id == 1
    assert tracer.any_hit(*away, t_max=0.5, skip_prim_ids=here.prim_id) == np.False_
