"""Tracers in float64 against exact rational arithmetic, and their kernels against brute force."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from cases import CASES
from exact_oracle import hits_of
from meshes import dented_sphere, icosphere, soup
from raystream.machines import Branching
from raystream.structures import single_kernels

KERNELS = ("auto", "packet", "groups", "single")
COLUMNS = ("t", "u", "v", "prim_id", "status")


def tracers_of(scene: rs.Scene, kernels: tuple[str, ...] = KERNELS) -> dict[str, rs.Tracer]:
    made = {"brute": rs.Tracer(scene, "brute", precision="float64")}
    for kernel in kernels:
        made[kernel] = rs.Tracer(scene, rs.Bvh(kernel=kernel), precision="float64")
    return made


def answers_of(tracer: rs.Tracer, rays: dict[str, Any]) -> dict[str, np.ndarray]:
    """All queries' answers."""
    first = tracer.first_hit(**rays)
    answers = {f"first {name}": getattr(first, name) for name in COLUMNS}
    answers["any"] = tracer.any_hit(**rays)
    for crossings in ("triangles", "surfaces"):
        answers[f"count {crossings}"] = tracer.count_hits(**rays, crossings=crossings)
        many = tracer.multi_hit(**rays, crossings=crossings)
        for name in (*COLUMNS, "ray_splits"):
            answers[f"{crossings} {name}"] = getattr(many, name)
    few = tracer.multi_hit(**rays, max_hits=2)
    answers |= {f"nearest two {name}": getattr(few, name) for name in (*COLUMNS, "ray_splits")}
    return answers


def assert_same(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> None:
    for name, array in wanted.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes(), name


def assert_exact(scene: rs.Scene, tracer: rs.Tracer, rays: dict[str, Any], count: int) -> int:
    """Compare the first rays with the oracle; returns the number of hits."""
    mesh = scene.meshes[0]
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    finite = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)))
    rays = {name: np.asarray(array, np.float64) for name, array in rays.items()}
    first, many = tracer.first_hit(**rays), tracer.multi_hit(**rays)
    shape = (len(rays["origins"]),)
    low, high = (np.broadcast_to(rays[name], shape) for name in ("t_min", "t_max"))
    total = 0
    for i in range(min(count, *shape)):
        if first.status[i]:
            continue
        limits = float(low[i]), float(high[i])
        wanted = hits_of(rays["origins"][i], rays["directions"][i], corners, limits, finite)
        rows = slice(many.ray_splits[i], many.ray_splits[i + 1])
        assert many.t[rows].tolist() == [hit.t for hit in wanted]
        assert many.prim_id[rows].tolist() == [hit.prim_id for hit in wanted]
        for u, v, hit in zip(many.u[rows], many.v[rows], wanted, strict=True):
            assert abs(u - hit.u) <= 4e-16
            assert abs(v - hit.v) <= 4e-16
        if wanted:
            assert (first.t[i], first.prim_id[i]) == (wanted[0].t, wanted[0].prim_id)
        else:
            assert (first.t[i], first.prim_id[i]) == (np.inf, -1)
        total += len(wanted)
    return total


def assert_right(scene: rs.Scene, tracer: rs.Tracer, rays: dict[str, Any], count: int) -> None:
    """Compare all answers with brute force on the CPU, and those of the first rays exactly."""
    oracle = rs.Tracer(scene, "brute", precision="float64")
    assert_same(answers_of(tracer, rays), answers_of(oracle, rays))
    assert_exact(scene, tracer, rays, count)


@pytest.mark.parametrize(
    "kernels",
    [("single", "groups"), pytest.param(KERNELS, marks=pytest.mark.ci)],
    ids=["some", "all"],
)
@pytest.mark.parametrize("name", CASES)
def test_every_case_is_exact_and_the_same_in_every_kernel(name, kernels):
    case = CASES[name](np.random.default_rng(2013))
    t_min, t_max = case.limits()
    rays = {
        "origins": case.origins,
        "directions": case.directions,
        "t_min": t_min,
        "t_max": t_max,
    }
    tracers = tracers_of(case.scene, kernels)
    wanted = answers_of(tracers["brute"], rays)
    for kernel in kernels:
        assert_same(answers_of(tracers[kernel], rays), wanted)
    assert_exact(case.scene, tracers["brute"], rays, 12)


NUMBERS = st.one_of(
    st.integers(-3, 3).map(float),
    st.integers(-3, 3).map(lambda n: n * 1e-3 + 6.4e6),
    st.floats(-2.0, 2.0, width=32),
    # Coordinates below 2**-200 count as 0.
    st.floats(-1e9, 1e9).map(lambda x: x if abs(x) > 1e-50 else 0.0),
)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS)


@given(
    st.lists(VECTORS, min_size=3, max_size=9),
    st.lists(st.tuples(*[st.integers(0, 8)] * 3), min_size=1, max_size=6),
    st.lists(st.tuples(VECTORS, VECTORS), min_size=1, max_size=5),
    st.booleans(),
)
def test_any_rays_and_triangles(vertices, faces, rays, is_aimed):
    """Hits, ties and order are those of rational arithmetic, for anything."""
    points = np.array(vertices)
    scene = rs.Scene.from_arrays(points, np.array(faces) % len(points))
    origins, ends = np.array(rays)[:, 0], np.array(rays)[:, 1]
    if is_aimed:  # at vertices, as far as float64 can
        ends = points[np.arange(len(ends)) % len(points)] - origins
    given_rays = {"origins": origins, "directions": ends, "t_min": -1.0, "t_max": 1.0}
    brute = rs.Tracer(scene, "brute", precision="float64")
    bvh = rs.Tracer(scene, precision="float64")
    groups = rs.Tracer(scene, rs.Bvh(kernel="groups"), precision="float64")
    wanted = answers_of(brute, given_rays)
    assert_same(answers_of(bvh, given_rays), wanted)
    assert_same(answers_of(groups, given_rays), wanted)
    assert_exact(scene, bvh, given_rays, 5)


@pytest.mark.parametrize("middle", [0.0, 6.4e6], ids=["here", "on the ground"])
@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_no_ray_slips_through_a_closed_mesh(middle, size):
    vertices, faces = dented_sphere(3)
    vertices = vertices.astype(np.float64) * size + [middle, -middle, 0.5 * middle]
    rng = np.random.default_rng(7)
    corners = vertices[faces[rng.integers(0, len(faces), 20_000)]]
    share = rng.choice([0.0, 0.5, 0.25], len(corners))[:, None]
    targets = corners[:, 0] * (1.0 - share) + corners[:, 1] * share
    center = vertices.mean(axis=0)
    inside = center + rng.normal(size=targets.shape) * 0.02 * size
    away = inside - center
    outside = center + away / np.linalg.norm(away, axis=1, keepdims=True) * 20.0 * size
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), precision="float64")
    assert tracer.first_hit(inside, targets - inside).is_hit.all()
    assert tracer.any_hit(inside, targets - inside).all()
    crossings = tracer.count_hits(inside, targets - inside, crossings="surfaces")
    assert (crossings % 2 == 1).all()
    crossings = tracer.count_hits(outside, targets - outside, crossings="surfaces")
    assert (crossings % 2 == 0).all()


@pytest.mark.ci
def test_limits_are_closed():
    scene = rs.Scene.from_arrays(*icosphere(3))
    rng = np.random.default_rng(3)
    origins, directions = rng.normal(size=(2, 2000, 3)) * [[[3.0]], [[1.0]]]
    for tracer in tracers_of(scene).values():
        hits = tracer.first_hit(origins, directions - origins)
        ways = (directions - origins)[hits.is_hit]
        starts, t = origins[hits.is_hit], hits.t[hits.is_hit]
        at = tracer.first_hit(starts, ways, t_min=t, t_max=t)
        assert np.array_equal(at.t, t)
        before = tracer.first_hit(starts, ways, t_max=np.nextafter(t, -np.inf))
        assert not before.is_hit.any()
        behind = tracer.first_hit(starts, ways, t_min=np.nextafter(t, np.inf))
        assert (behind.t > t).all()


@pytest.mark.ci
@pytest.mark.parametrize("count", [1, 300])
def test_invalid_rays_are_reported(count):
    """Among valid ones, which they leave as they are."""
    scene = rs.Scene.from_arrays(*icosphere(1))
    origins = np.tile([0.0, 0.0, 3.0], (count * 8, 1))
    directions = np.tile([0.01, 0.02, -1.0], (count * 8, 1))
    t_max = np.full(count * 8, np.inf)
    origins[1::8, 0], origins[2::8, 1], origins[3::8, 2] = np.nan, np.inf, 2.0**201
    directions[4::8], directions[5::8, 0], directions[6::8, 2] = 0.0, np.nan, -np.inf
    t_max[7::8] = np.nan
    is_bad = np.arange(count * 8) % 8 > 0
    for tracer in tracers_of(scene).values():
        hits = tracer.first_hit(origins, directions, t_max=t_max)
        assert np.array_equal(hits.status == rs.RayStatus.INVALID, is_bad)
        assert np.array_equal(hits.is_hit, ~is_bad)
        assert np.isinf(hits.t[is_bad]).all()
        assert np.array_equal(tracer.any_hit(origins, directions, t_max=t_max), ~is_bad)
        many = tracer.multi_hit(origins, directions, t_max=t_max)
        assert np.array_equal(many.status == rs.RayStatus.INVALID, is_bad)
        assert np.array_equal(many.counts, np.where(is_bad, 0, 2))


@pytest.mark.ci
@pytest.mark.parametrize("far", [1e3, 1e7, 1e12, 1e20])
def test_origins_far_from_the_scene(far):
    scene = rs.Scene.from_arrays(*soup(200, seed=5))
    rng = np.random.default_rng(1)
    count = 400 if far < 1e15 else 40  # slow: every box and every sign is in doubt
    targets = scene.meshes[0].vertices[rng.integers(0, 600, count)].astype(np.float64)
    origins = rng.normal(size=(count, 3)) * far
    rays = {"origins": origins, "directions": targets - origins}
    tracers = tracers_of(scene)
    wanted = answers_of(tracers["brute"], rays)
    assert wanted["any"].any()
    for kernel in KERNELS:
        assert_same(answers_of(tracers[kernel], rays), wanted)


@pytest.mark.ci
@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e12, 1e40])
def test_scenes_of_any_size(scale):
    vertices, faces = soup(100, seed=2)
    scene = rs.Scene.from_arrays(vertices.astype(np.float64) * scale, faces)
    rng = np.random.default_rng(4)
    origins, ends = rng.uniform(-1.0, 2.0, (2, 300, 3)) * scale
    rays = {"origins": origins, "directions": ends - origins, "t_min": 0.0, "t_max": np.inf}
    tracers = tracers_of(scene)
    wanted = answers_of(tracers["brute"], rays)
    for kernel in KERNELS:
        assert_same(answers_of(tracers[kernel], rays), wanted)
    assert assert_exact(scene, tracers["brute"], rays, 20) > 0


@pytest.mark.ci
@pytest.mark.parametrize("length", [2.0**-1060, 1e-300, 1e-5, 1e300])
def test_directions_of_any_length(length):
    """Distances count in lengths of the direction."""
    scene = rs.Scene.from_arrays(*icosphere(1))
    ways = np.array([[0.0, 0.0, -1.0], [1.0, 1.0, -8.0]]) * length
    for tracer in tracers_of(scene).values():
        hits = tracer.first_hit([[0.0, 0.0, 3.0]] * 2, ways)
        assert hits.is_hit.all()
        plain = tracer.first_hit([[0.0, 0.0, 3.0]] * 2, [[0.0, 0.0, -1.0], [1.0, 1.0, -8.0]])
        with np.errstate(over="ignore"):
            wanted = np.minimum(plain.t / length, np.finfo(np.float64).max)
        assert np.allclose(hits.t, wanted, rtol=1e-12)


def test_results_are_float64():
    scene = rs.Scene.from_arrays(np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0]]) + 1e7, [[0, 1, 2]])
    tracer = rs.Tracer(scene, precision="float64")
    hits = tracer.first_hit(np.array([[1.1, 0.7, 1.0]]) + 1e7, [[0.0, 0.0, -3.0]])
    for name in ("t", "u", "v", "positions", "normals"):
        assert getattr(hits, name).dtype == np.float64
    assert hits.t.item() == (1e7 + 1.0 - 1e7) / 3.0
    assert np.allclose(hits.positions, [[1e7 + 1.1, 1e7 + 0.7, 1e7]], rtol=1e-15)
    assert hits.normals.tolist() == [[0.0, 0.0, 1.0]]
    one = tracer.cast([1e7 + 1.1, 1e7 + 0.7, 1e7 + 1.0], [0.0, 0.0, -3.0])
    assert tuple(one) == (hits.t.item(), hits.u.item(), hits.v.item(), 0)
    assert one.position.tolist() == hits.positions[0].tolist()
    picked = hits[[0]]
    assert type(picked) is type(hits) is type(hits.ravel())
    assert tracer.memory_needed(1000).results == 29 * 1000


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_all_hits_take_one_search_in_buffers_that_grow(structure, rng, monkeypatch):
    scene = rs.Scene.from_arrays(*soup(300, 5))
    rays = rng.uniform(-1.0, 1.0, (70, 3)), rng.standard_normal((70, 3))
    tracer = rs.Tracer(scene, structure, precision="float64")
    counts, first = tracer.count_hits(*rays), tracer.first_hit(*rays)
    assert counts.max() > 3
    monkeypatch.setattr(Branching, "count_then_fill", None)  # which takes two searches
    monkeypatch.setattr(single_kernels, "FIRST_CAPACITY", 2)
    many = tracer.multi_hit(*rays)
    assert np.diff(many.ray_splits).tolist() == counts.tolist()
    nearest = many.ray_splits[:-1][counts > 0]
    for name in ("t", "u", "v", "prim_id"):
        found = getattr(many, name)[nearest]
        assert found.tobytes() == getattr(first, name)[counts > 0].tobytes()


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_a_ray_that_is_cast_has_the_bits_of_a_batch(structure, rng):
    scene = rs.Scene.from_arrays(*soup(300, 5))
    tracer = rs.Tracer(scene, structure, precision="float64")
    origins, directions = rng.uniform(-1.0, 1.0, (20, 3)), rng.standard_normal((20, 3))
    directions[3] = 0.0
    t_min = 1e-9 + 1e-17
    hits = tracer.first_hit(origins, directions, t_min=t_min)
    cast = [tracer.cast(*ray, t_min) for ray in zip(origins, directions, strict=True)]
    for name in COLUMNS:
        assert [getattr(one, name) for one in cast] == getattr(hits, name).tolist(), name


@pytest.mark.parametrize("middle", [0.0, 6.4e6, 1e12])
def test_spawned_rays_leave_their_surface(middle):
    vertices, faces = dented_sphere(3)
    scene = rs.Scene.from_arrays(vertices.astype(np.float64) * 100.0 + middle, faces)
    tracer = rs.Tracer(scene, precision="float64")
    rng = np.random.default_rng(6)
    starts = scene.bounds.mean(axis=0) + rng.normal(size=(20_000, 3))
    hits = tracer.first_hit(starts, rng.normal(size=(20_000, 3)))
    assert hits.is_hit.all()
    origins, ways = hits.spawn(rng.normal(size=(20_000, 3)))
    again = tracer.first_hit(origins, ways)
    assert not (again.prim_id == hits.prim_id).any()
    height = np.linalg.norm(origins - hits.positions, axis=1)
    assert height.max() <= 1e-13 * (100.0 + 4.0 * middle)
    with pytest.raises(ValueError, match="directions: shape"):
        hits.spawn(np.zeros((2, 3)))


def test_updates_keep_the_precision():
    vertices, faces = icosphere(2)
    vertices = vertices.astype(np.float64) + 1e8
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), precision="float64")
    moved = vertices + [0.0, 0.0, 2.0**-20]
    tracer.update(moved)
    start, way = vertices.mean(axis=0), [0.0, 0.0, 1.0]
    wanted = rs.Tracer(rs.Scene.from_arrays(moved, faces), precision="float64")
    for one in (tracer, copy.copy(tracer), pickle.loads(pickle.dumps(tracer))):
        assert one.first_hit(start, way).t.item() == wanted.first_hit(start, way).t.item()
    assert rs.Tracer(tracer.scene).first_hit(start, way).t.dtype == np.float32
    tracer.update(tracer.scene)  # nothing moves
    assert rs.Tracer(tracer.scene).first_hit(start, way).t.dtype == np.float32


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_updates_keep_attributes(structure):
    """Of several meshes, moved by arrays, one by one, as a scene, and far."""
    rng = np.random.default_rng(3)
    meshes = []
    for k, (vertices, faces) in enumerate((icosphere(2), dented_sphere(1))):
        attributes = {
            "normals": rng.normal(size=vertices.shape),
            "texcoords": rng.random((len(vertices), 2)),
            "colors": rng.random((len(vertices), 3)),
            "material_ids": rng.integers(0, 3, len(faces)),
        }
        meshes.append(rs.Mesh(vertices + [4.0 * k, 0.0, 0.0], faces, **attributes))
    scene = rs.Scene(meshes, materials=[rs.Material(name=str(k)) for k in range(3)])
    tracer = rs.Tracer(scene, structure, precision="float64")
    own = [mesh.vertices for mesh in meshes]
    turned = scene.replace(meshes=[one.with_material_ids(2) for one in meshes])
    for offset, moved in (
        (0.125, [one + 0.125 for one in own]),
        (0.125, [None, own[1] + 0.125]),
        (1e6, [one + 1e6 for one in own]),
        (0.0, scene),
        (0.0, turned),
    ):
        tracer.update(moved)
        fresh = rs.Tracer(tracer.scene, structure, precision="float64")
        rays = offset + rng.normal(size=(200, 3)), rng.normal(size=(200, 3))
        hits, wanted = tracer.first_hit(*rays), fresh.first_hit(*rays)
        assert hits.is_hit.mean() > 0.2
        for name in ("t", "prim_id", "material_id", "texcoords", "shading_normals"):
            found, expected = getattr(hits, name), getattr(wanted, name)
            assert found.tobytes() == expected.tobytes(), name
        assert np.isfinite(hits.texcoords[hits.is_hit]).all()
        assert not np.array_equal(hits.shading_normals, hits.normals)
        many, all_wanted = tracer.multi_hit(*rays), fresh.multi_hit(*rays)
        assert many.material_id.tolist() == all_wanted.material_id.tolist()
        assert many.material_id.any()


def test_limits_and_shapes():
    scene = rs.Scene.from_arrays(*icosphere(2))
    tracer = rs.Tracer(scene, precision="float64")
    origins = np.zeros((3, 40, 3))
    ways = np.random.default_rng(0).normal(size=(3, 40, 3))
    assert tracer.first_hit(origins, ways).t.shape == (3, 40)
    assert tracer.first_hit([0, 0, 0], ways, t_max=np.full(40, 0.1)).is_hit.sum() == 0
    assert tracer.first_hit(np.zeros((0, 3)), [0, 0, 1]).t.shape == (0,)
    assert len(tracer.multi_hit(origins, ways, max_hits=0).t) == 0
    with pytest.raises(ValueError, match="t_max"):
        tracer.first_hit(origins, ways, t_max=np.zeros(7))
    with pytest.raises(TypeError, match="t_min"):
        tracer.first_hit(origins, ways, t_min="near")


@pytest.mark.ci
@pytest.mark.parametrize("vertices", [np.zeros((0, 3)), np.full((3, 3), np.nan), np.ones((3, 3))])
def test_scenes_without_a_triangle_that_can_be_hit(vertices):
    faces = np.arange(len(vertices)).reshape(-1, 3)
    for tracer in tracers_of(rs.Scene.from_arrays(vertices, faces)).values():
        assert not tracer.any_hit(np.ones((400, 3)) * [0, 0, 1], [1.0, 1.0, 0.0]).any()
        assert not tracer.first_hit(np.zeros((400, 3)), [1.0, 1.0, 1.0]).is_hit.any()


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_steps_and_tests_are_counted_as_in_float32(structure):
    """The same tree: boxes that are rounded outward once more are entered about as often.

    Float32 also drops rays that are far from the scene before they are traced; these are not.
    """
    scene = rs.Scene.from_arrays(*icosphere(3))
    options = {"kernel": "single"} if structure == "bvh" else {}
    exact = rs.Tracer(scene, structure, precision="float64", counters=True)
    other = rs.Tracer(scene, structure, counters=True, **options)
    origins, ways = np.random.default_rng(1).normal(size=(2, 500, 3)).astype(np.float32)
    origins, ways = 2.0 * origins, 0.5 * ways - 2.0 * origins
    for name in ("first_hit", "any_hit", "count_hits", "multi_hit"):
        found, wanted = (getattr(one, name)(origins, ways) for one in (exact, other))
        for column in ("steps", "leaves", "tests", "shadings"):
            ours, theirs = (getattr(one.counters, column) for one in (exact, other))
            if (structure, name, column) == ("brute", "any_hit", "tests"):
                continue  # one of several hits ends the search
            assert np.mean(ours == theirs) > 0.99
            if (structure, column) == ("brute", "tests") and name != "multi_hit":
                assert (ours == len(scene.triangles)).all()
        if name == "first_hit":
            np.testing.assert_array_equal(found.prim_id, wanted.prim_id)
            plain = rs.Tracer(scene, structure, precision="float64").first_hit(origins, ways)
            np.testing.assert_array_equal(found.t, plain.t)
            assert exact.counters.leaves.any() == (structure == "bvh")


def test_a_heat_map_in_float64():
    scene = rs.load("cornell")
    found = rs.heatmap(scene, "tests", (20, 15), precision="float64")
    wanted = rs.heatmap(scene, "tests", (20, 15), kernel="single")
    assert np.mean(found.counts == wanted.counts) > 0.9


def test_progress_is_reported_and_interrupts():
    tracer = rs.Tracer(rs.Scene.from_arrays(*icosphere(2)), precision="float64")
    origins, ways = np.random.default_rng(0).normal(size=(2, 20_000, 3))
    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        seen: list[tuple[int, int]] = []
        query(origins, ways, progress=lambda done, total, to=seen: to.append((done, total)))
        assert seen[-1][0] == seen[-1][1]
    with pytest.raises(KeyboardInterrupt):
        tracer.multi_hit(origins, ways, progress=_interrupt)


def _interrupt(done: int, total: int) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"precision": "float16"}, "precision: expected 'float32' or 'float64', got 'float16'"),
        ({"structure": "kdtree"}, "structure='kdtree': not supported .* use structure='bvh'"),
        ({"machine": "multipass"}, "machine='multipass': not supported with precision='float64'"),
        ({"kernel": "wavefront"}, "kernel: 'wavefront' is not supported .* 'packet'"),
    ],
)
def test_what_is_not_supported_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        rs.Tracer(rs.load("cornell"), **({"precision": "float64"} | options))


def test_kinds_that_are_not_supported_are_named():
    ball = rs.Scene.spheres([[0.0, 0.0, 0.0]], 1.0)
    for scene in (ball, rs.Scene.combine([rs.load("cornell"), ball])):
        with pytest.raises(
            rs.RaystreamError, match="precision='float64': not supported in a scene"
        ):
            rs.Tracer(scene, precision="float64")
