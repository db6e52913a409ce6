"""Every feature with every kind of scene: it works, or says by name what it does not support."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import raystream as rs
from raystream.stepper import walk

RAY = [278.0, 273.0, -800.0], [0.0, 0.0, 1.0]
POINTS = [[278.0, 273.0, -800.0], [278.0, 273.0, 100.0]]

#: What the refusals of each kind say.
SAYS = {
    "instances": "scene with instances",
    "worlds": "worlds",
    "spheres": "scene with spheres or height fields",
    "float64": "precision='float64'",
}


@cache
def tracer_of(kind: str, structure: str = "bvh", device: str = "cpu") -> rs.Tracer:
    box = rs.load("cornell")
    if kind == "float64":
        return rs.Tracer(box, structure, device, precision="float64")
    if kind == "spheres":
        ball = rs.Scene.spheres([[278, 273, 280]], 50.0)
        return rs.Tracer(rs.Scene.combine([box, ball], camera=box.camera), structure, device)
    worlds = [0, 0] if kind == "worlds" else None
    transforms = np.tile(np.eye(4)[:3], (2, 1, 1))
    transforms[1, 0, 3] = 2000.0
    scene = rs.Scene.instances([box], transforms, worlds=worlds, camera=box.camera)
    return rs.Tracer(scene, structure, device)


def keep(hit: Any, payload: Any) -> None:
    payload[0] += 1.0


def accept(hit: Any) -> bool:
    return True


#: A feature, and the kinds of scene that it refuses.
FEATURES: dict[str, tuple[Callable[[rs.Tracer], Any], str]] = {
    "first_hit": (lambda t: t.first_hit(*RAY, **_world(t)), ""),
    "any_hit": (lambda t: t.any_hit(*RAY, **_world(t)), ""),
    "multi_hit": (lambda t: t.multi_hit(*RAY, **_world(t)), ""),
    "count_hits": (lambda t: t.count_hits(*RAY, **_world(t)), ""),
    "surfaces": (lambda t: t.count_hits(*RAY, crossings="surfaces", **_world(t)), ""),
    "memory_needed": (lambda t: t.memory_needed(1000), ""),
    "update of the camera": (
        lambda t: t.update(t.scene.replace(camera=rs.Camera((0, 0, 0), (0, 0, 1)))),
        "",
    ),
    "filter": (lambda t: t.first_hit(*RAY, on_hit=accept, **_world(t)), ""),
    "skip": (lambda t: t.any_hit(*RAY, skip_prim_ids=0, **_world(t)), ""),
    "trace": (
        lambda t: t.trace(*RAY, on_hit=keep, payload=float, **_world(t)),
        "",
    ),
    "cast": (lambda t: t.cast(*RAY), "worlds"),
    "render": (lambda t: rs.render(t, "raycast", size=(8, 8)), "worlds float64"),
    "heat map": (lambda t: rs.heatmap(t.scene, size=(8, 8)), "worlds"),
    "closest_point": (
        lambda t: t.closest_point(POINTS),
        "instances worlds spheres float64",
    ),
    "signed_distance": (
        lambda t: t.signed_distance(POINTS),
        "instances worlds spheres float64",
    ),
    "contains": (lambda t: t.contains(POINTS), "instances worlds spheres float64"),
    "winding_number": (
        lambda t: t.winding_number(POINTS),
        "instances worlds spheres float64",
    ),
    "walk": (lambda t: walk(t, *RAY), "instances worlds spheres float64"),
    "thickness": (lambda t: rs.thickness(t, *RAY), "worlds spheres float64"),
    "lidar_returns": (lambda t: rs.lidar_returns(t, *RAY), "worlds float64"),
    "visibility": (lambda t: rs.visibility(t, POINTS), "worlds"),
    "visible_faces": (lambda t: rs.visible_faces(t, size=(8, 8)), "worlds spheres float64"),
    "view_factors": (
        lambda t: rs.view_factors(t, rays=64),
        "instances worlds spheres float64",
    ),
    "surface_points": (
        lambda t: rs.surface_points(t, [0], instance_ids=_instances(t)),
        "spheres float64",
    ),
}


def _world(tracer: rs.Tracer) -> dict[str, Any]:
    placed = tracer.scene.placements
    return {} if placed is None or placed.worlds is None else {"worlds": 0}


def _instances(tracer: rs.Tracer) -> list[int] | None:
    return None if tracer.scene.placements is None else [0]


@pytest.mark.parametrize("kind", SAYS)
@pytest.mark.parametrize("feature", FEATURES)
def test_a_feature_works_or_names_what_it_does_not_support(feature: str, kind: str) -> None:
    check_feature(feature, kind, tracer_of(kind))


def check_feature(feature: str, kind: str, tracer: rs.Tracer) -> None:
    run, refused = FEATURES[feature]
    if kind in refused.split():
        said = f"{SAYS[kind]}|instances" if kind == "worlds" else SAYS[kind]
        with pytest.raises((rs.RaystreamError, ValueError), match=said):
            run(tracer)
    else:
        run(tracer)


@pytest.mark.parametrize("kind", SAYS)
def test_saving_names_what_it_does_not_support(kind: str, tmp_path: Path) -> None:
    says = f"{SAYS[kind]}|instances" if kind == "worlds" else SAYS[kind]
    with pytest.raises(rs.RaystreamError, match=f"save.*({says})"):
        tracer_of(kind).save(tmp_path / "a.npz")


def test_clusters_name_what_they_do_not_support() -> None:
    from raystream.cluster.tracer_bundles import pack_tracer

    for kind in ("instances", "spheres", "float64"):
        with pytest.raises(rs.RaystreamError, match=f"cluster.*{SAYS[kind]}"):
            pack_tracer(tracer_of(kind), "bvh", "cpu", {}, for_rendering=False)


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
