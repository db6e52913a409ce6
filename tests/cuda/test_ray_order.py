"""Rays sorted by the device: keys, their order, and unchanged answers in the original order."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from raystream.core.rays import RayBatch
from raystream.cuda import ray_order
from raystream.cuda.programs import rounds
from raystream.cuda.rays import place_rays
from raystream.jit.cpu import kernel
from raystream.jit.cuda import PersistentKernel, RangeKernel, is_simulated
from raystream.jit.simd import load, store
from raystream.kernels.ray import SceneFrame
from test_agreement import answers_of, assert_expected, case_of

#: A simulated thread takes a tenth of a millisecond.
RAYS = 24

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")


def _sort(_gpu, keys, values, _bits, **_options):
    order = np.argsort(keys.host(), kind="stable")
    keys.fill(keys.host()[order])
    values.fill(values.host()[order])
    return keys, values


class CudaArray:
    """An array on the device, as other libraries have it."""

    def __init__(self, gpu, array):
        self._memory = gpu.upload("test", array)
        self.__cuda_array_interface__ = {
            "shape": array.shape,
            "typestr": array.dtype.str,
            "data": (int(self._memory.address), True),
            "strides": None,
            "version": 3,
        }


@pytest.fixture
def simple_sort(monkeypatch):
    """NumPy's sort, where the device is simulated, whose own takes seconds."""
    if is_simulated():
        monkeypatch.setattr(ray_order, "sort_pairs", _sort)


@pytest.fixture
def rays():
    """Rays of a case in random order, two of them invalid."""
    case = case_of("random_soup")
    rows = np.random.default_rng(5).permutation(len(case.origins))[:RAYS]
    origins, directions = case.origins[rows].copy(), case.directions[rows].copy()
    origins[4, 1], directions[9] = np.nan, 0.0
    return origins, directions


# ---- Keys.


def _bits(number, count, axis, axes):
    """Bits of a number, spread for interleaving with this many axes."""
    return sum((number >> k & 1) << (axes * k + axis) for k in range(count))


def key_of(frame, origin, direction):
    """The key in plain Python."""
    if not (np.isfinite([*origin, *direction]).all() and np.any(direction)):
        return 2**32 - 1
    local = (np.asarray(origin, float) - frame.center) * frame.scale
    low, high = np.array(frame.low, float), np.array(frame.high, float)
    cells = np.clip((local - low) * 32.0 / (high - low).max(), 0, 31).astype(int)
    weights = np.abs(direction) / np.abs(direction).sum()
    steps = np.clip(weights[:2] * 128.0, 0, 127).astype(int)
    octant = sum(int(direction[k] < 0) << k for k in range(3))
    cell = sum(_bits(int(cells[k]), 5, k, 3) for k in range(3))
    weight = sum(_bits(int(steps[k]), 7, k, 2) for k in range(2))
    return (octant << 29) | (cell << 14) | weight


def sorted_numbers(gpu, triangles, origins, directions):
    """The frame, and the order that the device sorts rays into."""
    batch = RayBatch(origins, directions, 0.0, np.inf)
    placed = place_rays(batch, slice(0, len(batch)), gpu.upload)
    frame = SceneFrame.of(triangles)
    order = ray_order.sort_rays(gpu, placed.source, len(batch), frame, gpu.empty, gpu.stream)
    gpu.wait()
    return frame, order.host()


#: Middles of cells and of directions' steps, so that no rounding moves them to others.
CELLS = np.array([[0, 0, 0], [31, 15, 16], [1, 2, 30], [31, 31, 31], [7, 0, 9], [0, 31, 1]])
TOWARD = np.array([[3, 90], [100, 10], [0, 0], [42, 42], [1, 120], [63, 60]])


def test_keys_say_where_rays_start_and_where_they_go(gpu, monkeypatch):
    """Octants from the top, then cells of the box, then directions."""
    noted = []

    def note(_gpu, keys, values, bits, **_options):
        assert (values.host() == np.arange(len(values.host()))).all()
        noted.append((keys.host(), bits))
        return keys, values

    monkeypatch.setattr(ray_order, "sort_pairs", note)
    corners = np.array([[0, 0, 0], [64, 0, 0], [0, 32, 16]], float) + 100.0
    scene = rs.Scene.from_arrays(corners, [[0, 1, 2]])
    origins = 100.0 + 2.0 * (CELLS + 0.5)
    origins[4] = [204.0, 60.0, 119.0]  # outside: the nearest cell
    first, second = ((TOWARD + 0.5) / 128.0).T
    directions = np.stack([first, second, 1.0 - first - second], 1) * np.float32(3.7)
    directions *= np.array(
        [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1], [-1, -1, -1], [-1, 1, -1]]
    )
    origins = np.concatenate([origins, [[np.nan, 101, 101], [101, 101, 101]]])
    directions = np.concatenate([directions, [[1, 0, 0], [0, 0, 0]]])
    frame, _ = sorted_numbers(gpu, scene.triangles, origins, directions)
    ((keys, bits),) = noted
    expected = [key_of(frame, *ray) for ray in zip(origins, directions, strict=True)]
    assert keys.tolist() == expected
    assert bits == 32
    assert [key >> 29 for key in expected] == [0, 1, 2, 4, 7, 5, 7, 7]
    assert expected[-2:] == [2**32 - 1] * 2


def test_scenes_of_one_point_have_keys(gpu, simple_sort):
    """No division by a box without length: directions alone decide."""
    scene = rs.Scene.from_arrays(np.full((3, 3), 2.0), [[0, 1, 2]])
    directions = [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    _, order = sorted_numbers(gpu, scene.triangles, np.zeros((4, 3)), directions)
    assert order.tolist() == [2, 3, 0, 1]


def test_rays_are_sorted_by_key_then_number(gpu, rays):
    """By the device's own sort, all bits of it."""
    scene = case_of("random_soup").scene
    origins, directions = rays
    origins[7], directions[7] = origins[20], directions[20]
    frame, order = sorted_numbers(gpu, scene.triangles, origins, directions)
    keys = [key_of(frame, *ray) for ray in zip(origins, directions, strict=True)]
    # To the cell: the last bits are those of float32's.
    coarse = np.array(keys, np.uint64)[order] >> np.uint64(14)
    assert sorted(order.tolist()) == list(range(RAYS))
    assert coarse.tolist() == sorted(coarse.tolist())
    assert order[-2:].tolist() == [4, 9]
    assert order.tolist().index(20) == order.tolist().index(7) + 1


# ---- Threads.


@kernel
def _count(i, to):
    at = to + (i << np.uint64(2))
    store(at, np.int32(load(np.int32, at) + np.int32(1)))


@pytest.mark.parametrize("launcher", [RangeKernel, PersistentKernel])
def test_threads_take_the_numbers_of_the_order(gpu, launcher):
    order = gpu.upload("order", np.array([5, 1, 7, 40], np.uint32))
    out = gpu.upload("out", np.zeros(64, np.int32))
    launcher(ray_order.reordered(_count)).launch(gpu, 3, (order.address, out.address))
    gpu.wait()
    assert np.flatnonzero(out.host()).tolist() == [1, 5, 7]


# ---- Answers.

#: Every structure, and both launches.
WAYS = {
    "brute": {"structure": "brute"},
    "bvh": {"structure": "bvh", "kernel": "compressed", "launch": "persistent"},
    "bvh, wide": {"structure": "bvh", "kernel": "wide"},
    "bvh, binary": {"structure": "bvh", "kernel": "binary"},
    "grid": {"structure": "grid", "launch": "persistent"},
    "kdtree": {"structure": "kdtree"},
    "graph": {"structure": "graph"},
}


@pytest.mark.parametrize("way", WAYS)
def test_sorted_rays_have_brute_force_s_bits(gpu, simple_sort, rays, way):
    scene = case_of("random_soup").scene
    given = {"origins": rays[0], "directions": rays[1], "t_min": 0.0, "t_max": np.inf}
    tracer = rs.Tracer(
        scene, device="cuda", order="sorted", rays_at_once=2 * RAYS - 20, **WAYS[way]
    )
    answers = answers_of(tracer, given, is_brief=is_simulated())
    assert_expected(answers, answers_of(rs.Tracer(scene, "brute"), given))
    assert np.flatnonzero(answers["first_hit: status"]).tolist() == [4, 9]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.exhaustive] * is_simulated())
        for name in CASES
        if name != "random_soup"
    ],
)
def test_sorted_rays_of_every_case(gpu, simple_sort, name):
    case = case_of(name)
    rows = np.linspace(0, len(case.origins) - 1, RAYS).astype(int)
    t_min, t_max = (limit[rows] for limit in case.limits())
    given = {"origins": case.origins[rows], "directions": case.directions[rows]}
    given |= {"t_min": t_min, "t_max": t_max}
    tracer = rs.Tracer(case.scene, "grid", "cuda", order="sorted")
    answers = answers_of(tracer, given, is_brief=is_simulated())
    assert_expected(answers, answers_of(rs.Tracer(case.scene, "brute"), given))


def test_rays_in_arrays_on_the_device(gpu, simple_sort, rays):
    """All together, and ordered once for each query."""
    scene, sorts = case_of("random_soup").scene, []
    options = {"kernel": "wide", "order": "sorted"}
    tracer, oracle = rs.Tracer(scene, "bvh", "cuda", **options), rs.Tracer(scene, "brute")
    placed = [CudaArray(gpu, one.astype(np.float32)) for one in rays]
    on_host = [one.astype(np.float32) for one in rays]
    sort_rays = ray_order.sort_rays

    def note(gpu, source, count, *more):
        sorts.append(count)
        return sort_rays(gpu, source, count, *more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("raystream.cuda.launch.sort_rays", note)
        hits, expected = tracer.first_hit(*placed).host(), oracle.first_hit(*on_host)
        for column in ("t", "u", "v", "prim_id", "status"):
            assert_same_bits(getattr(hits, column), getattr(expected, column))
        assert sorts == [RAYS]
        assert_same_bits(tracer.any_hit(*placed).host(), oracle.any_hit(*on_host))
        sorts.clear()
        many, expected = tracer.multi_hit(*placed).host(), oracle.multi_hit(*on_host)
        for column in ("ray_splits", "t", "u", "v", "prim_id", "status"):
            assert_same_bits(getattr(many, column), getattr(expected, column))
        assert sorts == [RAYS]  # to count hits; the kernel that writes them finds them sorted


def test_counters_are_the_rays_own(gpu, simple_sort, rays):
    scene = case_of("random_soup").scene
    options = {"kernel": "wide", "counters": True}
    made = [rs.Tracer(scene, "bvh", "cuda", order=one, **options) for one in ("given", "sorted")]
    for query in QUERIES:
        for one in made:
            getattr(one, query)(*rays)
        given, ours = (one.counters for one in made)
        assert ours.steps.tolist() == given.steps.tolist()
        assert ours.tests.tolist() == given.tests.tolist()
        assert len(set(ours.steps.tolist())) > 1


def test_no_rays(gpu, simple_sort):
    tracer = rs.Tracer(case_of("closed_mesh").scene, "grid", "cuda", order="sorted")
    none = np.zeros((0, 3), np.float32)
    assert len(tracer.first_hit(none, none).t) == 0
    assert len(tracer.multi_hit(CudaArray(gpu, none), CudaArray(gpu, none)).host().t) == 0


# ---- Options.


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": "random"}, "order: expected one of 'given', 'sorted', got 'random'"),
        ({"order": None}, "order: expected one of 'given', 'sorted', got None"),
        ({"launch": "twice"}, "launch: expected one of 'range', 'persistent', got 'twice'"),
    ],
)
def test_unknown_names_are_refused_before_anything_is_built(gpu, monkeypatch, options, message):
    monkeypatch.setattr("raystream.structures.build_structure", None)
    with pytest.raises(ValueError, match=message):
        rs.Tracer(rs.load("cornell"), "bvh", "cuda", **options)


def test_passes_have_no_order(gpu):
    with pytest.raises(TypeError, match="multipass: has no option 'order'"):
        rs.Tracer(rs.load("cornell"), "bvh", "cuda", machine="multipass", order="sorted")


def is_odd(hit):
    return rs.Decision.CONTINUE if hit.prim_id % 2 else rs.Decision.IGNORE


def test_programs_at_the_hits_of_sorted_rays(gpu, simple_sort, rays, monkeypatch):
    """In parts, each of which is sorted."""
    monkeypatch.setattr(rounds, "HITS_AT_ONCE", 60)
    scene = case_of("random_soup").scene
    tracer, oracle = rs.Tracer(scene, "brute", "cuda", order="sorted"), rs.Tracer(scene, "brute")
    for query in ("first_hit", "multi_hit"):
        ours, theirs = (getattr(one, query)(*rays, on_hit=is_odd) for one in (tracer, oracle))
        assert ours.prim_id.tolist() == theirs.prim_id.tolist()
        assert_same_bits(ours.t, theirs.t)
    there = [CudaArray(gpu, np.ascontiguousarray(one)) for one in rays]
    counts = tracer.count_hits(*there, on_hit=is_odd).host()
    assert counts.tolist() == oracle.count_hits(*rays, on_hit=is_odd).tolist()
