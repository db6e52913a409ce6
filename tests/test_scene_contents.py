"""Every feature with every kind of scene: it works, or says by name what it does not support."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream as rs
import users_shapes
from raystream.core.scene_kinds import FEATURES as DECLARED
from raystream.core.scene_kinds import is_supported
from raystream.stepper import walk

RAY = [278.0, 273.0, -800.0], [0.0, 0.0, 1.0]
POINTS = [[278.0, 273.0, -800.0], [278.0, 273.0, 100.0]]

#: What the refusals of each kind say.
SAYS = {
    "instances": "scene with instances",
    "worlds": "worlds",
    "spheres": "scene with spheres",
    "fields": "scene with height fields",
    "shapes": "scene with shapes",
    "float64": "precision='float64'",
    "placed spheres": "spheres",
    "placed fields": "height fields",
    "placed float64": "precision='float64'",
}


@cache
def tracer_of(kind: str, structure: str = "bvh", device: str = "cpu") -> rs.Tracer:
    box = rs.load("cornell")
    if kind == "float64":
        return rs.Tracer(box, structure, device, precision="float64")
    if kind.endswith("spheres"):
        ball = rs.Scene.spheres([[278, 273, 280]], 50.0)
        box = rs.Scene.combine([box, ball], camera=box.camera)
    if kind.endswith("fields"):
        ground = rs.Scene.height_field(np.zeros((3, 3)), origin=(200, 200, 1), spacing=50.0)
        box = rs.Scene.combine([box, ground], camera=box.camera)
    if kind in ("spheres", "fields"):
        return rs.Tracer(box, structure, device)
    if kind == "shapes":
        records = np.array([((278, 273, 280), 80.0, 30.0)], users_shapes.TORUS)
        ring = rs.Scene.shapes(users_shapes.torus, records)
        return rs.Tracer(rs.Scene.combine([box, ring], camera=box.camera), structure, device)
    worlds = [0, 0] if kind == "worlds" else None
    transforms = np.tile(np.eye(4)[:3], (2, 1, 1))
    transforms[1, 0, 3] = 2000.0
    scene = rs.Scene.instances([box], transforms, worlds=worlds, camera=box.camera)
    precision = "float64" if kind == "placed float64" else "float32"
    return rs.Tracer(scene, structure, device, precision=precision)


def keep(hit: Any, payload: Any) -> None:
    payload[0] += 1.0


def accept(hit: Any) -> bool:
    return True


#: Calls, and the names of the features that they need: see `core.scene_kinds.FEATURES`.
FEATURES: dict[str, tuple[Callable[[rs.Tracer, Path], Any], str]] = {
    "first_hit": (lambda t, _: t.first_hit(*RAY, **_world(t)), "queries"),
    "any_hit": (lambda t, _: t.any_hit(*RAY, **_world(t)), "queries"),
    "multi_hit": (lambda t, _: t.multi_hit(*RAY, **_world(t)), "queries"),
    "count_hits": (lambda t, _: t.count_hits(*RAY, **_world(t)), "queries"),
    "surfaces": (
        lambda t, _: t.count_hits(*RAY, crossings="surfaces", **_world(t)),
        "queries",
    ),
    "memory_needed": (lambda t, _: t.memory_needed(1000), "queries"),
    "cast": (lambda t, _: t.cast(*RAY, **_world(t, "world")), "cast"),
    "brute": (lambda t, _: _again(t, structure="brute"), "structure='brute'"),
    "worlds": (lambda t, _: _with_worlds(t).first_hit(*RAY, worlds=0), "worlds"),
    "in a world": (lambda t, _: _with_worlds(t).in_world(0).first_hit(*RAY), "worlds"),
    "counters": (
        lambda t, _: _again(t, counters=True).count_hits(*RAY, **_world(t)),
        "counters=True",
    ),
    "filter": (
        lambda t, _: t.first_hit(*RAY, on_hit=accept, **_world(t)),
        "on_hit, skip_prim_ids",
    ),
    "skip": (
        lambda t, _: t.any_hit(*RAY, skip_prim_ids=0, **_world(t)),
        "on_hit, skip_prim_ids",
    ),
    "mask": (lambda t, _: t.first_hit(*RAY, mask=1, **_world(t)), "mask"),
    "trace": (lambda t, _: t.trace(*RAY, on_hit=keep, payload=float, **_world(t)), "trace"),
    "update of the camera": (
        lambda t, _: t.update(t.scene.replace(camera=rs.Camera((0, 0, 0), (0, 0, 1)))),
        "update",
    ),
    "render": (lambda t, _: rs.render(t, "raycast", size=(8, 8)), "render"),
    "render glass": (
        lambda t, _: rs.render(_cut_out(t), "raycast", size=(8, 8)),
        "render, materials that are not opaque",
    ),
    "heat map": (lambda t, _: rs.heatmap(_again(t, counters=True), size=(8, 8)), "heatmap"),
    "lidar_returns": (lambda t, _: rs.lidar_returns(t, *RAY, **_world(t)), "lidar_returns"),
    "thickness": (lambda t, _: rs.thickness(t, *RAY, nested="inner", **_world(t)), "thickness"),
    "visibility": (lambda t, _: rs.visibility(t, POINTS), "visibility"),
    "visibility of hits": (
        lambda t, _: rs.visibility(t, t.first_hit(*RAY, **_world(t))),
        "visibility, points on surfaces",
    ),
    "surface_points": (
        lambda t, _: rs.surface_points(t, [0], instance_ids=_instances(t)),
        "surface_points",
    ),
    "out": (
        lambda t, path: rs.visibility(t, POINTS, out=path / "seen.npy"),
        "visibility, out",
    ),
    "cut-outs": (
        lambda t, _: rs.visibility(_cut_out(t), POINTS),
        "visibility, cutouts=True, with surfaces that are not opaque",
    ),
    "visible_faces": (lambda t, _: rs.visible_faces(t, size=(8, 8)), "visible_faces"),
    "view_factors": (lambda t, _: rs.view_factors(t, rays=64), "view_factors"),
    "closest_point": (
        lambda t, _: t.closest_point(POINTS, **_world(t)),
        "closest points",
    ),
    "signed_distance": (
        lambda t, _: t.signed_distance(POINTS, method="winding", **_world(t)),
        "closest points, inside tests",
    ),
    "contains": (lambda t, _: t.contains(POINTS, method="winding", **_world(t)), "inside tests"),
    "winding_number": (lambda t, _: t.winding_number(POINTS, **_world(t)), "winding numbers"),
    "query_zarr": (lambda t, path: _query_file(t, path), "query_zarr"),
    "save": (lambda t, path: _saved(t, path / "a.npz"), "save"),
    "clusters": (lambda t, _: _pack(t), "a cluster"),
    "walk": (lambda t, _: walk(t, *RAY), "walk"),
}


def _again(tracer: rs.Tracer, structure: str = "bvh", **options: Any) -> rs.Tracer:
    """Another tracer of the same scene."""
    precision = tracer.structure.precision
    if tracer.device != "cpu":
        options["device"] = tracer.device
    return rs.Tracer(tracer.scene, structure, precision=precision, **options)


@cache
def _cut_out(tracer: rs.Tracer) -> rs.Tracer:
    """The same with a material that is not opaque."""
    first, *others = tracer.scene.materials
    changed = dataclasses.replace(first, opacity=0.25)
    return _again_of(tracer, tracer.scene.replace(materials=[changed, *others]))


def _again_of(tracer: rs.Tracer, scene: rs.Scene) -> rs.Tracer:
    return rs.Tracer(scene, device=tracer.device, precision=tracer.structure.precision)


def _query_file(tracer: rs.Tracer, path: Path) -> Any:
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(path / "rays.zarr", mode="w")
    for name, row in zip(("origins", "directions"), RAY, strict=True):
        group.create_array(name, data=np.tile(np.float32(row), (4, 1)))
    return rs.query_zarr(tracer, path / "rays.zarr", path / "hits.zarr")


def _saved(tracer: rs.Tracer, path: Path) -> None:
    tracer.save(path)
    is_whole = "shapes" not in tracer.structure.triangles.kinds
    for scene in (None, tracer.scene) if is_whole else (tracer.scene,):
        loaded = rs.Tracer.load(path, scene)
        found, wanted = (one.first_hit(*RAY, **_world(one)) for one in (loaded, tracer))
        assert found.t == wanted.t
        assert found.prim_id == wanted.prim_id


def _pack(tracer: rs.Tracer) -> Any:
    from raystream.cluster.tracer_bundles import pack_tracer

    return pack_tracer(tracer, "bvh", "cpu", {}, for_rendering=False)


def _world(tracer: rs.Tracer, name: str = "worlds") -> dict[str, Any]:
    placed = tracer.scene.placements
    return {} if placed is None or placed.worlds is None else {name: 0}


def _with_worlds(tracer: rs.Tracer) -> rs.Tracer:
    """The same in worlds, if it has instances."""
    return tracer if tracer.scene.placements is None else tracer_of("worlds")


def _instances(tracer: rs.Tracer) -> list[int] | None:
    return None if tracer.scene.placements is None else [0]


@pytest.mark.parametrize("kind", SAYS)
@pytest.mark.parametrize("feature", FEATURES)
def test_a_feature_works_or_names_what_it_does_not_support(
    feature: str, kind: str, tmp_path: Path
) -> None:
    check_feature(feature, kind, tracer_of(kind), tmp_path)


def check_feature(feature: str, kind: str, tracer: rs.Tracer, path: Path) -> None:
    run, named = FEATURES[feature]
    store = tracer.structure.triangles
    if all(is_supported(one, store) for one in _names(named)):
        run(tracer, path)
        return
    with pytest.raises((rs.RaystreamError, ValueError)) as caught:
        run(tracer, path)
    said = SAYS[kind] if named != "worlds" else "world"
    is_placed = kind == "worlds" or kind.startswith("placed")
    assert said in str(caught.value) or (is_placed and "instances" in str(caught.value))


def _names(named: str) -> list[str]:
    """The features of a call; names may have commas themselves."""
    found = [one for one in DECLARED if one == named or one in named]
    assert found, named
    return found


def test_every_row_of_the_table_is_tried() -> None:
    tried = {name for _, named in FEATURES.values() for name in _names(named)}
    elsewhere = {"device='cuda', machine='branching'", "raystream.torch", "raystream.jax"}
    assert {name for name, one in DECLARED.items() if one.row} <= tried | elsewhere


def test_picking_names_spheres() -> None:
    scene = rs.Scene.combine(
        [rs.load("cornell"), rs.Scene.spheres([[0, 0, 0]], 1.0), rs.Scene.height_field(np.eye(3))]
    )
    mesh_count = len(scene.meshes)
    assert scene.mesh_name(0) == scene.meshes[0].name
    assert [scene.mesh_name(mesh_count), scene.mesh_name(mesh_count + 1)] == [
        "height field",
        "spheres",
    ]


def test_lamps_light_spheres_beside_them() -> None:
    box = rs.load("cornell")
    ball = rs.Scene.spheres([[400, 350, 150]], 60.0)
    both = rs.Scene.combine([box, ball], camera=box.camera)
    assert len(both.area_lights) == len(box.area_lights) == 1
    plain = rs.render(box, "path", size=(16, 16), samples=256).pixels
    with_ball = rs.render(both, "path", size=(16, 16), samples=256).pixels
    # Few pixels see the ball: the others have nearly the light of the box alone.
    ratio = with_ball.mean(axis=(0, 1)) / plain.mean(axis=(0, 1))
    assert np.all((ratio > 0.8) & (ratio < 1.2))


def test_what_spheres_share_a_material_with_is_no_lamp() -> None:
    lamp = rs.Material(emission=(4.0, 4.0, 4.0))
    glow = rs.Scene.spheres([[0, 0, 0]], 1.0, materials=[lamp])
    assert glow.area_lights == []
    assert glow.primitive_materials == {0}
