"""Scenes with instances, spheres and height fields, and rays at them: hard ones by name."""

from __future__ import annotations

from typing import Any

import numpy as np

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from field_rays import PLACES, mesh_of, random_heights, rays_at
from instanced import moved, random_rotation, random_transforms
from meshes import cube, icosphere, soup
from sphere_rays import SETTINGS, some_rays

#: Rays of a case.
RAY_COUNT = 200

#: Columns of first hits, and of all hits.
FIRST = ("t", "u", "v", "prim_id", "instance_id", "mesh_id", "material_id", "status")
ROWS = ("ray_splits", "t", "u", "v", "prim_id", "instance_id", "mesh_id", "status")

SceneCase = tuple[rs.Scene, dict[str, Any]]


def _limits(count: int) -> dict[str, Any]:
    return {"t_min": np.zeros(count, np.float32), "t_max": np.full(count, np.inf, np.float32)}


def _objects() -> list[rs.Scene]:
    return [rs.Scene.from_arrays(*one) for one in (soup(60, 1), icosphere(1), cube())]


def _random_rays(rng: np.random.Generator, spread: float) -> dict[str, Any]:
    origins = rng.uniform(-spread, spread, (RAY_COUNT, 3))
    directions = rng.uniform(-spread, spread, (RAY_COUNT, 3)) / 2 - origins
    return {"origins": origins, "directions": directions, **_limits(RAY_COUNT)}


def mirrors_and_uneven_scales(rng: np.random.Generator) -> SceneCase:
    """Each instance twice, so that all hits are ties; and objects without triangles."""
    none = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    transforms = np.repeat(random_transforms(rng, 12, 4.0), 2, axis=0)
    ids = np.repeat(rng.integers(0, 4, 12), 2)
    return rs.Scene.instances([none, *_objects()], transforms, ids), _random_rays(rng, 5.0)


def _placed(name: str, rng: np.random.Generator) -> SceneCase:
    """A hard case of plain scenes, with the rays moved along."""
    case = CASES[name](rng)
    transforms = random_transforms(rng, 3, float(np.ptp(case.vertices, axis=0).max()))
    rows = rng.choice(len(case.origins), RAY_COUNT, replace=False)
    t_min, t_max = (limit[rows] for limit in case.limits())
    rays = {
        "origins": moved(transforms[1], case.origins[rows]),
        "directions": moved(transforms[1], case.directions[rows], is_point=False),
        "t_min": t_min,
        "t_max": t_max,
    }
    return rs.Scene.instances(case.scene, transforms), rays


def placed_edges(rng: np.random.Generator) -> SceneCase:
    return _placed("exact_edges_on_a_lattice", rng)


def placed_limits(rng: np.random.Generator) -> SceneCase:
    return _placed("limits_at_the_hits_themselves", rng)


def placed_origins_far_away(rng: np.random.Generator) -> SceneCase:
    return _placed("origins_far_away", rng)


def placed_directions_of_any_length(rng: np.random.Generator) -> SceneCase:
    return _placed("directions_of_any_length", rng)


def needles_and_plates(rng: np.random.Generator) -> SceneCase:
    transforms = np.zeros((12, 3, 4))
    for transform in transforms:
        scales = np.where(rng.random(3) < 0.5, 1.0, 1e-6)
        transform[:, :3] = random_rotation(rng) @ np.diag(scales) @ random_rotation(rng)
        transform[:, 3] = rng.uniform(-2.0, 2.0, 3)
    rays = _random_rays(rng, 3.0)
    chosen = transforms[rng.integers(0, 12, RAY_COUNT)]
    points = rng.uniform(-0.5, 0.5, (RAY_COUNT, 3))
    aims = np.einsum("kij,kj->ki", chosen[:, :, :3], points) + chosen[:, :, 3]
    return rs.Scene.instances(_objects()[2], transforms), {
        **rays,
        "directions": aims - rays["origins"],
    }


def worlds(rng: np.random.Generator) -> SceneCase:
    """Worlds of many instances, of one, and without any; and instances in all worlds."""
    transforms = random_transforms(rng, 40, 3.0)
    of_instances = rng.integers(-1, 6, 40)
    of_instances[of_instances == 3] = 4
    scene = rs.Scene.instances(_objects(), transforms, rng.integers(0, 3, 40), worlds=of_instances)
    of_rays = rng.integers(-1, scene.placements.world_count, RAY_COUNT)
    return scene, {**_random_rays(rng, 4.0), "worlds": of_rays}


def invalid_rays(rng: np.random.Generator) -> SceneCase:
    """Not numbers, without a direction, and too long to be moved to object space."""
    scene, rays = mirrors_and_uneven_scales(rng)
    rays["origins"][::5, 1], rays["directions"][1::5] = np.nan, 0.0
    rays["directions"][2::5] *= 1e200
    return scene, rays


def _spheres(name: str, rng: np.random.Generator) -> SceneCase:
    count, size, offset, radii, spread = SETTINGS[name]
    centers = rng.uniform(-size, size, (count, 3)) + offset
    radii = np.exp(rng.uniform(*np.log(radii), count))
    targets = rng.integers(0, count, RAY_COUNT)
    names = "origins", "directions", "t_min", "t_max"
    rays = some_rays(rng, centers, radii, targets, spread)
    return rs.Scene.spheres(centers, radii), dict(zip(names, rays, strict=True))


def spheres(rng: np.random.Generator) -> SceneCase:
    return _spheres("ordinary", rng)


def spheres_of_a_millimetre_far_away(rng: np.random.Generator) -> SceneCase:
    return _spheres("a millimetre, a million away", rng)


def spheres_far_from_origins(rng: np.random.Generator) -> SceneCase:
    return _spheres("origins far outside", rng)


def _field(name: str, rng: np.random.Generator) -> SceneCase:
    shape, missing, place = PLACES[name]
    heights = random_heights(rng, *shape, missing)
    rays = rays_at(rng, mesh_of(heights, **place), RAY_COUNT)
    return rs.Scene.height_field(heights, **place), rays


def field_with_holes(rng: np.random.Generator) -> SceneCase:
    return _field("holes", rng)


def field_with_falling_axes(rng: np.random.Generator) -> SceneCase:
    return _field("both ways down", rng)


def primitives_of_all_kinds(rng: np.random.Generator) -> SceneCase:
    """Two height fields, spheres, of which some are the same, and a mesh."""
    centers = np.repeat(rng.random((20, 3)) * 2, 2, axis=0)
    parts = [
        rs.Scene.height_field(rng.random((13, 10)), spacing=0.2),
        rs.Scene.spheres(centers, np.repeat(rng.uniform(0.01, 0.3, 20), 2)),
        rs.Scene.from_arrays(*soup(80, 3)),
        rs.Scene.height_field(rng.random((5, 22)), origin=(0, 0, 1), spacing=-0.2),
    ]
    return rs.Scene.combine(parts), _random_rays(rng, 3.0)


#: Scenes and rays by name.
SCENE_CASES = {
    made.__name__: made
    for made in (
        mirrors_and_uneven_scales,
        placed_edges,
        placed_limits,
        placed_origins_far_away,
        placed_directions_of_any_length,
        needles_and_plates,
        worlds,
        invalid_rays,
        spheres,
        spheres_of_a_millimetre_far_away,
        spheres_far_from_origins,
        field_with_holes,
        field_with_falling_axes,
        primitives_of_all_kinds,
    )
}


def some_of(rays: dict[str, Any], count: int) -> dict[str, Any]:
    """Some of the rays, spread over all of them."""
    rows = np.linspace(0, len(rays["origins"]) - 1, count).astype(int)
    return {name: np.ascontiguousarray(values[rows]) for name, values in rays.items()}


def assert_same(found: Any, expected: Any, columns: tuple[str, ...]) -> None:
    """Columns of hits have the same bits."""
    for column in columns:
        assert_same_bits(getattr(found, column), getattr(expected, column))


def assert_answers(tracer: rs.Tracer, oracle: rs.Tracer, rays, limits=(None, 0, 2)) -> int:
    """All queries have an oracle's bits, in both crossings modes; returns the number of hits."""
    first = oracle.first_hit(**rays)
    assert_same(tracer.first_hit(**rays), first, FIRST)
    assert_same_bits(tracer.any_hit(**rays), first.is_hit)
    for crossings in ("triangles", "surfaces"):
        for limit in limits:
            options = {"crossings": crossings, "max_hits": limit}
            many, expected = (one.multi_hit(**rays, **options) for one in (tracer, oracle))
            assert_same(many, expected, ROWS)
        counts = oracle.count_hits(**rays, crossings=crossings)
        assert_same_bits(tracer.count_hits(**rays, crossings=crossings), counts)
    return int(counts.sum())
