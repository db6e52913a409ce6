"""Masks: the bits of the same scene without the parts that a ray's mask leaves out."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import cube, icosphere, soup
from raystream.core.errors import RaystreamError
from raystream.core.masks import ALL_BITS, MaskRuns

COLUMNS = ("t", "u", "v", "prim_id", "instance_id")


def _later(*names: str) -> list[Any]:
    """Cases of the second tier: their kernels are compiled for them alone."""
    return [pytest.param(name, marks=pytest.mark.ci) for name in names]


STRUCTURES = ("bvh", "brute", *_later("kdtree", "grid", "graph"))
KERNELS = ("packet", "groups", "wavefront", "single")
MASKS = (1, 2, 4, 1 | 2, ALL_BITS)

#: Masks of rays: of all and of none of the meshes, and of some.
RAY_MASKS = (0, 1, 2, 5, ALL_BITS)
COUNT = 400


def _rays(count: int, seed: int, coherent: bool) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    if coherent:
        side = int(count**0.5)
        axis = np.linspace(-0.4, 0.4, side)
        directions = np.stack(np.broadcast_arrays(axis, axis[:, None], 1.0), axis=-1)
        return np.array([0.1, 0.2, -5.0]), directions.reshape(-1, 3)
    return rng.uniform(-3.0, 3.0, (count, 3)), rng.normal(size=(count, 3))


def _meshes() -> list[rs.Mesh]:
    rng = np.random.default_rng(7)
    parts = [soup(80, 1), icosphere(2), cube(), icosphere(2), soup(40, 2)]
    return [
        rs.Mesh(np.asarray(points) + rng.uniform(-1.0, 1.0, 3), faces, mask=int(mask))
        for (points, faces), mask in zip(parts, MASKS, strict=True)
    ]


def _only(mesh: rs.Mesh) -> rs.Mesh:
    """The mesh without anything to hit, with as many triangles."""
    return mesh.moved(np.full(mesh.vertices.shape, np.nan))


def _without(scene: rs.Scene, mask: int) -> rs.Scene:
    """The same scene, where what the mask leaves out cannot be hit; ids are the same."""
    return rs.Scene([one if one.mask & mask else _only(one) for one in scene.meshes])


def check(
    tracer: rs.Tracer, left: dict[int, rs.Tracer], rays: Any, masks: Any, **more: Any
) -> None:
    """Compare all queries of rays with a mask each with those of scenes without the parts."""
    given: dict[str, Any] = {"mask": masks, **more}
    first, seen = tracer.first_hit(*rays, **given), tracer.any_hit(*rays, **given)
    count, many = tracer.count_hits(*rays, **given), tracer.multi_hit(*rays, **given)
    few = tracer.multi_hit(*rays, **given, max_hits=2)
    rows = np.broadcast_to(masks, first.t.shape)
    for mask, other in left.items():
        mine = np.flatnonzero(rows == mask)
        some = [np.broadcast_to(part, (*first.t.shape, 3))[mine] for part in rays]
        others = {key: value[mine] for key, value in more.items()}
        expected = other.first_hit(*some, **others)
        for name in COLUMNS:
            np.testing.assert_array_equal(getattr(first, name)[mine], getattr(expected, name))
        np.testing.assert_array_equal(seen[mine], other.any_hit(*some, **others))
        np.testing.assert_array_equal(count[mine], other.count_hits(*some, **others))
        for found, limit in ((many, None), (few, 2)):
            reference = other.multi_hit(*some, **others, max_hits=limit)
            chosen = np.isin(found.ray_id, mine)
            for name in COLUMNS:
                wanted = getattr(reference, name)
                np.testing.assert_array_equal(getattr(found, name)[chosen], wanted)


def _masks() -> np.ndarray:
    return np.random.default_rng(2).choice(RAY_MASKS, COUNT)


@pytest.mark.parametrize("coherent", [True, False])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_each_structure(structure: str, coherent: bool) -> None:
    scene = rs.Scene(_meshes())
    left = {mask: rs.Tracer(_without(scene, mask), "brute") for mask in RAY_MASKS}
    check(rs.Tracer(scene, structure), left, _rays(COUNT, 1, coherent), _masks())


@pytest.mark.parametrize("kernel", KERNELS)
def test_each_kernel_for_many_rays(kernel: str) -> None:
    scene = rs.Scene(_meshes())
    left = {mask: rs.Tracer(_without(scene, mask), "brute") for mask in RAY_MASKS}
    check(rs.Tracer(scene, kernel=kernel), left, _rays(COUNT, 1, True), _masks())


@pytest.mark.ci
def test_the_multipass_machine() -> None:
    scene = rs.Scene(_meshes())
    left = {mask: rs.Tracer(_without(scene, mask), "brute") for mask in RAY_MASKS}
    tracer = rs.Tracer(scene, machine="multipass")
    check(tracer, left, _rays(COUNT, 1, True), _masks())


def _placed(mask: int | None, worlds: bool) -> rs.Scene:
    """Instances, some of whose masks are those of their meshes; one object for each of them.

    With a mask, objects that it leaves out have nothing to hit.
    """
    rng = np.random.default_rng(3)
    meshes, own = _meshes() * 2, np.array([0, 0, 1, 4, 0, 2, 3, 0, 0, 1])
    places = np.zeros((len(meshes), 3, 4))
    places[:, :, :3] = np.eye(3) * rng.uniform(0.5, 1.5, (len(meshes), 1, 1))
    places[:, :, 3] = rng.uniform(-1.0, 1.0, (len(meshes), 3))
    if mask is not None:
        held = [int(k) or mesh.mask for k, mesh in zip(own, meshes, strict=True)]
        meshes = [one if k & mask else _only(one) for k, one in zip(held, meshes, strict=True)]
    ids = np.arange(len(meshes))
    given = {"worlds": ids % 3 - 1} if worlds else {}
    return rs.Scene.instances(meshes, places, ids, masks=own if mask is None else None, **given)


@pytest.mark.parametrize(
    "kernel", ["groups", "brute", *_later("packet", "wavefront", "single", "worlds")]
)
def test_instances(kernel: str) -> None:
    worlds = kernel == "worlds"
    options = {"kernel": kernel} if kernel in KERNELS else {}
    more = {"worlds": np.arange(COUNT) % 2} if worlds else {}
    structure = "brute" if kernel == "brute" else "bvh"
    tracer = rs.Tracer(_placed(None, worlds), structure, **options)
    left = {mask: rs.Tracer(_placed(mask, worlds), "brute") for mask in RAY_MASKS}
    check(tracer, left, _rays(COUNT, 1, True), _masks(), **more)


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


def _combined(mask: int) -> rs.Scene:
    """Meshes, a height field and spheres; what a mask leaves out is not there."""
    rng = np.random.default_rng(5)
    heights, places = rng.uniform(-1.0, 1.0, (9, 9)), rng.uniform(-2.0, 2.0, (30, 3))
    if not mask & 2:
        heights = np.full((9, 9), np.nan)
    field = rs.Scene.height_field(heights, origin=(-2, -2, 0), spacing=0.5, mask=2)
    spheres = [rs.Scene.spheres(places, 0.4, mask=4)] if mask & 4 else []
    return rs.Scene.combine([_without(rs.Scene(_meshes()), mask), field, *spheres])


@pytest.mark.parametrize("kernel", ["packet", *_later("wavefront", "single", "brute")])
def test_spheres_and_height_fields(kernel: str) -> None:
    options = {} if kernel == "brute" else {"kernel": kernel}
    structure = "brute" if kernel == "brute" else "bvh"
    tracer = rs.Tracer(_combined(ALL_BITS), structure, **options)
    left = {mask: rs.Tracer(_combined(mask), "brute") for mask in RAY_MASKS}
    check(tracer, left, _rays(COUNT, 1, True), _masks())


def _is_low(hit: Any) -> Any:
    return hit.u < 0.5


def _add(hit: Any, payload: Any) -> None:
    payload[0] += hit.t


def test_filters_programs_and_single_rays() -> None:
    scene = rs.Scene(_meshes())
    tracer, other = rs.Tracer(scene), rs.Tracer(_without(scene, 2))
    rays = _rays(COUNT, 1, True)
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


_MASK = st.integers(1, ALL_BITS) | st.sampled_from([1 << k for k in range(32)])


@settings(max_examples=30, deadline=None)
@given(st.lists(_MASK, min_size=5, max_size=5), st.lists(_MASK | st.just(0), min_size=1), st.data())
def test_any_masks(parts: list[int], masks: list[int], data: st.DataObject) -> None:
    meshes = [one.with_mask(mask) for one, mask in zip(_meshes(), parts, strict=True)]
    tracer = rs.Tracer(rs.Scene(meshes), kernel=data.draw(st.sampled_from(KERNELS)))
    rays = _rays(100, 4, data.draw(st.booleans()))
    own = np.resize(np.array(masks, np.uint32), 100)
    every = tracer.multi_hit(*rays)
    seen = (np.array(parts, np.uint32)[every.mesh_id] & own[every.ray_id]) != 0
    many, counts = tracer.multi_hit(*rays, mask=own), np.bincount(every.ray_id[seen], minlength=100)
    np.testing.assert_array_equal(many.t, every.t[seen])
    np.testing.assert_array_equal(many.prim_id, every.prim_id[seen])
    np.testing.assert_array_equal(tracer.count_hits(*rays, mask=own), counts)
    first = tracer.first_hit(*rays, mask=own)
    np.testing.assert_array_equal(first.prim_id >= 0, counts > 0)
    rows = (np.cumsum(counts) - counts)[counts > 0]
    np.testing.assert_array_equal(first.prim_id[counts > 0], many.prim_id[rows])


def test_large_batches_are_raced_with_masks() -> None:
    scene, rays = rs.Scene(_meshes()), _rays(100_000, 6, False)
    masks = np.random.default_rng(2).choice(RAY_MASKS, 100_000)
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
    scene = rs.Scene([rs.Mesh(*cube())])
    rays = [0, 0, 0], [0, 0, 1]
    with pytest.raises(RaystreamError, match="mask: not supported with precision='float64'"):
        rs.Tracer(scene, precision="float64").first_hit(*rays, mask=1)
    other = rs.Tracer(rs.Scene([rs.Mesh(*cube(), mask=2)]), machine="multipass")
    with pytest.raises(RaystreamError, match=r"mask: .*on_hit.* machine='multipass'; use machine"):
        other.first_hit(*rays, mask=1, on_hit=_is_low)
