"""Path tracing against results computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import cube, icosphere
from z_test import assert_at_most, assert_mean

WHITE = (1.0, 1.0, 1.0)
NONE = (0.0, 0.0, 0.0)
SKY = rs.EnvironmentLight(WHITE)

#: A floor at y = 0, and a camera that sees just the point of it that light is measured at.
FLOOR = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9.0]])
UPWARD = [[0, 2, 1], [0, 3, 2]]
PLACE = np.array([0.3, 0.0, -0.2])
AIMED = rs.Camera(PLACE + [-2, 1.5, 0.4], PLACE, fov=1e-3)


def path(scene, samples=16, size=(32, 32), **options):
    """An image of independent numbers, so that the estimated variance is right."""
    options = {"sampler": "random", "seed": 7, **options}
    return rs.render(scene, "path", size, samples, **options)


# Furnaces


def furnace(shape, material):
    vertices, faces = shape
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    camera = rs.Camera(middle + [0.1, 0.05, -0.1], middle + [1, 0.7, 0.4], fov=90)
    inward = rs.Mesh(vertices, faces[:, ::-1])
    return rs.Scene([inward], materials=[material], camera=camera)


WALLS = {
    "matte": rs.Material(diffuse=(0.5, 0.8, 0.0), emission=(1.0, 0.25, 2.0)),
    "half mirror": rs.Material(
        diffuse=(0.2, 0.4, 0.0), reflection=(0.3, 0.4, 0.0), emission=(1.0, 0.25, 2.0)
    ),
}


@pytest.mark.parametrize("light_samples", [True, False])
@pytest.mark.parametrize("shape", [cube(), icosphere(1)], ids=["cube", "sphere"])
@pytest.mark.parametrize("walls", WALLS)
def test_a_furnace_glows_evenly(walls, shape, light_samples):
    """Walls that emit E and reflect rho: E (1 + rho + rho^2 + ...), a term for each bounce."""
    emitted, kept = np.array([1.0, 0.25, 2.0]), np.array([0.5, 0.8, 0.0])
    scene = furnace(shape, WALLS[walls])
    for bounces in range(4):
        image = path(scene, 4, max_bounces=bounces, light_samples=light_samples)
        assert_mean(image, emitted * sum(kept**k for k in range(bounces + 1)))
    image = path(scene, max_bounces=1000, light_samples=light_samples)
    assert_mean(image, emitted / (1.0 - kept))


def test_rays_that_meet_a_furnace_from_outside_see_it_dark():
    vertices, faces = icosphere(1)
    mesh = rs.Mesh(vertices, faces[:, ::-1])
    camera = rs.Camera((0, 0, 3), (0, 0, 0), fov=10)
    scene = rs.Scene([mesh], materials=[WALLS["matte"]], camera=camera)
    assert not path(scene, 8, lights="file").pixels.any()


LOSSLESS = {
    "matte": {"diffuse": WHITE},
    "mirror": {"diffuse": NONE, "reflection": WHITE},
    "glass": {"diffuse": NONE, "transmission": WHITE, "ior": 1.5},
    "air in water": {"diffuse": NONE, "transmission": WHITE, "ior": 0.75},
    "thin": {"diffuse": NONE, "transmission": WHITE},
    "all of them": {
        "diffuse": (0.5, 0.1, 0.2),
        "reflection": (0.25, 0.1, 0.5),
        "transmission": (0.25, 0.8, 0.3),
        "ior": 1.5,
    },
    "too much": {"diffuse": WHITE, "reflection": WHITE},
}

GLOSSY = {
    "dull": {"diffuse": NONE, "specular": WHITE, "shininess": 2.0},
    "sharp": {"diffuse": NONE, "specular": WHITE, "shininess": 500.0},
    "metal": {"diffuse": WHITE, "roughness": 0.4, "metallic": 1.0},
    "plastic": {"diffuse": WHITE, "roughness": 0.2, "metallic": 0.0},
    "varnish": {"diffuse": (0.5, 0.5, 0.5), "specular": (0.5, 0.5, 0.5), "shininess": 20.0},
    "all of them": {
        "diffuse": (0.25, 0.25, 0.25),
        "specular": (0.25, 0.5, 0.25),
        "reflection": (0.25, 0.0, 0.25),
        "transmission": (0.25, 0.25, 0.25),
        "shininess": 50.0,
        "ior": 1.5,
    },
}


def under_the_sky(material, normals=None):
    """The middle of a ball of flat facets, which rays leave by chance on many ways."""
    vertices, faces = icosphere(1)
    mesh = rs.Mesh(vertices, faces, normals=vertices if normals else None)
    camera = rs.Camera((0.2, 0.5, 3), (0, 0, 0), fov=25)
    return rs.Scene([mesh], materials=[rs.Material(**material)], lights=[SKY], camera=camera)


@pytest.mark.parametrize("light_samples", [True, False])
@pytest.mark.parametrize("kind", LOSSLESS)
def test_what_loses_no_light_cannot_be_seen_under_a_white_sky(kind, light_samples):
    scene = under_the_sky(LOSSLESS[kind])
    assert_mean(path(scene, max_bounces=1000, light_samples=light_samples), 1.0)


@pytest.mark.parametrize("kind", GLOSSY)
def test_glossy_surfaces_make_no_light(kind):
    image = path(under_the_sky(GLOSSY[kind]), max_bounces=1000)
    assert_at_most(image, 1.0)
    assert image.pixels.mean() > 0.5


@pytest.mark.parametrize("kind", [*LOSSLESS, "varnish"])
def test_smooth_normals_make_no_light(kind):
    material = {**LOSSLESS, **GLOSSY}[kind]
    image = path(under_the_sky(material, normals=True), max_bounces=1000)
    assert_at_most(image, 1.0)
    assert image.pixels.mean() > 0.5


@pytest.mark.parametrize("shininess", [1.0, 3.5, 100.0, 1e4])
def test_gloss_seen_from_straight_ahead_loses_nothing(shininess):
    """The lobe (n + 2) / (2 pi) cos^(n + 1) about the normal adds up to 1."""
    material = rs.Material(diffuse=(0.5, 0, 0.25), specular=(0.5, 1, 0), shininess=shininess)
    camera = rs.Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), 1e-3)
    scene = rs.Scene([rs.Mesh(FLOOR, UPWARD)], materials=[material], lights=[SKY], camera=camera)
    for light_samples in (True, False):
        image = path(scene, 64, max_bounces=1, light_samples=light_samples)
        assert_mean(image, (1.0, 1.0, 0.25))


# Direct light on a matte floor


ALBEDO = np.array([0.5, 0.25, 1.0])


def on_the_floor(lights=(), lamps=()):
    """The floor's point, lit by lights and by meshes of material 1, which emits 3, 2, 1."""
    meshes = [rs.Mesh(FLOOR, UPWARD)]
    meshes += [rs.Mesh(vertices, faces, material_ids=1) for vertices, faces in lamps]
    materials = [rs.Material(diffuse=ALBEDO), rs.Material(diffuse=NONE, emission=(3, 2, 1))]
    return rs.Scene(meshes, materials=materials, lights=lights, camera=AIMED)


def irradiance_below(polygons):
    """Irradiance of the floor's point from polygons of radiance 1, by Lambert's formula.

    Half the sum, over the edges as they are seen, of angle times cosine between the floor's
    normal and that of the plane through the point and the edge; polygons that show their back
    count nothing.
    """
    total = 0.0
    for polygon in np.asarray(polygons, np.float64):
        corners = polygon - PLACE
        if np.linalg.det(corners[:3]) >= 0:  # seen from behind
            continue
        unit = corners / np.linalg.norm(corners, axis=1, keepdims=True)
        following = np.roll(unit, -1, axis=0)
        across = np.cross(following, unit)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        angles = np.arccos((unit * following).sum(axis=1))
        total += float(angles @ across[:, 1]) / 2
    return total


RECTANGLE = np.array([[-0.5, 2, -1], [0.8, 2, -1], [0.8, 1.5, 0.6], [-0.5, 1.5, 0.6]])
DOWNWARD = [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("light_samples", [True, False])
def test_a_rectangle_lights_the_floor_as_lambert_says(light_samples):
    image = path(
        on_the_floor(lamps=[(RECTANGLE, DOWNWARD)]),
        64,
        max_bounces=1,
        light_samples=light_samples,
    )
    assert_mean(image, ALBEDO / math.pi * np.array([3, 2, 1]) * irradiance_below([RECTANGLE]))


def test_lamberts_formula_gives_the_textbook_square():
    """A unit square centred at distance 1: each quarter sees a corner's configuration factor."""
    square = PLACE + np.array([[-0.5, 1, -0.5], [0.5, 1, -0.5], [0.5, 1, 0.5], [-0.5, 1, 0.5]])
    expected = 4 * math.atan(1 / math.sqrt(5)) / math.sqrt(5)
    assert irradiance_below([square]) == pytest.approx(expected)


@pytest.mark.parametrize("light_samples", [True, False])
def test_a_ball_lights_the_floor_below_it(light_samples):
    """pi (R / d)^2; a ball of triangles by Lambert's formula, and close to that."""
    vertices, faces = icosphere(3)
    radius, distance = 0.7, 1.5
    vertices = vertices * radius + PLACE + [0, distance, 0]
    expected = irradiance_below(vertices[faces])
    assert expected == pytest.approx(math.pi * (radius / distance) ** 2, rel=0.02)
    scene = on_the_floor(lamps=[(vertices, faces)])
    image = path(scene, 64, max_bounces=1, light_samples=light_samples)
    assert_mean(image, ALBEDO / math.pi * np.array([3, 2, 1]) * expected)


def received_from(light):
    """Irradiance of the floor's point from an unblocked light, in closed form."""
    if isinstance(light, rs.EnvironmentLight):
        return math.pi * np.array(light.radiance)
    if isinstance(light, rs.DirectionalLight):
        direction = np.array(light.direction)
        return np.array(light.irradiance) * -direction[1] / np.linalg.norm(direction)
    toward = np.array(light.position) - PLACE
    distance = np.linalg.norm(toward)
    facing = np.array(light.intensity) * toward[1] / distance
    if isinstance(light, rs.SpotLight):
        return facing / distance**2 * faded(light, -toward / distance)
    return facing / distance**2 if light.falloff == "inverse_square" else facing * math.pi


def faded(light, direction):
    """The factor that the code of ``KHR_lights_punctual`` gives."""
    inner, outer = (math.cos(math.radians(a)) for a in (light.inner_angle, light.outer_angle))
    axis = np.array(light.direction) / np.linalg.norm(light.direction)
    return min(max((axis @ direction - outer) / max(0.001, inner - outer), 0), 1) ** 2


LIGHTS = {
    "point": [rs.PointLight((1, 2, 0.5), (3, 2, 1))],
    "point without falloff": [rs.PointLight((1, 2, 0.5), (3, 2, 1), falloff="none")],
    "spot": [rs.SpotLight((1, 2, 0.5), (-1, -3, 0), (9, 6, 3), 5, 60)],
    "inside a spot": [rs.SpotLight((1, 2, 0.5), (-3, -6, -1.5), (9, 6, 3), 40, 40.01)],
    "sun": [rs.DirectionalLight((1, -3, 0.5), (3, 2, 1))],
    "sky": [rs.EnvironmentLight((3, 2, 1))],
    "two suns": [
        rs.DirectionalLight((1, -3, 0.5), (3, 2, 1)),
        rs.DirectionalLight((0, -1, -2), (0, 0.1, 5)),
    ],
}


@pytest.mark.parametrize("kind", LIGHTS)
def test_lights_light_the_floor(kind):
    lights = LIGHTS[kind]
    image = path(on_the_floor(lights), max_bounces=1)
    assert_mean(image, ALBEDO / math.pi * sum(map(received_from, lights)))


@pytest.mark.parametrize("light_samples", [True, False])
def test_a_rectangle_and_the_sky_that_it_hides_add_up(light_samples):
    scene = on_the_floor([SKY], [(RECTANGLE, DOWNWARD)])
    received = math.pi + irradiance_below([RECTANGLE]) * np.array([2, 1, 0])
    image = path(scene, 64, max_bounces=1, light_samples=light_samples)
    assert_mean(image, ALBEDO / math.pi * received)


def test_nothing_outside_a_spot():
    toward = PLACE - np.array([1, 2, 0.5])
    assert 0.1 < faded(LIGHTS["spot"][0], toward / np.linalg.norm(toward)) < 0.9
    light = rs.SpotLight((1, 2, 0.5), (1, -0.1, 0), (9, 9, 9), 10, 20)
    assert not path(on_the_floor([light]), 4, lights="file").pixels.any()


def test_all_lights_together_add_up():
    """The rectangle hides sky, and nothing else."""
    others = [light for kind in LIGHTS if kind != "sky" for light in LIGHTS[kind]]
    lights = [*others, SKY]
    lamp = RECTANGLE - [3, 0, 0]
    received = sum(map(received_from, lights)) + irradiance_below([lamp]) * np.array([2, 1, 0])
    image = path(on_the_floor(lights, [(lamp, DOWNWARD)]), 64, max_bounces=1)
    assert_mean(image, ALBEDO / math.pi * received)


def test_lights_that_take_light_away_are_sampled_too():
    """Two that reach the floor, and one that a screen keeps off."""
    lights = [
        rs.DirectionalLight((1, -3, 0.5), (3, 2, 1)),
        rs.DirectionalLight((0, -1, 0), (-1, -2, -0.5)),
        rs.PointLight((1, 2, 0.5), (1, -2, 1)),
        rs.DirectionalLight((-1, -1, 0), (-2, -1, -1)),
    ]
    screen = np.array([[1, 0.5, -1], [1, 0.5, 0.5], [1, 1.5, 0.5], [1, 1.5, -1]])
    scene = on_the_floor(lights)
    hidden = rs.Mesh(screen, DOWNWARD)
    scene = rs.Scene(
        [*scene.meshes, hidden], materials=scene.materials, lights=lights, camera=AIMED
    )
    received = sum(map(received_from, lights[:3]))
    assert_mean(path(scene, 64, max_bounces=1), ALBEDO / math.pi * received)


def test_light_from_below_does_not_reach_the_floor():
    lights = [rs.PointLight((0, -1, 0), (9, 9, 9)), rs.DirectionalLight((0, 1, 0), (9, 9, 9))]
    lamp = RECTANGLE - [0, 4, 0], [[2, 1, 0], [3, 2, 0]]
    assert not path(on_the_floor(lights, [lamp]), 4, lights="file").pixels.any()


def test_a_clamp_bounds_what_comes_over_further_surfaces():
    """Inside a furnace all light after the first surface's is the same for every sample."""
    scene = furnace(cube(), rs.Material(diffuse=WHITE, emission=WHITE))
    for bounces in range(4):
        image = path(scene, 4, max_bounces=bounces, light_samples=False, clamp=0.25)
        # Emission seen, and found by the next ray; then 0.25 for each bounce.
        assert_mean(image, min(bounces + 1, 2) + 0.25 * max(bounces - 1, 0))


def test_a_clamp_leaves_direct_light_and_hues():
    """The floor's point is lit by the sun, and by a wall that it lights; that is clamped."""
    sun = [rs.DirectionalLight((1, -3, 0), (3, 2, 1))]
    direct = ALBEDO / math.pi * received_from(sun[0])
    floor = on_the_floor(sun)
    wall = rs.Mesh([[1.5, 0, -3], [1.5, 0, 3], [1.5, 3, 3], [1.5, 3, -3.0]], DOWNWARD)
    scene = rs.Scene([*floor.meshes, wall], materials=floor.materials, lights=sun, camera=AIMED)
    options = {"max_bounces": 2, "size": (16, 16)}
    free = path(scene, 16, clamp=math.inf, **options)
    assert_same_bits(free.pixels, path(scene, 16, **options).pixels)
    clamped = path(scene, 16, clamp=0.01, **options)
    added = clamped.pixels.mean(axis=(0, 1)) - direct
    assert 0.0 < added.max() <= 0.01
    assert free.pixels.mean(axis=(0, 1)).max() > direct.max() + 0.02
    # The hue of light that went over two surfaces: sun, floor and wall.
    hue = ALBEDO**2 * (3, 2, 1)
    np.testing.assert_allclose(added / added.max(), hue / hue.max(), rtol=1e-3)
