"""Ray batches of awkward sizes, shapes, layouts and dtypes, each with a scene.

Each function returns vertices, faces, and the arguments of a query.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from meshes import dented_sphere, icosphere, soup

Batch = tuple[np.ndarray, np.ndarray, dict[str, Any]]


def _toward(shape, rng, dtype=np.float32):
    """Rays from around the unit cube into it."""
    origins = rng.normal(size=(*shape, 3)) * 1.5 + 0.5
    directions = rng.random((*shape, 3)) - origins
    return {"origins": origins.astype(dtype), "directions": directions.astype(dtype)}


def _picture(width, height):
    """Rays through the pixels of an image of the unit cube, origins one by one."""
    x, y = np.meshgrid(np.linspace(-0.2, 1.2, width), np.linspace(-0.2, 1.2, height))
    directions = np.stack([x - 0.4, y - 0.6, np.full_like(x, 3.0)], axis=-1).astype(np.float32)
    origins = np.broadcast_to(np.array([0.4, 0.6, -3.0], np.float32), directions.shape).copy()
    return {"origins": origins, "directions": directions}


def one_ray(rng):
    return *soup(300, 1), _toward((), rng)


def one_ray_in_a_row(rng):
    return *soup(300, 1), _toward((1,), rng)


def seven_rays(rng):
    return *soup(300, 1), _toward((7,), rng)


def equal_rays(rng):
    one = {"origins": [0.5, 0.4, -3.0], "directions": [0.01, 0.02, 1.0]}
    return *soup(300, 1), {k: np.tile(np.float32(v), (600, 1)) for k, v in one.items()}


def octants_mixed_ray_by_ray(rng):
    directions = rng.uniform(0.05, 1, (3000, 3)) * rng.choice([-1, 1], (3000, 3))
    origins = rng.random((3000, 3))
    return *soup(300, 1), {"origins": np.float32(origins), "directions": np.float32(directions)}


def octants_and_axes_mixed_at_right_angles(rng):
    directions = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 70, axis=0)[rng.permutation(420)]
    return *soup(300, 1), {"origins": np.float32(rng.random((420, 3))), "directions": directions}


def rays_from_inside(rng):
    vertices, faces = dented_sphere(3)
    directions = rng.normal(size=(2500, 3)).astype(np.float32)
    return vertices, faces, {"origins": np.float32([0.3, -2.0, 1.1]), "directions": directions}


def picture_of_odd_size(rng):
    return *soup(300, 1), _picture(37, 53)


def picture_narrower_than_a_tile(rng):
    return *soup(300, 1), _picture(3, 90)


def picture_of_one_row(rng):
    return *soup(300, 1), {name: rays[:1] for name, rays in _picture(250, 2).items()}


def pictures_in_a_row(rng):
    parts = [_picture(17, 18) for _ in range(3)]
    return *soup(300, 1), {name: np.stack([p[name] for p in parts]) for name in parts[0]}


def picture_from_one_point_in_float64(rng):
    rays = _picture(33, 40)
    eye = np.array([0.4, 0.6, -3.0]) + 1e-9
    return *soup(300, 1), {**rays, "origins": np.broadcast_to(eye, rays["directions"].shape)}


def picture_turned_over(rng):
    rays = _picture(33, 40)
    return *soup(300, 1), {name: a[::-1, ::-1] for name, a in rays.items()}


def picture_transposed(rng):
    return *soup(300, 1), {name: a.transpose(1, 0, 2) for name, a in _picture(33, 40).items()}


def parallel_rays(rng):
    """One direction for all, origins in an image."""
    x, y = np.meshgrid(np.linspace(-0.2, 1.2, 40), np.linspace(-0.2, 1.2, 21))
    origins = np.stack([x, y, np.full_like(x, -3.0)], axis=-1).astype(np.float32)
    return *soup(300, 1), {"origins": origins, "directions": np.float32([0, 0, 2])}


def every_other_row_of_a_wider_array(rng):
    table = np.zeros((2400, 8), np.float32)
    rays = _toward((2400,), rng)
    table[:, :3], table[:, 5:] = rays["origins"], rays["directions"]
    table = table[::2]
    return *soup(300, 1), {"origins": table[:, :3], "directions": table[:, 5:]}


def components_not_adjacent(rng):
    rays = _toward((1500,), rng)
    return *soup(300, 1), {name: np.asfortranarray(a) for name, a in rays.items()}


def unaligned(rng):
    table = np.zeros(1200, np.dtype([("pad", "u1"), ("o", "f4", 3), ("d", "f4", 3)]))
    rays = _toward((1200,), rng)
    table["o"], table["d"] = rays["origins"], rays["directions"]
    return *soup(300, 1), {"origins": table["o"], "directions": table["d"]}


def backward(rng):
    return *soup(300, 1), {name: a[::-1] for name, a in _toward((1300,), rng).items()}


def float64_numbers(rng):
    return *soup(300, 1), _toward((1300,), rng, np.float64)


def float64_directions_alone(rng):
    rays = _toward((1300,), rng, np.float64)
    return *soup(300, 1), {**rays, "origins": rays["origins"].astype(np.float32)}


def float64_far_and_near_mixed(rng):
    rays = _toward((1300,), rng, np.float64)
    rays["origins"][::5] -= 1e4 * rays["directions"][::5]
    rays["directions"][1::7] *= 10.0 ** rng.uniform(-70, 70, (len(rays["directions"][1::7]), 1))
    return *soup(300, 1), rays


def float64_far_from_the_origin(rng):
    vertices, faces = soup(300, 1)
    rays = _toward((1300,), rng, np.float64)
    far = np.array([1e6, -3e5, 77.0])
    return vertices + far, faces, {**rays, "origins": rays["origins"] + far}


def limits_of_every_kind(rng):
    rays = _toward((40, 30), rng)
    t_min = rng.uniform(-1.5, 0.5, (40, 30)).astype(np.float32)
    return *soup(300, 1), {**rays, "t_min": t_min, "t_max": rng.uniform(0, 2, 30)}


def negative_and_infinite_limits(rng):
    rays = _toward((1200,), rng)
    t_min = rng.choice([-np.inf, -1.0, 0.0, 0.3, np.inf], 1200)
    return *soup(300, 1), {**rays, "t_min": t_min, "t_max": rng.choice([np.inf, 1, 0.7, -1], 1200)}


def invalid_rays_mixed_in(rng):
    rays = _picture(40, 35)
    for array in rays.values():
        bad = rng.random(array.shape) < 0.02
        array[bad] = rng.choice([np.nan, np.inf, -np.inf], np.count_nonzero(bad))
    rays["directions"][::9, ::7] = 0.0
    t_max = np.where(rng.random((35, 40)) < 0.03, np.nan, 9.0)
    return *soup(300, 1), {**rays, "t_max": t_max}


def nothing_but_invalid_rays(rng):
    return *soup(30, 1), {"origins": np.zeros((300, 3)), "directions": np.full((300, 3), np.nan)}


def edges_of_a_sphere_as_a_picture(rng):
    vertices, faces = icosphere(3)
    corners = np.float32(vertices)[faces]
    targets = (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2
    targets = targets[: 48 * 80].reshape(48, 80, 3)
    origins = np.float32([0.1, 0.2, 3.0])
    return vertices, faces, {"origins": origins, "directions": targets - origins}


BATCHES: dict[str, Callable[[np.random.Generator], Batch]] = {
    make.__name__: make
    for make in (
        one_ray,
        one_ray_in_a_row,
        seven_rays,
        equal_rays,
        octants_mixed_ray_by_ray,
        octants_and_axes_mixed_at_right_angles,
        rays_from_inside,
        picture_of_odd_size,
        picture_narrower_than_a_tile,
        picture_of_one_row,
        pictures_in_a_row,
        picture_from_one_point_in_float64,
        picture_turned_over,
        picture_transposed,
        parallel_rays,
        every_other_row_of_a_wider_array,
        components_not_adjacent,
        unaligned,
        backward,
        float64_numbers,
        float64_directions_alone,
        float64_far_and_near_mixed,
        float64_far_from_the_origin,
        limits_of_every_kind,
        negative_and_infinite_limits,
        invalid_rays_mixed_in,
        nothing_but_invalid_rays,
        edges_of_a_sphere_as_a_picture,
    )
}
