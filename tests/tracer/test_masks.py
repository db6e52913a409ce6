"""Masks: the bits of the same scene without the parts that a ray's mask leaves out."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from mask_cases import (
    check,
    left_of,
    of_all_kinds,
    of_instances,
    of_meshes,
    some_masks,
    some_rays,
)
from meshes import cube
from raystream.core.errors import RaystreamError
from raystream.core.masks import ALL_BITS, MaskRuns


def _later(*names: str) -> list[Any]:
    """Cases of the second tier: their kernels are compiled for them alone."""
    return [pytest.param(name, marks=pytest.mark.ci) for name in names]


STRUCTURES = ("bvh", "brute", *_later("kdtree", "grid", "graph"))
KERNELS = ("packet", "groups", "wavefront", "single")
COUNT = 400

#: Scenes, their structures or kernels, and the precision.
WAYS = [
    *((of_meshes, one, {}) for one in ("packet", "groups", "wavefront", "single", "brute")),
    *((of_instances, one, {}) for one in ("packet", "groups", "wavefront", "single", "brute")),
    *((of_all_kinds, one, {}) for one in ("packet", "wavefront", "single", "brute")),
    *(
        (of_meshes, one, {"precision": "float64"})
        for one in ("packet", "groups", "single", "brute")
    ),
]

#: Of these, everyday tests have those whose kernels others need, too.
_EVERYDAY = (0, 1, 2, 3, 4, 6, 9, 10, 14)


def _named(make: Any, way: str, options: dict[str, str], k: int) -> Any:
    name = "-".join([make.__name__[3:], way, *options.values()])
    return pytest.param(make, way, options, id=name, marks=[pytest.mark.ci] * (k not in _EVERYDAY))


def _tracer(scene: rs.Scene, way: str, options: dict[str, str]) -> rs.Tracer:
    structure = rs.Bvh(kernel=way) if way in KERNELS else way
    return rs.Tracer(scene, structure, **options)


@pytest.mark.parametrize(
    ("make", "way", "options"), [_named(*one, k) for k, one in enumerate(WAYS)]
)
def test_bits_are_those_without_the_parts(make: Any, way: str, options: dict[str, str]) -> None:
    case = make()
    tracer, left = _tracer(case.scene, way, options), left_of(case, **options)
    for coherent in (True, False):
        check(tracer, left, some_rays(COUNT, 1, coherent), some_masks(COUNT))


@pytest.mark.parametrize("structure", STRUCTURES)
def test_each_structure(structure: str) -> None:
    case = of_meshes()
    for coherent in (True, False):
        rays = some_rays(COUNT, 1, coherent)
        check(rs.Tracer(case.scene, structure), left_of(case), rays, some_masks(COUNT))


@pytest.mark.parametrize("structure", _later("bvh", "brute"))
def test_worlds(structure: str) -> None:
    case, worlds = of_instances(has_worlds=True), np.arange(COUNT) % 2
    tracer = rs.Tracer(case.scene, structure)
    check(tracer, left_of(case), some_rays(COUNT, 1, True), some_masks(COUNT), worlds=worlds)


@pytest.mark.ci
def test_the_multipass_machine() -> None:
    case = of_meshes()
    tracer = rs.Tracer(case.scene, machine="multipass")
    check(tracer, left_of(case), some_rays(COUNT, 1, True), some_masks(COUNT))


_MASK = st.integers(1, ALL_BITS) | st.sampled_from([1 << k for k in range(32)])


@pytest.mark.parametrize(
    ("make", "way", "options"), [_named(*one, k) for k, one in enumerate(WAYS)]
)
@settings(max_examples=6, deadline=None)
@given(
    parts=st.lists(_MASK, min_size=5, max_size=5),
    masks=st.lists(_MASK | st.just(0), min_size=1, max_size=4),
    seed=st.integers(0, 99),
    coherent=st.booleans(),
)
def test_any_masks(
    make: Any,
    way: str,
    options: dict[str, str],
    parts: list[int],
    masks: list[int],
    seed: int,
    coherent: bool,
) -> None:
    case, own = make(parts), np.resize(np.array(masks, np.uint32), 100)
    given = own if len(masks) > 1 else own[0]
    tracer = _tracer(case.scene, way, options)
    check(tracer, left_of(case, masks, **options), some_rays(100, seed, coherent), given)


def test_instances_of_instances_flattened_and_moved() -> None:
    mesh = rs.Mesh(*cube(), mask=8)
    places = np.zeros((2, 3, 4))
    places[:, :, :3], places[1, 0, 3] = np.eye(3), 5.0
    pair = rs.Scene.instances(mesh, places, masks=[0, 2])
    places[1, 0, 3] = 20.0
    scene = rs.Scene.instances(pair, places, masks=[0, 4])
    assert [one.mask for one in scene.flattened().meshes] == [8, 2, 4, 4]
    rays = [[0, 0, -9], [5, 0, -9], [20, 0, -9], [25, 0, -9]], [0, 0, 1]
    for one in (scene, scene.with_transforms(scene.placements.transforms), scene.flattened()):
        tracer = rs.Tracer(one)
        for mask, expected in ((8, [1, 0, 0, 0]), (2, [0, 1, 0, 0]), (4 | 2, [0, 1, 1, 1])):
            assert tracer.any_hit(*rays, mask=mask).tolist() == expected
        assert tracer.any_hit(*rays).all()


def _emptied(scene: rs.Scene, mask: int) -> rs.Scene:
    """The same scene, where what the mask leaves out cannot be hit; ids are the same."""
    meshes = [
        one if one.mask & mask else one.moved(np.full(one.vertices.shape, np.nan))
        for one in scene.meshes
    ]
    return rs.Scene(meshes)


def _is_low(hit: Any) -> Any:
    return hit.u < 0.5


def _add(hit: Any, payload: Any) -> None:
    payload[0] += hit.t


def test_filters_programs_and_single_rays() -> None:
    scene = of_meshes().scene
    tracer, other = rs.Tracer(scene), rs.Tracer(_emptied(scene, 2))
    rays = some_rays(COUNT, 1, True)
    skip = tracer.first_hit(*rays, mask=2)
    for options in ({"on_hit": _is_low}, {"skip_prim_ids": skip}):
        first, expected = (
            tracer.first_hit(*rays, mask=2, **options),
            other.first_hit(*rays, **options),
        )
        np.testing.assert_array_equal(first.t, expected.t)
        np.testing.assert_array_equal(first.prim_id, expected.prim_id)
        for query in ("any_hit", "count_hits"):
            found = getattr(tracer, query)(*rays, mask=2, **options)
            np.testing.assert_array_equal(found, getattr(other, query)(*rays, **options))
        many, expected = (
            tracer.multi_hit(*rays, mask=2, **options),
            other.multi_hit(*rays, **options),
        )
        np.testing.assert_array_equal(many.prim_id, expected.prim_id)
    masks = np.full(COUNT, 2)
    total = tracer.trace(*rays, on_hit=_add, payload=float, mask=masks)
    np.testing.assert_array_equal(total, other.trace(*rays, on_hit=_add, payload=float))
    for k in range(0, COUNT, 50):
        ray = rays[0], rays[1][k]
        assert tracer.cast(*ray, mask=2).t == other.cast(*ray).t
    counting = rs.Tracer(scene, counters=True)
    np.testing.assert_array_equal(counting.count_hits(*rays, mask=2), other.count_hits(*rays))


def test_large_batches_are_raced_with_masks() -> None:
    scene, rays = of_meshes().scene, some_rays(100_000, 6, False)
    masks = some_masks(100_000)
    tracer, single = rs.Tracer(scene), rs.Tracer(scene, kernel="single")
    for query in ("any_hit", "count_hits"):
        found = getattr(tracer, query)(*rays, mask=masks)
        np.testing.assert_array_equal(found, getattr(single, query)(*rays, mask=masks))


def test_masks_after_updates_and_loads(tmp_path: Any) -> None:
    scene = rs.Scene([rs.Mesh(*cube(), mask=1)])
    ray = [0, 0, -9], [0, 0, 1]
    tracer = rs.Tracer(scene)
    tracer.save(tmp_path / "saved.npz")
    assert not rs.Tracer.load(tmp_path / "saved.npz", scene).any_hit(*ray, mask=2)
    tracer.update(rs.Scene([scene.meshes[0].with_mask(2)]))
    assert tracer.any_hit(*ray, mask=2)
    assert not tracer.any_hit(*ray, mask=1)
    tracer.update(scene.meshes[0].vertices - 0.1)
    assert tracer.any_hit(*ray, mask=2)


def _masked_scenes() -> dict[str, rs.Scene]:
    """Scenes whose parts have masks, one behind the other."""
    near, far = rs.Mesh(*cube(), mask=1), rs.Mesh(*cube(), mask=2).moved(cube()[0] + [0, 0, 4])
    field = rs.Scene.height_field(np.zeros((2, 2)), origin=(-1, -1, 7), spacing=2.0, mask=8)
    both = rs.Scene([near, rs.Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), far])
    places = np.tile(np.eye(4)[:3], (2, 1, 1))
    places[1, 2, 3] = 9.0
    return {
        "triangles": both,
        "primitives": rs.Scene.combine([both, rs.Scene.spheres([[0, 0, 9]], 1.0, mask=4), field]),
        "instances": rs.Scene.instances([both, near], places, [0, 1]),
        "masked instances": rs.Scene.instances([both], places, [0, 0], masks=[0, 4]),
    }


@pytest.mark.parametrize("name", list(_masked_scenes()))
def test_masks_are_saved_and_loaded(name: str, tmp_path: Any) -> None:
    scene = _masked_scenes()[name]
    tracer = rs.Tracer(scene)
    tracer.save(tmp_path / "saved.npz")
    loaded = rs.Tracer.load(tmp_path / "saved.npz")
    tracers = [tracer, loaded, rs.Tracer(loaded.scene), pickle.loads(pickle.dumps(loaded))]
    tracers.append(rs.Tracer.load(tmp_path / "saved.npz", scene))
    for mask in range(1, 16):
        found = [
            one.multi_hit([0, 0, -9], [0, 0, 1], mask=mask).prim_id.tolist() for one in tracers
        ]
        assert found == found[:1] * len(found), mask
    assert loaded.count_hits([0, 0, -9], [0, 0, 1], mask=16) == 0


def test_saved_masks_are_checked(tmp_path: Any) -> None:
    rs.Tracer(_masked_scenes()["primitives"]).save(tmp_path / "saved.npz")
    whole = dict(np.load(tmp_path / "saved.npz"))
    for part in ("meshes", "fields", "spheres"):
        key = f"triangles.masks.{part}"
        for wrong in (whole[key][:0], whole[key].astype(np.int64), np.zeros_like(whole[key])):
            np.savez(tmp_path / "bad.npz", **(whole | {key: wrong}))
            with pytest.raises(rs.FileFormatError, match="masks"):
                rs.Tracer.load(tmp_path / "bad.npz")


def test_runs_of_masks() -> None:
    runs = MaskRuns.of(np.array([0, 4, 4, 9, 12]), np.array([1, 5, 2, 2, 7], np.uint32))
    assert runs.starts.tolist() == [0, 4, 12]
    assert runs.masks.tolist() == [1, 2, 7]
    # Asked for unless all rays have a bit of each run in common.
    for masks, is_free in (([3, 7], True), ([3], True), ([3, 5], False), ([1, 2], False)):
        assert runs.admit(np.array(masks, np.uint32)) is is_free
    none = MaskRuns.of(np.zeros(0), np.zeros(0, np.uint32))
    assert none.masks.tolist() == [ALL_BITS]
    assert not rs.Tracer(rs.Scene([])).any_hit([0, 0, 0], [0, 0, 1], mask=1)


@pytest.mark.parametrize(
    ("mask", "error", "text"),
    [
        (-1, ValueError, "mask: expected integers of 32 bits, 0 to 4,294,967,295, got -1"),
        (2**32, ValueError, "got 4294967296"),
        (1.0, TypeError, "mask: expected integers, got float64"),
        (True, TypeError, "mask: expected integers, got bool"),
        ([1, 2, 3], ValueError, r"mask: shape \(3,\) does not broadcast to the rays' shape \(2,\)"),
    ],
)
def test_bad_masks_of_rays(mask: Any, error: type[Exception], text: str) -> None:
    tracer = rs.Tracer(rs.Scene([rs.Mesh(*cube())]))
    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        with pytest.raises(error, match=text):
            query(np.zeros((2, 3)), [0, 0, 1], mask=mask)


@pytest.mark.parametrize("mask", [-1, 0, 2**32, 1.5, [1, 2]])
def test_bad_masks_of_geometry(mask: Any) -> None:
    mesh = rs.Mesh(*cube())
    makers = (
        lambda: rs.Mesh(*cube(), mask=mask),
        lambda: mesh.with_mask(mask),
        lambda: rs.Scene.spheres([[0, 0, 0]], 1.0, mask=mask),
        lambda: rs.Scene.height_field(np.zeros((2, 2)), mask=mask),
    )
    for make in makers:
        with pytest.raises((ValueError, TypeError), match="mask: "):
            make()


@pytest.mark.parametrize("masks", [[-1, 1], [1.0, 2.0], [1], 1])
def test_bad_masks_of_instances(masks: Any) -> None:
    places = np.zeros((2, 3, 4))
    places[:, :, :3] = np.eye(3)
    with pytest.raises((ValueError, TypeError), match="masks: "):
        rs.Scene.instances(rs.Mesh(*cube()), places, masks=masks)


def test_refusals_name_the_argument() -> None:
    rays = [0, 0, 0], [0, 0, 1]
    other = rs.Tracer(rs.Scene([rs.Mesh(*cube(), mask=2)]), machine="multipass")
    with pytest.raises(RaystreamError, match=r"mask: .*on_hit.* machine='multipass'; use machine"):
        other.first_hit(*rays, mask=1, on_hit=_is_low)
