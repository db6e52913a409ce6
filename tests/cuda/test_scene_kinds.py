"""Instances, spheres and height fields on CUDA have the CPU's bits, wherever the rays are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from meshes import cube, icosphere
from raystream.cuda.bvh.kernels import lay_out
from raystream.jit.cuda import CudaError, Gpu, is_simulated
from raystream.structures import options_of
from raystream.tracer.devices import build_on_cpu
from scene_cases import FIRST, ROWS, SCENE_CASES, assert_answers, assert_same, some_of
from test_scene_contents import FEATURES, check_feature, tracer_of

#: The simulator takes a tenth of a millisecond to begin a thread.
RAY_COUNT = 24 if is_simulated() else None


@cache
def case_of(name: str):
    scene, rays = SCENE_CASES[name](np.random.default_rng(2013))
    return scene, rays if RAY_COUNT is None else some_of(rays, RAY_COUNT)


#: The simulator compiles a tree's kernels for the processor in a minute, which is for .ci/nightly:
#: test_ptx.py has them in a default run.
DEFAULT = "brute" if is_simulated() else "bvh"
SLOW = [pytest.mark.exhaustive] * is_simulated()
PAIRS = [
    *(pytest.param("bvh", name, marks=SLOW) for name in SCENE_CASES),
    *(("brute", name) for name in SCENE_CASES),
]


@pytest.mark.parametrize(("structure", "name"), PAIRS)
def test_answers_have_the_bits_of_brute_force(gpu, structure, name) -> None:
    scene, rays = case_of(name)
    tracer = rs.Tracer(scene, structure, "cuda", rays_at_once=1000 if RAY_COUNT is None else 15)
    assert assert_answers(tracer, rs.Tracer(scene, "brute"), rays) > 0


class Lent:
    """An array on the device, as CuPy lends one."""

    def __init__(self, gpu: Gpu, array: np.ndarray, **changes) -> None:
        self._array = gpu.upload("rays", np.ascontiguousarray(array))
        self.__cuda_array_interface__ = {**self._array.__cuda_array_interface__, **changes}


def lent(gpu: Gpu, rays):
    return {name: Lent(gpu, values) for name, values in rays.items()}


@pytest.mark.parametrize("name", ["mirrors_and_uneven_scales", "worlds", "primitives_of_all_kinds"])
def test_arrays_on_the_device_get_ids_there(gpu, name) -> None:
    scene, rays = case_of(name)
    tracer, oracle = rs.Tracer(scene, DEFAULT, "cuda"), rs.Tracer(scene, "brute")
    on_device, first = lent(gpu, rays), oracle.first_hit(**rays)
    hits = tracer.first_hit(**on_device)
    assert_same(hits.host(), first, FIRST)
    assert_same_bits(hits.prim_id.host(), first.prim_id)
    many, expected = tracer.multi_hit(**on_device), oracle.multi_hit(**rays)
    assert_same(many.host(), expected, ROWS)
    if scene.placements is None:
        assert hits.instance_id is many.instance_id is None
    else:
        assert_same_bits(hits.instance_id.host(), first.instance_id)
        assert_same_bits(many.instance_id.host(), expected.instance_id)
    assert_same_bits(tracer.any_hit(**on_device).host(), first.is_hit)
    counts = oracle.count_hits(**rays, crossings="surfaces")
    assert_same_bits(tracer.count_hits(**on_device, crossings="surfaces").host(), counts)


def test_shapes_are_those_of_the_rays(gpu) -> None:
    scene, rays = case_of("worlds")
    shaped = {name: values[:24].reshape(4, 6, *values.shape[1:]) for name, values in rays.items()}
    tracer = rs.Tracer(scene, DEFAULT, "cuda")
    hits = tracer.first_hit(**lent(gpu, shaped))
    assert hits.prim_id.shape == hits.instance_id.shape == (4, 6)
    # One world for a row, or for all, from the host.
    for of_rays in (rays["worlds"][:6], 2):
        shaped["worlds"] = of_rays
        expected = rs.Tracer(scene, "brute").first_hit(**shaped)
        on_device = {**lent(gpu, {**shaped, "worlds": np.zeros(1)}), "worlds": of_rays}
        assert_same(tracer.first_hit(**on_device).host(), expected, FIRST)
        assert_same(tracer.first_hit(**shaped), expected, FIRST)


def test_no_rays_and_no_instances(gpu) -> None:
    one = rs.Scene.from_arrays(*cube())
    for scene in (
        rs.Scene.instances(one, np.zeros((0, 3, 4))),
        rs.Scene.spheres(np.zeros((0, 3)), 1.0),
        rs.Scene.height_field(np.full((6, 6), np.nan)),
    ):
        for structure in {DEFAULT, "brute"}:
            tracer = rs.Tracer(scene, structure, "cuda")
            assert not tracer.any_hit([[0.0, 0, 9]], [0.0, 0, -1]).any()
            assert len(tracer.multi_hit(np.zeros((0, 3)), np.zeros((0, 3))).t) == 0
            away = tracer.first_hit(Lent(gpu, np.array([[0.0, 0, 9]])), [0.0, 0, -1]).host()
            assert (away.prim_id.tolist(), away.instance_id.tolist()) == ([-1], [-1])


def test_updates_place_instances_elsewhere(gpu, monkeypatch) -> None:
    """Of the objects, which stay as they are, there is one copy."""
    scene, rays = case_of("mirrors_and_uneven_scales")
    tracer = rs.Tracer(scene, DEFAULT, "cuda")
    there = scene.placements.transforms + [0.0, 0.0, 0.0, 0.5]
    own = sum(one.nbytes for one in lay_out(tracer.structure).arrays.values())
    objects = sum(one.report.byte_count for one in tracer.structure.objects)
    assert objects > 1000
    monkeypatch.setattr(Gpu, "free_byte_count", lambda _: own)
    tracer.update(transforms=there)
    with pytest.raises(CudaError, match="the scene takes"):
        rs.Tracer(scene, DEFAULT, "cuda")
    oracle = rs.Tracer(scene.with_transforms(there), "brute")
    assert_same(tracer.first_hit(**rays), oracle.first_hit(**rays), FIRST)


@pytest.mark.parametrize("structure", [pytest.param(one, marks=SLOW) for one in ("bvh", "brute")])
def test_counters_are_the_processor_s(gpu, structure) -> None:
    scene, rays = case_of("mirrors_and_uneven_scales")
    ours, theirs = (rs.Tracer(scene, structure, one, counters=True) for one in ("cuda", "cpu"))
    for one in (ours, theirs):
        one.first_hit(**rays)
    for column in ("steps", "leaves", "tests", "shadings"):
        found, expected = (getattr(one.counters, column) for one in (ours, theirs))
        assert found.tolist() == expected.tolist()


def test_filters_and_programs_run_on_the_host(gpu) -> None:
    scene, rays = case_of("worlds")
    tracer, oracle = rs.Tracer(scene, DEFAULT, "cuda"), rs.Tracer(scene)

    def keep(hit):
        return hit.instance_id % 2 == 0 or hit.is_entering

    def add(hit, payload):
        payload[0] += hit.t
        payload[1] = hit.instance_id

    first = oracle.first_hit(**rays)
    for options in ({"on_hit": keep}, {"skip_prim_ids": first}):
        assert_same(tracer.first_hit(**rays, **options), oracle.first_hit(**rays, **options), FIRST)
        assert_same(tracer.multi_hit(**rays, **options), oracle.multi_hit(**rays, **options), ROWS)
        assert_same_bits(tracer.any_hit(**rays, **options), oracle.any_hit(**rays, **options))
    payloads = [np.zeros((len(first.t), 2), np.float32) for _ in range(2)]
    for one, payload in zip((tracer, oracle), payloads, strict=True):
        one.trace(**rays, on_hit=add, payload=payload)
    assert_same_bits(*payloads)
    on_device = lent(gpu, rays)
    for ask in (
        lambda: tracer.first_hit(**on_device, on_hit=keep),
        lambda: tracer.any_hit(**on_device, skip_prim_ids=0),
        lambda: tracer.trace(**on_device, on_hit=add, payload=payloads[0]),
    ):
        with pytest.raises(rs.RaystreamError, match="rays on a GPU, unless the scene is"):
            ask()


def test_bad_worlds_are_named(gpu) -> None:
    one, eye = rs.Scene.from_arrays(*cube()), np.eye(3, 4)
    tracer = rs.Tracer(rs.Scene.instances(one, [eye, eye], worlds=[0, 1]), DEFAULT, "cuda")
    ray = Lent(gpu, np.array([[0.0, 0, 5], [0.0, 0, 5]])), [0.0, 0, -1]
    with pytest.raises(ValueError, match="worlds: expected the world of each ray, 0 to 1"):
        tracer.first_hit(*ray)
    for bad in (2, [0, -2], Lent(gpu, np.array([0, 2], np.int32))):
        with pytest.raises(ValueError, match="worlds: expected -1 to 1"):
            tracer.any_hit(*ray, worlds=bad)
    with pytest.raises(ValueError, match="worlds: shape"):
        tracer.any_hit(*ray, worlds=Lent(gpu, np.zeros(3, np.int32)))
    with pytest.raises(TypeError, match="worlds: expected integers"):
        tracer.any_hit(*ray, worlds=Lent(gpu, np.zeros(2, np.float32)))
    gaps = {"shape": (2,), "strides": (8,)}
    with pytest.raises(TypeError, match="worlds: expected a contiguous array"):
        tracer.any_hit(*ray, worlds=Lent(gpu, np.zeros(4, np.int32), **gaps))
    with pytest.raises(ValueError, match="worlds: expected None"):
        rs.Tracer(one, device="cuda").first_hit(*ray, worlds=0)


def test_what_is_not_supported_says_so(gpu) -> None:
    placed = rs.Scene.instances(rs.Scene.from_arrays(*cube()), [np.eye(3, 4)])
    ball = rs.Scene.spheres([[0, 0, 0]], 1.0)
    for scene, says in ((placed, "instances"), (ball, "spheres")):
        with pytest.raises(rs.RaystreamError, match=f"build='device'.*{says}"):
            rs.Tracer(scene, device="cuda", build="device")
        with pytest.raises(ValueError, match="structure='bvh' or structure='brute'"):
            rs.Tracer(scene, "grid", "cuda")
        tracer = rs.Tracer(scene, DEFAULT, "cuda")
        assert tracer.contains([0.25, 0.5, 0.25])


# A cluster and a walk take no tracer of CUDA: workers build their own, and steps are those of a BVH
# on the processor.
@pytest.mark.parametrize("kind", ["instances", "worlds", "spheres", "fields"])
@pytest.mark.parametrize("feature", [name for name in FEATURES if name not in ("clusters", "walk")])
def test_a_feature_works_or_names_what_it_does_not_support(gpu, feature, kind, tmp_path) -> None:
    tracer = tracer_of(kind, DEFAULT, "cuda")
    check_feature(feature, kind, tracer, tmp_path)


def test_what_does_not_fit_says_so(gpu, monkeypatch) -> None:
    """Objects count, too: each has more bytes than the tree over them."""
    scene = rs.Scene.instances(rs.Scene.from_arrays(*icosphere(3)), [np.eye(3, 4)])
    structure = build_on_cpu(options_of("bvh"), scene.triangles)
    own = sum(one.nbytes for one in structure.arrays.values())
    monkeypatch.setattr(Gpu, "free_byte_count", lambda _: own + 1000)
    with pytest.raises(CudaError, match=r"the scene takes [\d,]+ bytes"):
        rs.Tracer(scene, "bvh", "cuda")


def test_pictures_are_the_processor_s(gpu) -> None:
    """The host shades what queries find."""
    box = rs.load("cornell")
    places = np.tile(np.eye(3, 4), (2, 1, 1))
    places[1, :, :3] *= 0.4
    ball = rs.Scene.spheres([[400, 350, 150]], 60.0)
    for scene in (
        rs.Scene.instances(box, places, camera=box.camera),
        rs.Scene.combine([box, ball], camera=box.camera),
    ):
        for mode, samples in (("raycast", 1), ("path", 2)):
            ours, theirs = (
                rs.render(one, mode, (6, 4), samples=samples).pixels
                for one in (rs.Tracer(scene, DEFAULT, "cuda"), rs.Tracer(scene))
            )
            assert_same_bits(ours, theirs)
        ours, theirs = (
            rs.visibility(rs.Tracer(scene, DEFAULT, device), [[278.0, 273, -800], [278, 273, 100]])
            for device in ("cuda", "cpu")
        )
        assert_same_bits(ours, theirs)


def test_returns_and_single_rays(gpu) -> None:
    for name in ("mirrors_and_uneven_scales", "primitives_of_all_kinds"):
        scene, rays = case_of(name)
        ours, theirs = rs.Tracer(scene, DEFAULT, "cuda"), rs.Tracer(scene)
        ray = rays["origins"], rays["directions"]
        a, b = (rs.lidar_returns(one, *ray) for one in (ours, theirs))
        assert_same(a, b, ("ranges", "prim_id", "instance_id"))
        a, b = (one.cast(ray[0][3], ray[1][3]) for one in (ours, theirs))
        assert (a.t, a.prim_id, a.instance_id) == (b.t, b.prim_id, b.instance_id)
