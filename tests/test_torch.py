"""Queries as PyTorch operators: the tracer's bits, compiled and batched, and gradients of hits."""

from __future__ import annotations

import copy
import gc
import math
import pickle

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

need("torch")

import torch
from torch.utils._python_dispatch import TorchDispatchMode

from raystream.torch import TorchHits, TorchTracer

COLUMNS = ("t", "u", "v", "prim_id")
#: Of each mesh of `open_mesh`.
FACES = [np.arange(60).reshape(-1, 3)] * 2


@pytest.fixture(scope="module")
def mesh():
    return open_mesh()


@pytest.fixture(scope="module")
def tracer(mesh):
    return TorchTracer(rs.Tracer(mesh[0]))


@pytest.fixture(scope="module")
def rays(mesh):
    return hits_of(mesh[0])


def tensors(rays):
    return tuple(map(torch.from_numpy, rays))


def assert_same_hits(found, expected):
    for name in COLUMNS:
        assert_same_bits(getattr(found, name).detach(), getattr(expected, name))


# ---- The same answers.


@given(scenes_and_rays(), st.sampled_from(["f2", "f4", "f8", "i4"]), st.booleans())
@settings(max_examples=40)
def test_answers_have_the_tracer_s_bits(case, dtype, batches):
    vertices, faces, origins, directions = case
    plain = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute")
    tracer = TorchTracer(plain)
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

    ask = torch.vmap(ask) if batches else ask
    first, seen, counts, many = ask(*tensors(rays), torch.from_numpy(limits["t_max"]))
    assert_same_hits(first, plain.first_hit(*rays, **limits))
    assert_same_bits(seen, plain.any_hit(*rays, **limits))
    assert_same_bits(counts, plain.count_hits(*rays, crossings="surfaces", **limits))
    assert_same_hits(many, pad(plain.multi_hit(*rays, max_hits=3, **limits), 3))


def test_bits_are_the_same_with_gradients(tracer, rays):
    origins, directions = (one.requires_grad_() for one in tensors(rays))
    found = tracer.first_hit(origins, directions)
    assert found.t.requires_grad
    assert_same_hits(found, tracer.tracer.first_hit(*rays))
    with torch.no_grad():
        assert not tracer.first_hit(origins, directions).t.requires_grad


def test_leading_shapes_broadcast(tracer, rays):
    origins, directions = rays[0][:4, None], rays[1][None, :5]
    expected = tracer.tracer.first_hit(origins, directions)
    assert_same_hits(tracer.first_hit(*tensors((origins, directions))), expected)
    assert tracer.first_hit(rays[0][0], [0, 0, 1]).t.shape == ()
    none = torch.zeros((0, 3))
    assert tracer.multi_hit(none, none, max_hits=2).prim_id.shape == (0, 2)


def test_many_rays(tracer):
    directions = np.random.default_rng(0).normal(size=(1_000_000, 3))
    found = tracer.first_hit(torch.zeros(3), torch.from_numpy(directions))
    assert_same_hits(found, tracer.tracer.first_hit(np.zeros(3), directions))


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
    arrays = rng.uniform(-2, 2, shapes[0]), rng.uniform(-1, 1, shapes[1])
    arrays = (*arrays, np.asarray(rng.uniform(0.5, 4.0, shapes[2])))

    def take(array, axis, k):
        return array if axis is None else np.take(array, k, axis)

    loop = []
    for k in range(4):
        o, d, t = map(take, arrays, axes, (k,) * 3)
        loop.append(tracer.tracer.first_hit(o, d, t_max=t))
    calls = []
    own = rs.Tracer.first_hit
    monkeypatch.setattr(rs.Tracer, "first_hit", lambda *a, **k: calls.append(1) or own(*a, **k))
    found = torch.vmap(lambda o, d, t: tracer.first_hit(o, d, t_max=t), axes)(*tensors(arrays))
    for name in COLUMNS:
        assert_same_bits(getattr(found, name), np.stack([getattr(one, name) for one in loop]))
    assert len(calls) == 1


@pytest.mark.filterwarnings("ignore:.*should not be instantiated")  # PyTorch's own compiler does
@pytest.mark.parametrize("requires", [False, True])
def test_compiled_functions_have_no_graph_breaks(mesh, tracer, rays, requires):
    origins, directions = tensors(rays)
    vertices = torch.from_numpy(mesh[1].copy())
    given = [one.clone().requires_grad_(requires) for one in (origins, directions, vertices)]

    def loss(origins, directions, vertices):
        hits = tracer.first_hit(origins, directions, vertices=vertices)
        many = tracer.multi_hit(origins, directions, max_hits=2)
        seen = tracer.any_hit(origins, directions, t_max=2.0)
        counts = tracer.count_hits(origins, directions)
        points = tracer.positions(hits, vertices)
        weights = torch.where(hits.prim_id >= 0, hits.t + hits.u, 0.0)
        far = torch.where(many.prim_id >= 0, many.t, 0.0).sum()
        return weights.sum() + points.nan_to_num().sum() + seen.sum() + counts.sum() + far

    expected = loss(*given)
    compiled = torch.compile(loss, backend="aot_eager", fullgraph=True)
    torch.testing.assert_close(compiled(*given), expected)
    if requires:
        torch.testing.assert_close(
            torch.autograd.grad(compiled(*given), given), torch.autograd.grad(expected, given)
        )


def test_operators_follow_the_rules_of_operators(mesh, tracer, rays):
    ops, number = torch.ops.raystream, tracer._number
    vertices = torch.from_numpy(mesh[1].copy())
    limits = torch.tensor(0.0), torch.tensor(math.inf)
    hits = tracer.first_hit(*rays)
    prim_id = hits.prim_id
    for made, more in [
        (ops.first_hit, (*tensors(rays), *limits)),
        (ops.any_hit, (*tensors(rays), *limits)),
        (ops.count_hits, (*tensors(rays), *limits, True)),
        (ops.multi_hit, (*tensors(rays), *limits, 3, False)),
        (ops.corners, hits[1:]),
        (ops.vertex_ids, (prim_id, vertices)),
        (ops.first_hit, (*tensors(rays), *limits, vertices)),
    ]:
        torch.library.opcheck(made.default, (number, *more))


def test_compiled_functions_follow_updates():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    tracer = TorchTracer(rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2]])))
    start = torch.tensor([0.2, 0.2, -1.0])
    ask = torch.compile(lambda o: tracer.first_hit(o, [0, 0, 1]).t, backend="aot_eager")
    assert float(ask(start)) == 1.0
    tracer.tracer.update(vertices + [0, 0, 4])
    assert float(ask(start)) == 5.0


def test_queries_follow_far_updates(rays):
    vertices, faces = soup(200, 3)
    tracer = TorchTracer(rs.Tracer(rs.Scene.from_arrays(vertices, faces)))
    moved = torch.from_numpy(vertices + [1e5, 5e4, 0.0]).requires_grad_()
    tracer.tracer.update(moved.detach())
    plain = rs.Tracer(rs.Scene.from_arrays(moved.detach().numpy(), faces), "brute")
    aimed = plain.scene.bounds.mean(axis=0) - 3.0 * rays[1], rays[1]
    found = tracer.first_hit(*tensors(aimed), vertices=moved)
    assert (found.prim_id >= 0).any()
    assert_same_hits(found, plain.first_hit(*aimed))


def other_vertices(tracer, requires):
    """Each way to have other vertices than the tracer has."""
    own = torch.tensor(tracer.tracer.scene.meshes[0].vertices)
    moved = own.clone()
    moved[7, 1] += 2.0**-20
    parts = [moved[:50], moved[50:]]
    optimized = own.clone().requires_grad_()  # in place, as optimizers do
    with torch.no_grad():
        optimized[3] *= 2.0
    for one in (moved, moved.float(), own[:, [1, 0, 2]], parts, optimized, own * math.nan):
        if isinstance(one, list):
            yield [part.detach().requires_grad_(requires) for part in one]
        else:
            yield one.detach().requires_grad_(requires)


@pytest.mark.filterwarnings("ignore:.*should not be instantiated")  # PyTorch's own compiler does
@pytest.mark.parametrize("requires", [False, True])
def test_vertices_that_the_tracer_does_not_have_are_refused(rays, requires):
    vertices, faces = soup(100, 3)
    tracer = TorchTracer(rs.Tracer(rs.Scene.from_arrays(vertices, faces)))
    tracer.tracer.update(vertices + 0.25)
    found = tracer.first_hit(*tensors(rays))

    def ask_first(given):
        return tracer.first_hit(*tensors(rays), vertices=given)

    for other in other_vertices(tracer, requires):
        for ask in (
            ask_first,
            torch.compile(ask_first, backend="aot_eager"),
            lambda given: tracer.multi_hit(*tensors(rays), max_hits=2, vertices=given),
            lambda given: tracer.positions(found, given),
        ):
            with pytest.raises(ValueError, match=r"mesh 0 differ from the tracer's.*Tracer.update"):
                ask(other)


def test_vertices_may_be_rounded_or_batched(mesh, tracer, rays):
    """They are compared in the coarser precision, NaN with NaN, and for each row of a batch."""
    expected = tracer.first_hit(*tensors(rays))
    own = torch.from_numpy(mesh[1].copy())
    for dtype in (torch.float64, torch.float32, torch.bfloat16, torch.float16):
        found = tracer.first_hit(*tensors(rays), vertices=own.to(dtype).requires_grad_())
        assert_same_hits(found, expected)
    broken = mesh[1].copy()
    broken[:6] = math.nan
    broken[6:9] *= 1e60
    with np.errstate(over="ignore"):
        parts = np.split(broken.astype(np.float32), [60])
    other = TorchTracer(
        rs.Tracer(rs.Scene([rs.Mesh(*one) for one in zip(parts, FACES, strict=True)]))
    )
    for one in (torch.from_numpy(broken), [torch.from_numpy(part) for part in parts]):
        assert (other.first_hit(*tensors(rays), vertices=one).prim_id >= 0).any()
    batch = own.expand(4, *own.shape)
    for ask in (
        lambda given: tracer.first_hit(*tensors(rays), vertices=given).prim_id,
        lambda given: tracer.positions(expected, given),
        torch.func.grad(lambda given: tracer.first_hit(*tensors(rays), vertices=given).u.sum()),
    ):
        found = torch.vmap(ask)(batch)
        torch.testing.assert_close(found[3], ask(own), equal_nan=True)
        with pytest.raises(ValueError, match="mesh 1 differ"):
            torch.vmap(ask)(batch + torch.arange(4.0)[:, None, None] * (own == own[-1]))


def test_operators_do_not_keep_tracers(mesh):
    tracer = TorchTracer(rs.Tracer(mesh[0]))
    number = tracer._number
    prim_id = torch.zeros(1, dtype=torch.int32)
    assert torch.ops.raystream.vertex_ids(number, prim_id).shape == (1, 3)
    del tracer
    gc.collect()
    with pytest.raises(RuntimeError, match=r"tracer: the TorchTracer .* has been deleted"):
        torch.ops.raystream.vertex_ids(number, prim_id)


def test_copies_and_pickles_trace(tracer, rays):
    for other in (copy.deepcopy(tracer), pickle.loads(pickle.dumps(tracer))):
        assert other._number != tracer._number
        assert_same_hits(other.first_hit(*rays), tracer.tracer.first_hit(*rays))


class Largest(TorchDispatchMode):
    """The size of the largest result of any operation."""

    size = 0

    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        result = function(*arguments, **(options or {}))
        for one in torch.utils._pytree.tree_leaves(result):
            if isinstance(one, torch.Tensor):
                self.size = max(self.size, one.numel())
        return result


def test_no_memory_is_needed_for_pairs_of_rays_and_triangles():
    scene, vertices = open_mesh(count=1000)
    tracer = TorchTracer(rs.Tracer(scene))
    rays = [torch.zeros(500, 3), torch.ones(500, 3), torch.from_numpy(vertices)]
    rays = [one.requires_grad_() for one in rays]
    with Largest() as seen:
        hits = tracer.first_hit(*rays[:2], vertices=rays[2])
        hits.t[hits.prim_id >= 0].sum().backward()
    assert seen.size == max(500 * 9, vertices.size)  # corners of hits; not 500 * 1000


# ---- Gradients.


def jacobian(tracer, vertices, origins, directions):
    """Derivatives of t, u, v and points, (N, 6, 15), and the hits."""
    given = [torch.from_numpy(one.copy()).requires_grad_() for one in (origins, directions)]
    corners_of = tracer.tracer.scene.attributes.faces
    moved = torch.from_numpy(vertices.copy()).requires_grad_()
    hits = tracer.first_hit(*given, vertices=moved)
    outputs = torch.cat([torch.stack(hits[:3], -1), tracer.positions(hits, moved)], -1)
    rows = corners_of[np.maximum(hits.prim_id.numpy(), 0)]
    found = np.zeros((len(origins), 6, 15))
    for k in range(6):
        for i in range(len(origins)):
            by_ray = torch.autograd.grad(outputs[i, k], [*given, moved], retain_graph=True)
            o, d, all_vertices = (one.numpy() for one in by_ray)
            parts = o[i], d[i], all_vertices[rows[i]].ravel()
            found[i, k] = np.concatenate(parts)
            assert np.count_nonzero(o) <= 3  # no other ray's
            if hits.prim_id[i] < 0:
                assert not all_vertices.any()
    return found, hits, rows


def test_gradients_agree_with_finite_differences(mesh, tracer, rays):
    found, hits, rows = jacobian(tracer, mesh[1], *rays)
    is_hit = hits.prim_id.numpy() >= 0
    assert 30 < is_hit.sum() < len(is_hit)
    expected = differences(rays[0][is_hit], rays[1][is_hit], mesh[1][rows[is_hit]])
    assert relative_error(found[is_hit], expected) < 1e-4
    assert not found[~is_hit].any()  # misses: zeros, not NaN


def test_gradients_of_many_rays_agree_with_finite_differences(mesh, tracer):
    rays = hits_of(mesh[0], 5000)
    given = [torch.from_numpy(one).requires_grad_() for one in rays]
    hits = tracer.first_hit(*given)
    is_hit = hits.prim_id.numpy() >= 0
    corners = mesh[0].triangles.corners[hits.prim_id.numpy()[is_hit]]
    expected = differences(rays[0][is_hit], rays[1][is_hit], corners)
    outputs = (*hits[:3], *tracer.positions(hits).nan_to_num().unbind(-1))
    for k, one in enumerate(outputs):
        slopes = torch.autograd.grad(one[is_hit].sum(), given, retain_graph=True)
        found = torch.cat(slopes, -1).numpy()[is_hit]
        assert relative_error(found, expected[:, k, :6]) < 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_in_scenes_of_all_kinds(kind):
    def slopes(tracer, origins, directions, vertices, weights):
        queries = TorchTracer(tracer)
        given = [one.requires_grad_() for one in tensors((origins, directions, vertices))]
        hits = queries.first_hit(*given[:2], vertices=given[2])
        points = queries.positions(hits, given[2])
        outputs = torch.cat([torch.stack(hits[:3], dim=-1), points], dim=-1)
        scaled = outputs * torch.from_numpy(weights)
        loss = torch.where(torch.from_numpy(weights) != 0.0, scaled, 0.0).sum()
        found = torch.autograd.grad(loss, given)
        detached = TorchHits(*(one.detach() for one in hits))
        assert_same_hits(detached, tracer.first_hit(origins, directions))
        return *(one.numpy() for one in found), hits.instance_id.numpy()

    check_slopes_of_kind(kind, slopes)


@pytest.mark.parametrize("kind", KINDS)
def test_operators_in_scenes_of_all_kinds(kind):
    plain, *rays = tracer_and_rays(kind)
    tracer, ops = TorchTracer(plain), torch.ops.raystream
    limits = torch.tensor(0.0), torch.tensor(math.inf)
    hits = tracer.first_hit(*tensors(rays))
    for made, more in [
        (ops.first_hit, (*tensors(rays), *limits)),
        (ops.multi_hit, (*tensors(rays), *limits, 3, False)),
        (ops.corners, hits[1:]),
        (ops.vertex_slopes, hits[3:]),
    ]:
        torch.library.opcheck(made.default, (tracer._number, *more))
    every = torch.vmap(torch.func.grad(lambda o, d: tracer.first_hit(o, d).t, argnums=(0, 1)))
    given = [one.requires_grad_() for one in tensors(rays)]
    expected = torch.autograd.grad(tracer.first_hit(*given).t.sum(), given)
    torch.testing.assert_close(every(*tensors(rays)), expected)


@given(scenes_and_rays())
@settings(max_examples=60)
def test_gradients_are_finite_and_right_for_any_scene(case):
    vertices, faces, *rays = case
    plain = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute")
    inputs = [torch.from_numpy(one.copy()).requires_grad_() for one in rays]
    hits = TorchTracer(plain).first_hit(*inputs)
    slopes = [torch.autograd.grad(one.sum(), inputs, retain_graph=True) for one in hits[:3]]
    by_origin, by_direction = (
        np.stack([slope[n].numpy() for slope in slopes], axis=1) for n in range(2)
    )
    triangles = plain.structure.triangles
    corners = (
        triangles.corners[np.maximum(hits.prim_id.numpy(), 0)] / triangles.scale
        if len(faces)
        else np.zeros((len(rays[0]), 3, 3))
    )
    check_slopes(corners, rays[1], plain.first_hit(*rays), by_origin, by_direction)


def test_gradients_of_several_hits_are_those_of_each(mesh, tracer, rays):
    origins, directions = (one.requires_grad_() for one in tensors(rays))
    many = tracer.multi_hit(origins, directions, max_hits=2)
    first = tracer.first_hit(origins, directions)
    seen = first.prim_id >= 0
    assert torch.equal(many.prim_id[:, 0], first.prim_id)
    for a, b in zip(
        torch.autograd.grad(many.t[:, 0][seen].sum(), (origins, directions), retain_graph=True),
        torch.autograd.grad(first.t[seen].sum(), (origins, directions)),
        strict=True,
    ):
        torch.testing.assert_close(a, b)
    second = many.prim_id[:, 1] >= 0
    assert second.any()
    (slope,) = torch.autograd.grad(many.t[:, 1][second].sum(), origins)
    k = int(torch.nonzero(second)[0, 0])
    corners = mesh[0].triangles.corners[many.prim_id[k, 1]]
    expected = differences(rays[0][k], rays[1][k], corners)[0, :3]
    np.testing.assert_allclose(slope[k], expected, rtol=1e-4)


def test_second_derivatives(tracer, rays):
    origins, directions = tensors(rays)
    k = int(torch.nonzero(tracer.first_hit(origins, directions).prim_id >= 0)[0, 0])
    direction = directions[k].clone().requires_grad_()

    def slope(direction):
        t = tracer.first_hit(origins[k], direction).t
        return torch.autograd.grad(t, direction, create_graph=True)[0]

    found = torch.stack([torch.autograd.grad(slope(direction)[n], direction)[0] for n in range(3)])
    step = 1e-4
    expected = torch.stack(
        [
            (slope(direction + step * e) - slope(direction - step * e)).detach() / (2 * step)
            for e in torch.eye(3, dtype=torch.float64)
        ],
        dim=1,
    )
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)


def test_gradients_under_vmap(tracer, rays):
    origins, directions = tensors(rays)
    every = torch.vmap(torch.func.grad(lambda o, d: tracer.first_hit(o, d).u, argnums=(0, 1)))
    found = every(origins, directions)
    given = origins.clone().requires_grad_(), directions.clone().requires_grad_()
    expected = torch.autograd.grad(tracer.first_hit(*given).u.sum(), given)
    torch.testing.assert_close(found, expected)


def test_meshes_may_be_separate_tensors(mesh, tracer, rays):
    parts = [torch.from_numpy(one.vertices.copy()).requires_grad_() for one in mesh[0].meshes]
    whole = torch.from_numpy(mesh[1].copy()).requires_grad_()
    origins, directions = tensors(rays)
    grads = []
    for vertices, leaves in ((parts, parts), (whole, [whole])):
        hits = tracer.first_hit(origins, directions, vertices=vertices)
        grads.append(torch.cat(torch.autograd.grad(hits.u.sum(), leaves)))
    assert grads[0].any()
    torch.testing.assert_close(*grads)


@pytest.mark.parametrize("bad", [0.0, math.nan, math.inf])
def test_rays_that_miss_have_zeros(tracer, bad):
    origins = torch.tensor([[9.0, 9.0, 9.0], [bad] * 3], requires_grad=True)
    directions = torch.tensor([[1.0, 0.0, 0.0], [bad] * 3], requires_grad=True)
    hits = tracer.first_hit(origins, directions)
    assert (hits.prim_id == -1).all()
    assert torch.isinf(hits.t).all()
    points = tracer.positions(hits)
    assert points.isnan().all()
    loss = hits.t.sum() + hits.u.sum() + points.nan_to_num().sum()
    slopes = torch.autograd.grad(loss, (origins, directions), create_graph=True)
    assert not any(one.any() for one in slopes)
    curvature = torch.autograd.grad(sum(one.sum() for one in slopes), directions)
    assert not curvature[0].any()


def test_half_precision_is_widened(tracer, rays):
    origins, directions = (one.bfloat16() for one in tensors(rays))
    wide = origins.float().numpy(), directions.float().numpy()
    assert_same_hits(tracer.first_hit(origins, directions), tracer.tracer.first_hit(*wide))


# ---- The plain tracer with tensors.


def test_a_tracer_answers_tensors_in_tensors_without_a_copy(tracer, rays):
    plain = tracer.tracer
    origins, directions = tensors(rays)
    hits, expected = plain.first_hit(origins, directions), plain.first_hit(*rays)
    for name in (*COLUMNS, "status", "positions", "normals", "mesh_id"):
        column = getattr(hits, name)
        assert isinstance(column, torch.Tensor)
        assert column is getattr(hits, name)
        assert column.data_ptr() == getattr(hits.host(), name).ctypes.data
        assert_same_bits(column, getattr(expected, name))
    assert_same_bits(plain.any_hit(origins, directions), plain.any_hit(*rays))
    assert isinstance(plain.any_hit(rays[0], directions), torch.Tensor)
    assert isinstance(plain.any_hit(*rays), np.ndarray)
    assert plain.count_hits(origins, directions).dtype == torch.int64
    many = plain.multi_hit(origins, directions)
    assert many.t.data_ptr() == many.host().t.ctypes.data
    assert_same_bits(many.ray_splits, plain.multi_hit(*rays).ray_splits)
    assert many.counts.shape == (len(origins),)


def test_hits_in_tensors_are_picked_and_spawn_rays(tracer, rays):
    origins, directions = tensors(rays)
    hits = tracer.tracer.first_hit(origins, directions)
    seen = hits[hits.is_hit]
    assert (seen.prim_id >= 0).all()
    assert len(seen.t) == int(hits.is_hit.sum())
    starts, ways = hits.spawn(-directions)
    assert starts.dtype == torch.float64
    assert torch.equal(ways, -directions)
    again = tracer.tracer.first_hit(starts, ways, skip_prim_ids=hits.prim_id)
    assert isinstance(again.t, torch.Tensor)
    assert hits.ravel().t.shape == hits.t.shape


# ---- Bad input.


@pytest.mark.parametrize(
    ("origins", "directions", "options", "error", "words"),
    [
        (torch.zeros(4, 2), torch.ones(3), {}, ValueError, r"origins: expected shape \(..., 3\)"),
        (torch.zeros(4, 3), 1.0, {}, ValueError, r"directions: expected shape \(..., 3\)"),
        (torch.zeros(4, 3), torch.ones(5, 3), {}, ValueError, "origins and directions: shapes"),
        (torch.zeros(3, dtype=torch.cfloat), torch.ones(3), {}, TypeError, "origins: exp.* real"),
        (torch.zeros(3), torch.ones(3).bool(), {}, TypeError, "directions: expected real"),
        (torch.zeros(3), "up", {}, TypeError, "directions: cannot be read"),
        (torch.zeros(4, 3), torch.ones(3), {"t_max": torch.ones(3)}, ValueError, "t_max: shape"),
        (torch.zeros(4, 3), torch.ones(3), {"t_min": torch.ones(4, 1)}, ValueError, "t_min: shape"),
        (torch.zeros(3), torch.ones(3), {"vertices": torch.ones(4, 2)}, ValueError, "vertices: ex"),
        (
            *(torch.zeros(3), torch.ones(3), {"vertices": torch.ones(4, 3).int()}),
            *(TypeError, "vertices: expected floating"),
        ),
    ],
)
def test_bad_input_is_named(tracer, origins, directions, options, error, words):
    with pytest.raises(error, match=words):
        tracer.first_hit(origins, directions, **options)


def test_other_bad_input_is_named(tracer):
    with pytest.raises(TypeError, match="tracer: expected a Tracer, got Scene"):
        TorchTracer(tracer.tracer.scene)
    with pytest.raises(ValueError, match="max_hits: expected a number >= 0"):
        tracer.multi_hit(torch.zeros(3), torch.ones(3), max_hits=-1)
    with pytest.raises(ValueError, match="crossings: expected"):
        tracer.count_hits(torch.zeros(3), torch.ones(3), crossings="edges")
    vertices = torch.ones(7, 3, requires_grad=True)
    with pytest.raises(ValueError, match="vertices: expected the scene's 120, got 7"):
        tracer.first_hit(torch.zeros(3), torch.ones(3), vertices=vertices)


def test_a_plain_tracer_says_what_traces_with_gradients(tracer):
    with pytest.raises(TypeError, match=r"origins: .*raystream.torch.TorchTracer .*\.detach\(\)"):
        tracer.tracer.first_hit(torch.zeros(3, requires_grad=True), [0, 0, 1])


def test_tensors_without_numbers_have_results_without(tracer):
    with torch.device("meta"):
        hits = tracer.multi_hit(torch.zeros(4, 1, 3), torch.ones(5, 3), max_hits=2)
    assert hits.t.device.type == "meta"
    assert hits.prim_id.shape == (4, 5, 2)
    assert [one.dtype for one in hits] == [torch.float32] * 3 + [torch.int32] * 2
