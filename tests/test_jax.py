"""Queries inside JAX: the tracer's bits, one callback for a batch, and derivatives of hits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from extras import need
from gradients import check_slopes, differences, hits_of, open_mesh, relative_error
from held_hits import KINDS, check_slopes_of_kind, tracer_and_rays
from meshes import soup
from raystream.core.padded_hits import pad
from strategies import scenes_and_rays

need("jax")

import jax
import jax.numpy as jnp

from raystream.jax import JaxHits, JaxTracer

COLUMNS = ("t", "u", "v", "prim_id")


@pytest.fixture(autouse=True)
def doubles():
    # Not `jax.enable_x64`: callbacks may run in threads, where that has no effect.
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.fixture(scope="module")
def mesh():
    return open_mesh()


@pytest.fixture(scope="module")
def tracer(mesh):
    return JaxTracer(rs.Tracer(mesh[0]))


@pytest.fixture(scope="module")
def rays(mesh):
    return hits_of(mesh[0])


def assert_same_hits(found, expected):
    for name in COLUMNS:
        assert_same_bits(getattr(found, name), getattr(expected, name))


# ---- The same answers.


@given(scenes_and_rays(), st.sampled_from(["f2", "f4", "f8", "i4"]), st.booleans(), st.booleans())
@settings(max_examples=15)
def test_answers_have_the_tracer_s_bits(case, dtype, compiles, batches):
    vertices, faces, origins, directions = case
    plain = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute")
    tracer = JaxTracer(plain)
    with np.errstate(over="ignore", invalid="ignore"):
        rays = origins.astype(dtype), directions.astype(dtype)
    limits = {"t_min": 0.25, "t_max": np.linspace(0.5, 9.0, len(origins))}

    def ask(origins, directions, t_max):
        given = {"t_min": 0.25, "t_max": t_max}
        return (
            tracer.first_hit(origins, directions, **given),
            tracer.any_hit(origins, directions, **given),
            tracer.count_hits(origins, directions, crossings="surfaces", **given),
            tracer.multi_hit(origins, directions, max_hits=3, **given),
        )

    ask = jax.vmap(ask) if batches else ask
    ask = jax.jit(ask) if compiles else ask
    first, seen, counts, many = ask(*map(jnp.asarray, rays), jnp.asarray(limits["t_max"]))
    assert_same_hits(first, plain.first_hit(*rays, **limits))
    assert_same_bits(seen, plain.any_hit(*rays, **limits))
    expected = plain.count_hits(*rays, crossings="surfaces", **limits)
    assert_same_bits(counts, expected.astype(np.int32))
    assert_same_hits(many, pad(plain.multi_hit(*rays, max_hits=3, **limits), 3))


def test_leading_shapes_broadcast(tracer, rays):
    origins, directions = rays[0][:4, None], rays[1][None, :5]
    found = jax.jit(lambda o, d: tracer.first_hit(o, d))(origins, directions)
    assert_same_hits(found, tracer.tracer.first_hit(origins, directions))
    one = tracer.first_hit(rays[0][0], rays[1][0])
    assert one.t.shape == ()
    none = jax.jit(tracer.multi_hit, static_argnames="max_hits")(
        np.zeros((0, 3)), np.zeros((0, 3)), max_hits=2
    )
    assert none.prim_id.shape == (0, 2)


@pytest.mark.parametrize(
    ("axes", "shapes"),
    [
        ((0, None, None), ((4, 5, 3), (3,), ())),
        ((None, 0, None), ((5, 3), (4, 3), ())),  # batched vectors of lower rank than the others
        ((1, 0, None), ((5, 4, 3), (4, 3), ())),
        ((None, None, 0), ((5, 3), (3,), (4,))),
        ((None, None, 1), ((5, 3), (3,), (5, 4))),
        ((0, 0, 0), ((4, 3), (4, 3), (4,))),
    ],
)
def test_vmap_is_a_loop_in_one_batch(tracer, axes, shapes, monkeypatch):
    rng = np.random.default_rng(3)
    origins, directions = rng.uniform(-2, 2, shapes[0]), rng.uniform(-1, 1, shapes[1])
    t_max = rng.uniform(0.5, 4.0, shapes[2])

    def take(array, axis, k):
        return array if axis is None else np.take(array, k, axis)

    loop = []
    for k in range(4):
        o, d, t = map(take, (origins, directions, t_max), axes, (k,) * 3)
        loop.append(tracer.tracer.first_hit(o, d, t_max=t))
    calls = []
    own = rs.Tracer.first_hit
    monkeypatch.setattr(rs.Tracer, "first_hit", lambda *a, **k: calls.append(1) or own(*a, **k))
    found = jax.jit(jax.vmap(lambda o, d, t: tracer.first_hit(o, d, t_max=t), axes))(
        origins, directions, t_max
    )
    assert found.t.shape[0] == 4
    for name in COLUMNS:
        assert_same_bits(getattr(found, name), np.stack([getattr(one, name) for one in loop]))
    assert len(calls) == 1


def test_a_tracer_is_an_argument_of_compiled_functions(mesh, rays):
    traces = []

    @jax.jit
    def ask(tracer, origins, directions):
        traces.append(tracer)
        return tracer.first_hit(origins, directions)

    plain = rs.Tracer(mesh[0])
    one, other = JaxTracer(plain), JaxTracer(rs.Tracer(rs.load("cornell")))
    for _ in range(2):
        assert_same_hits(ask(one, *rays), plain.first_hit(*rays))
        assert_same_hits(ask(other, *rays), other.tracer.first_hit(*rays))
    assert traces == [one, other]  # compiled once for each


def test_compiled_functions_follow_updates():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    tracer = JaxTracer(rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2]])))
    ask = jax.jit(lambda z: tracer.first_hit(jnp.stack([z * 0 + 0.2, z * 0 + 0.2, z]), [0, 0, 1]).t)
    assert float(ask(-1.0)) == 1.0
    tracer.tracer.update(vertices + [0, 0, 4])
    assert float(ask(-1.0)) == 5.0


def test_queries_follow_far_updates(rays):
    vertices, faces = soup(200, 3)
    tracer = JaxTracer(rs.Tracer(rs.Scene.from_arrays(vertices, faces)))
    moved = vertices + [1e5, 5e4, 0.0]
    tracer.tracer.update(jnp.asarray(moved))
    plain = rs.Tracer(rs.Scene.from_arrays(moved, faces), "brute")
    aimed = plain.scene.bounds.mean(axis=0) - 3.0 * rays[1], rays[1]
    found = jax.jit(lambda *rays: tracer.first_hit(*rays, vertices=moved))(*aimed)
    assert (found.prim_id >= 0).any()
    assert_same_hits(found, plain.first_hit(*aimed))


@pytest.mark.parametrize(
    "wraps", [lambda ask: ask, jax.jit, jax.grad], ids=["plain", "jit", "grad"]
)
def test_vertices_that_the_tracer_does_not_have_are_refused(wraps, rays):
    vertices, faces = soup(100, 3)
    tracer = JaxTracer(rs.Tracer(rs.Scene.from_arrays(vertices, faces)))
    tracer.tracer.update(vertices + 0.25)
    found = tracer.first_hit(*rays)
    own = vertices + 0.25
    moved = own.copy()
    moved[7, 1] += 2.0**-20
    asks = (
        lambda given: tracer.first_hit(*rays, vertices=given).u.sum(),
        lambda given: tracer.multi_hit(*rays, max_hits=2, vertices=given).u.sum(),
        lambda given: tracer.positions(found, given).sum(),
    )
    for ask in asks:
        wraps(ask)(own)
        for other in (vertices, moved, moved.astype(np.float32), own[:, [1, 0, 2]], own * np.nan):
            with pytest.raises(Exception, match=r"mesh 0 differ from the tracer's.*Tracer.update"):
                jax.block_until_ready(wraps(ask)(jnp.asarray(other)))


def test_vertices_may_be_rounded_or_batched(mesh, tracer, rays):
    """They are compared in the coarser precision, and for each row of a batch."""
    expected, own = tracer.first_hit(*rays), jnp.asarray(mesh[1])
    for dtype in (jnp.float64, jnp.float32, jnp.bfloat16, jnp.float16):
        assert_same_hits(tracer.first_hit(*rays, vertices=own.astype(dtype)), expected)
    with jax.enable_x64(False):
        found = jax.jit(lambda given: tracer.first_hit(*rays, vertices=given).prim_id)(mesh[1])
    assert found.tolist() == tracer.first_hit(*(one.astype("f4") for one in rays)).prim_id.tolist()
    batch = jnp.broadcast_to(own, (4, *own.shape))
    for ask in (
        lambda given: tracer.first_hit(*rays, vertices=given).prim_id,
        lambda given: tracer.multi_hit(*rays, max_hits=2, vertices=given).prim_id,
        lambda given: tracer.positions(expected, given),
        jax.grad(lambda given: tracer.first_hit(*rays, vertices=given).u.sum()),
    ):
        np.testing.assert_allclose(jax.jit(jax.vmap(ask))(batch)[3], ask(own), rtol=1e-12)
        with pytest.raises(Exception, match="mesh 1 differ"):
            jax.block_until_ready(jax.vmap(ask)(batch.at[2, -1].add(1.0)))


def test_many_rays_in_compiled_code(tracer):
    directions = np.random.default_rng(0).normal(size=(1_000_000, 3))
    found = jax.jit(lambda d: tracer.first_hit(jnp.zeros(3), d * 1.0))(directions)
    assert_same_hits(found, tracer.tracer.first_hit(np.zeros(3), directions))


def sizes_in(jaxpr):
    """Sizes of all arrays in a traced function and in the functions that it calls."""
    for equation in jaxpr.eqns:
        yield from (variable.aval.size for variable in equation.outvars)
        for value in equation.params.values():
            for inner in value if isinstance(value, tuple | list) else [value]:
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from sizes_in(inner)


def test_no_memory_is_needed_for_pairs_of_rays_and_triangles():
    scene, vertices = open_mesh(count=1000)
    tracer = JaxTracer(rs.Tracer(scene))
    rays = np.zeros((500, 3)), np.ones((500, 3))

    def loss(origins, directions, vertices):
        hits = tracer.first_hit(origins, directions, vertices=vertices)
        return jnp.where(hits.prim_id >= 0, hits.t, 0).sum()

    traced = jax.make_jaxpr(jax.jit(jax.grad(loss, argnums=(0, 1, 2))))(*rays, vertices)
    sizes = list(sizes_in(traced.jaxpr))
    assert len(sizes) > 50  # of replays, and of what flows back
    assert max(sizes) == max(500 * 9, vertices.size)  # corners of hits; not 500 * 1000


# ---- Derivatives.


def jacobian(tracer, vertices, origins, directions):
    """Derivatives of t, u, v and points, (N, 6, 15), and the hits."""
    hits = tracer.first_hit(origins, directions)
    faces = tracer.tracer.scene.attributes.faces
    rows = faces[np.maximum(hits.prim_id, 0)]

    def ask(origin, direction, corners, rows):
        moved = jnp.asarray(vertices).at[rows].set(corners)
        hits = tracer.first_hit(origin, direction, vertices=moved)
        points = tracer.positions(hits, moved)
        return jnp.concatenate([jnp.stack([hits.t, hits.u, hits.v]), points]), hits

    every = jax.vmap(jax.jacrev(ask, argnums=(0, 1, 2), has_aux=True))
    found, hits = jax.jit(every)(origins, directions, vertices[rows], rows)
    return np.concatenate([np.reshape(one, (*one.shape[:2], -1)) for one in found], -1), hits, rows


def test_derivatives_agree_with_finite_differences(mesh, tracer):
    rays = hits_of(mesh[0], 1000)
    found, hits, rows = jacobian(tracer, mesh[1], *rays)
    is_hit = np.asarray(hits.prim_id) >= 0
    assert 600 < is_hit.sum() < len(is_hit)
    origins, directions, corners = (one[is_hit] for one in (*rays, mesh[1][rows]))
    assert relative_error(found[is_hit], differences(origins, directions, corners)) < 1e-4
    assert not found[~is_hit].any()  # misses: zeros, not NaN


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_in_scenes_of_all_kinds(kind):
    def slopes(tracer, origins, directions, vertices, weights):
        queries = JaxTracer(tracer)

        def loss(origins, directions, vertices):
            hits = queries.first_hit(origins, directions, vertices=vertices)
            points = queries.positions(hits, vertices)
            outputs = jnp.concatenate([jnp.stack(hits[:3], axis=-1), points], axis=-1)
            return jnp.where(weights != 0.0, outputs * weights, 0.0).sum(), hits

        every = jax.jit(jax.grad(loss, argnums=(0, 1, 2), has_aux=True))
        found, hits = every(origins, directions, vertices)
        expected = tracer.first_hit(origins, directions)
        assert_same_hits(hits, expected)
        return *map(np.asarray, found), hits.instance_id

    check_slopes_of_kind(kind, slopes)


@pytest.mark.parametrize("kind", KINDS)
def test_mapped_rays_in_scenes_of_all_kinds(kind):
    """One by one, and all together: with forward derivatives, of several hits."""
    plain, origins, directions = tracer_and_rays(kind)
    tracer = JaxTracer(plain)
    rays = origins[:20], directions[:20]

    def depths(origin, direction):
        hits = tracer.multi_hit(origin, direction, max_hits=2)
        return jnp.where(hits.prim_id >= 0, hits.t + hits.u, 0.0)

    found = jax.jit(jax.vmap(jax.jacfwd(depths, argnums=(0, 1))))(*rays)
    for k in range(20):
        alone = jax.jacrev(depths, argnums=(0, 1))(rays[0][k], rays[1][k])
        for one, other in zip(found, alone, strict=True):
            np.testing.assert_allclose(one[k], other, rtol=1e-4, atol=1e-4)


@given(scenes_and_rays(), st.booleans())
@settings(max_examples=15)
def test_derivatives_are_finite_and_right_for_any_scene(case, is_single):
    vertices, faces, *rays = case
    plain = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute")
    with np.errstate(over="ignore"):
        rays = [one.astype(np.float32 if is_single else np.float64) for one in rays]

    def ask(origin, direction):
        return jnp.stack(JaxTracer(plain).first_hit(origin, direction)[:3])

    slopes = jax.jit(jax.vmap(jax.jacfwd(ask, argnums=(0, 1))))(*rays)
    triangles = plain.structure.triangles
    hits = plain.first_hit(*rays)
    corners = (
        triangles.corners[np.maximum(hits.prim_id, 0)] / triangles.scale
        if len(faces)
        else np.zeros((len(rays[0]), 3, 3))
    )
    check_slopes(corners, rays[1], hits, *map(np.asarray, slopes))


def test_integers_are_rays_without_derivatives():
    tracer = JaxTracer(rs.Tracer(rs.load("cornell")))

    def slope(dtype):
        origin = np.array([278, 273, -800], dtype)
        return jax.grad(lambda d: tracer.first_hit(origin, d).t)(np.array([0.1, 0.02, 1.0]))

    np.testing.assert_array_equal(slope(np.int32), slope(np.float64))
    assert slope(np.int32).any()


def test_derivatives_are_those_of_rays_that_are_traced_again(rays, mesh, tracer):
    """Against t of the tracer itself, at moved origins, where the triangle is the same."""
    origins, directions = rays
    slope = jax.jit(jax.vmap(jax.grad(lambda o, d: tracer.first_hit(o, d).t)))(*rays)
    way = np.random.default_rng(5).normal(size=origins.shape)
    step = 2.0**-9
    ahead, behind = (
        tracer.tracer.first_hit(origins + sign * step * way, directions) for sign in (1, -1)
    )
    here = tracer.tracer.first_hit(origins, directions)
    same = (here.prim_id >= 0) & (ahead.prim_id == here.prim_id) & (behind.prim_id == here.prim_id)
    assert same.sum() > 20
    expected = (ahead.t[same].astype(float) - behind.t[same]) / (2 * step)
    np.testing.assert_allclose((slope * way).sum(1)[same], expected, rtol=0.01, atol=2e-3)


def test_all_transformations_agree(mesh, tracer, rays):
    """Forward, reverse, multi-hit and a second derivative."""
    vertices = jnp.asarray(mesh[1])

    def depth(origin, direction, vertices):
        return tracer.first_hit(origin, direction, vertices=vertices).t

    def depths(origin, direction, vertices):
        return tracer.multi_hit(origin, direction, max_hits=2, vertices=vertices).t[0]

    hits = tracer.tracer.first_hit(*rays)
    k = int(np.flatnonzero(hits.prim_id >= 0)[0])
    point = jnp.asarray(rays[0][k]), jnp.asarray(rays[1][k]), vertices
    by_all = {"argnums": (0, 1, 2)}
    reverse = jax.jit(jax.grad(depth, **by_all))(*point)
    forward = jax.jit(jax.jacfwd(depth, **by_all))(*point)
    several = jax.jit(jax.grad(depths, **by_all))(*point)
    for a, b, c in zip(reverse, forward, several, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(a, c, rtol=1e-5, atol=1e-7)
    for moved in (vertices, None):  # with and without
        slope = jax.jit(jax.grad(lambda d, v=moved: depth(point[0], d, v)))
        second = jax.jit(jax.jacfwd(slope))(point[1])
        steps = 1e-4 * np.eye(3)
        expected = [(slope(point[1] + one) - slope(point[1] - one)) / 2e-4 for one in steps]
        np.testing.assert_allclose(second, np.stack(expected, axis=1), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("bad", [0.0, math.nan, math.inf])
def test_rays_that_miss_have_zeros(tracer, bad):
    origins = jnp.array([[9.0, 9.0, 9.0], [bad, bad, bad]])
    directions = jnp.array([[1.0, 0.0, 0.0], [bad, bad, bad]])

    def loss(origins, directions):
        hits = tracer.first_hit(origins, directions)
        seen = hits.prim_id >= 0
        kept = [jnp.where(seen, one, 0.0).sum() for one in (hits.t, hits.u, hits.v)]
        points = jnp.where(seen[:, None], tracer.positions(hits), 0.0)
        return sum(kept) + points.sum() + hits.u.sum()

    assert (tracer.first_hit(origins, directions).prim_id == -1).all()
    for slope in jax.grad(loss, argnums=(0, 1))(origins, directions):
        np.testing.assert_array_equal(slope, 0.0)


def test_single_precision_is_what_jax_has_by_default(mesh, tracer, rays):
    def depth(origin, direction):
        return tracer.first_hit(origin, direction).t

    with jax.enable_x64(False):
        origins, directions = (jnp.asarray(one) for one in rays)
        assert origins.dtype == jnp.float32
        hits = tracer.first_hit(origins, directions)
        slope = jax.jit(jax.vmap(jax.grad(depth)))(origins, directions)
        assert slope.dtype == tracer.positions(hits).dtype == jnp.float32
    exact = jax.jit(jax.vmap(jax.grad(depth)))(*map(jnp.asarray, rays))
    is_hit = np.asarray(hits.prim_id) >= 0
    assert relative_error(np.asarray(slope)[is_hit], np.asarray(exact)[is_hit]) < 1e-3


def test_half_precision_is_widened(tracer, rays):
    origins, directions = (jnp.asarray(one, jnp.bfloat16) for one in rays)
    found = tracer.first_hit(origins, directions)
    wide = [np.asarray(one.astype(jnp.float32)) for one in (origins, directions)]
    assert_same_hits(found, tracer.tracer.first_hit(*wide))


# ---- The plain tracer with arrays of JAX.


def test_a_tracer_answers_jax_in_jax(tracer, rays):
    plain = tracer.tracer
    origins, directions = map(jnp.asarray, rays)
    hits, expected = plain.first_hit(origins, directions), plain.first_hit(*rays)
    for name in (*COLUMNS, "status", "positions", "normals", "mesh_id"):
        column = getattr(hits, name)
        assert isinstance(column, jax.Array)
        assert_same_bits(column, getattr(expected, name))
    assert isinstance(plain.any_hit(origins, directions), jax.Array)
    counts = plain.count_hits(origins, directions)
    assert_same_bits(counts, plain.count_hits(*rays))
    many = plain.multi_hit(origins, directions)
    assert isinstance(many.t, jax.Array)
    assert_same_bits(many.ray_splits, plain.multi_hit(*rays).ray_splits)


# ---- Bad input.


@pytest.mark.parametrize(
    ("origins", "directions", "options", "error", "words"),
    [
        (np.zeros((4, 2)), np.ones(3), {}, ValueError, r"origins: expected shape \(..., 3\)"),
        (np.zeros((4, 3)), 1.0, {}, ValueError, r"directions: expected shape \(..., 3\)"),
        (np.zeros((4, 3)), np.ones((5, 3)), {}, ValueError, "origins and directions: shapes"),
        (np.zeros(3, complex), np.ones(3), {}, TypeError, "origins: expected real numbers"),
        (np.zeros(3), np.ones(3, bool), {}, TypeError, "directions: expected real numbers"),
        (np.zeros(3), "up", {}, TypeError, "directions: cannot be read"),
        (np.zeros((4, 3)), np.ones(3), {"t_max": np.ones(3)}, ValueError, "t_max: shape"),
        (np.zeros((4, 3)), np.ones(3), {"t_min": np.ones((4, 1))}, ValueError, "t_min: shape"),
        (np.zeros(3), np.ones(3), {"vertices": np.ones((4, 2))}, ValueError, "vertices: expected"),
        (np.zeros(3), np.ones(3), {"vertices": np.ones((4, 3), int)}, TypeError, "vertices: exp"),
    ],
)
def test_bad_input_is_named(tracer, origins, directions, options, error, words):
    with pytest.raises(error, match=words):
        tracer.first_hit(origins, directions, **options)
    with pytest.raises(error, match=words):
        jax.jit(lambda: tracer.first_hit(origins, directions, **options))()


def test_other_bad_input_is_named(tracer):
    with pytest.raises(TypeError, match="tracer: expected a Tracer, got Scene"):
        JaxTracer(tracer.tracer.scene)
    with pytest.raises(ValueError, match="max_hits: expected a number >= 0"):
        tracer.multi_hit(np.zeros(3), np.ones(3), max_hits=-1)
    with pytest.raises(ValueError, match="crossings: expected"):
        tracer.count_hits(np.zeros(3), np.ones(3), crossings="edges")
    with pytest.raises(Exception, match="vertices: expected the scene's 120, got 7"):
        jax.grad(lambda v: tracer.first_hit(np.zeros(3), np.ones(3), vertices=v).t)(np.ones((7, 3)))


def test_a_plain_tracer_says_what_traces_inside_jit(tracer):
    with pytest.raises(TypeError, match=r"(?s)origins: .*use raystream.jax.JaxTracer"):
        jax.jit(lambda o: tracer.tracer.first_hit(o, [0, 0, 1]).t)(np.zeros(3))


def test_hits_are_a_tree():
    hits = JaxHits(*np.arange(5.0))
    assert jax.tree.map(lambda one: one + 1, hits) == JaxHits(1.0, 2.0, 3.0, 4.0, 5.0)
