"""Images of scenes with instances are those of their flattened copies."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from instanced import random_rotation, random_transforms
from meshes import cube, icosphere
from raystream.rendering.lighting import area_patches
from raystream.rendering.sample_file import _digest

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")
SIZE = (64, 48)


def textured_cube() -> rs.Scene:
    """With colours, normals, and a normal map on a part of its faces."""
    vertices, faces = cube()
    rng = np.random.default_rng(3)
    bumps = np.clip(rng.normal((128, 128, 220), 30.0, (16, 16, 3)), 0, 255).astype(np.uint8)
    colors = rng.integers(60, 255, (16, 16, 3)).astype(np.uint8)
    textures = {"diffuse": rs.Texture(colors), "normal": rs.Texture(bumps)}
    mesh = rs.Mesh(
        vertices,
        faces,
        normals=vertices - vertices.mean(axis=0),
        texcoords=rng.uniform(0.0, 2.0, (len(vertices), 2)),
        colors=rng.uniform(0.5, 1.0, (len(vertices), 3)),
        material_ids=np.arange(len(faces)) % 2,
    )
    materials = [rs.Material(textures=textures), rs.Material(reflection=(0.5, 0.5, 0.5))]
    return rs.Scene([mesh], materials=materials)


@pytest.fixture(scope="module")
def scenes() -> tuple[rs.Scene, rs.Scene]:
    """A scene with instances, some of them mirrored and sheared, and its flattened copy."""
    rng = np.random.default_rng(4)
    ball = rs.Scene(
        [rs.Mesh(*icosphere(2))],
        materials=[rs.Material(diffuse=(0.1, 0.6, 0.2), specular=(0.3, 0.3, 0.3))],
    )
    transforms = random_transforms(rng, 24, 4.0)
    for k in range(0, 24, 2):  # cubes: shear would turn what tangents are averaged to
        transforms[k, :, :3] = random_rotation(rng) @ np.diag([1.5, 1.5, rng.choice([-1.5, 1.5])])
    transforms[-1] = np.eye(3, 4) * 30.0
    transforms[-1, :, 3] = (-15.0, -40.0, -15.0)  # the ground
    scene = rs.Scene.instances(
        [textured_cube(), ball],
        transforms,
        [*(np.arange(23) % 2), 0],
        lights=[rs.DirectionalLight((0.3, -1.0, -0.5), (2.0, 2.0, 2.0)), rs.PointLight((0, 9, 9))],
        background=(0.3, 0.4, 0.5),
        camera=rs.Camera((3.0, 9.0, 16.0), (0.0, 0.0, 0.0), fov=45),
    )
    return scene, scene.flattened()


@pytest.mark.parametrize("mode", MODES)
def test_images_are_those_of_copies(scenes, mode) -> None:
    """All but pixels at edges, where rays meet another triangle by rounding."""
    # The default is a share of the bounds, which are those of the objects' boxes with instances.
    options = {"distance": 2.0} if mode == "ao" else {}
    images = [rs.render(one, mode, SIZE, samples=2, seed=1, **options) for one in scenes]
    placed, flat = (image.pixels for image in images)
    differs = (np.abs(placed - flat) > 2e-4 + 1e-3 * np.abs(flat)).any(axis=2)
    assert np.count_nonzero(differs) <= 0.01 * differs.size
    assert np.ptp(placed) > 0.2


def test_layers_name_the_triangles_of_objects(scenes) -> None:
    scene, _ = scenes
    layers = ("prim_id", "normal", "albedo", "depth")
    placed, copied = (rs.render(one, size=SIZE, samples=1, layers=layers) for one in scenes)
    hits = rs.Tracer(scene).first_hit(*scene.camera.rays(*SIZE))
    numbers = placed.layers["prim_id"]
    assert numbers.max() < scene.triangle_count
    assert np.count_nonzero(numbers.reshape(SIZE[::-1]) != hits.prim_id) < 0.15 * numbers.size
    for name in ("normal", "albedo", "depth"):
        a, b = placed.layers[name], copied.layers[name]
        close = np.isclose(a, b, rtol=1e-3, atol=1e-3) | (a == b)
        assert np.count_nonzero(~close) <= 0.01 * close.size


def test_checkpoints_know_where_instances_are(scenes) -> None:
    scene, _ = scenes
    elsewhere = scene.with_transforms(scene.placements.transforms + [0.0, 0.0, 0.0, 1e-6])
    assert _digest(scene) == _digest(scene.replace(name="other"))
    assert _digest(scene) != _digest(elsewhere)


def test_a_camera_is_chosen(scenes) -> None:
    scene, flat = scenes
    chosen = scene.replace(camera=None)
    assert not chosen.has_own_camera
    hits = rs.Tracer(chosen).first_hit(*chosen.camera.rays(*SIZE))
    assert hits.is_hit.mean() > 0.2
    assert chosen.camera.eye == pytest.approx(flat.replace(camera=None).camera.eye, rel=1e-3)


def test_frames_move_instances(scenes) -> None:
    scene, _ = scenes
    shift = np.zeros((24, 3, 4))
    shift[:23, 1, 3] = 2.0
    moved = scene.with_transforms(scene.placements.transforms + shift)
    tracer = rs.Tracer(scene)
    before = rs.render(tracer, "vis", SIZE).pixels
    tracer.update(moved)
    after = rs.render(tracer, "vis", SIZE).pixels
    assert (before != after).any()
    np.testing.assert_array_equal(after, rs.render(moved, "vis", SIZE).pixels)


def test_animations_move_instances(scenes, tmp_path) -> None:
    scene, _ = scenes
    transforms = scene.placements.transforms
    shift = np.zeros((24, 3, 4))
    shift[:23, 1, 3] = 1.0
    moving = rs.Animation(lambda t: scene.with_transforms(transforms + t * shift), (0.0, 2.0), 1.0)
    animated = scene.replace(animation=moving)
    np.testing.assert_array_equal(animated.at(2.0).placements.transforms, transforms + 2.0 * shift)
    frames = list(rs.render_frames(animated, "vis", size=SIZE))
    assert len(frames) == 2
    last = rs.render(scene.with_transforms(transforms + shift), "vis", SIZE)
    np.testing.assert_array_equal(frames[-1][1].pixels, last.pixels)


def leaves(opacity: float, cutoff: float | None) -> rs.Scene:
    """Squares with holes in a chequered texture, some of them mirrored and sheared."""
    square = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    holes = np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.ones((8, 8))).astype(np.uint8) * 255
    material = rs.Material(
        diffuse=(0.2, 0.7, 0.3),
        opacity=opacity,
        alpha_cutoff=cutoff,
        textures={"opacity": rs.Texture(holes[:, :, None])} if cutoff else {},
    )
    mesh = rs.Mesh(square, [[0, 1, 2], [0, 2, 3]], texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]])
    transforms = random_transforms(np.random.default_rng(6), 30, 3.0)
    return rs.Scene.instances(
        rs.Scene([mesh], materials=[material]),
        transforms,
        lights=[rs.DirectionalLight((0.3, -1.0, -0.5), (2.0, 2.0, 2.0))],
        background=(0.3, 0.4, 0.5),
        camera=rs.Camera((0.0, 2.0, 12.0), (0.0, 0.0, 0.0), fov=45),
    )


@pytest.mark.ci
@pytest.mark.parametrize("mode", ["raycast", "shadow", "whitted", "ao", "path"])
def test_cut_outs_are_those_of_copies(mode) -> None:
    scene = leaves(1.0, 0.5)
    options = {"distance": 2.0} if mode == "ao" else {}
    placed, flat = (
        rs.render(one, mode, SIZE, samples=2, seed=1, **options).pixels
        for one in (scene, scene.flattened())
    )
    differs = (np.abs(placed - flat) > 2e-4 + 1e-3 * np.abs(flat)).any(axis=2)
    assert np.count_nonzero(differs) <= 0.02 * differs.size
    opaque = scene.replace(materials=[rs.Material(diffuse=(0.2, 0.7, 0.3))])
    solid = rs.render(opaque, mode, SIZE, samples=2, seed=1, **options).pixels
    assert np.abs(placed - solid).mean() > 10.0 * np.abs(placed - flat).mean()


@pytest.mark.ci
def test_copies_of_a_sheet_let_light_through_on_their_own() -> None:
    """Ten half-transparent sheets one behind another leave 2**-10, not a half, of the light."""
    square = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    mesh = rs.Mesh(square, [[0, 1, 2], [0, 2, 3]])
    places = np.tile(np.eye(3, 4), (10, 1, 1))
    places[:, 2, 3] = np.arange(10.0)
    black = rs.Material(diffuse=(0.0, 0.0, 0.0), opacity=0.5)
    camera = rs.Camera((0.0, 0.0, 60.0), (0.0, 0.0, 0.0), fov=1.0)
    for count in (1, 2, 10):
        scene = rs.Scene.instances(
            rs.Scene([mesh], materials=[black]),
            places[:count],
            background=(1.0, 1.0, 1.0),
            camera=camera,
        )
        light = rs.render(scene, "path", (32, 32), samples=64, seed=3).pixels.mean()
        share = 0.5**count
        error = 4.0 * np.sqrt(share * (1.0 - share) / (32 * 32 * 64))
        assert light == pytest.approx(share, abs=error)


def test_rays_leave_objects_far_from_their_origin() -> None:
    """Coordinates in object space may be much larger than in the scene."""
    rng = np.random.default_rng(8)
    lines = np.linspace(0.0, 1000.0, 41)
    x, z = np.meshgrid(lines, lines, indexing="ij")
    y = 1500.0 + 20.0 * np.sin(x / 70.0) * np.cos(z / 50.0)
    corners = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    at = (np.arange(40)[:, None] * 41 + np.arange(40)).reshape(-1, 1)
    faces = np.concatenate([at + [0, 1, 41], at + [1, 42, 41]])
    shift = np.eye(3, 4)
    shift[:, 3] = (-500.0, -1500.0, -500.0)
    turned = shift.copy()
    turned[:, :3] = random_rotation(rng)
    turned[:, 3] = -turned[:, :3] @ [500.0, 1500.0, 500.0]
    for transform in (shift, turned):
        scene = rs.Scene.instances(rs.Mesh(corners, faces), [transform])
        up = transform[:, :3] @ [0.0, 1.0, 0.0]
        for away in (4.0, 400.0):
            eye = transform[:, :3] @ [500.0, 1520.0 + away, 500.0] + transform[:, 3]
            camera = rs.Camera(tuple(eye), tuple(eye - up), up=tuple(transform[:, :3] @ [1, 0, 0]))
            tracer = rs.Tracer(scene)
            image = rs.render(tracer, "ao", (32, 32), samples=1, camera=camera, distance=0.01)
            # No surface is within a centimetre of another: nothing occludes.
            assert image.pixels.mean() == pytest.approx(1.0, abs=1e-3)


@pytest.fixture(scope="module")
def lamps() -> rs.Scene:
    """A box that is lit by the instances of one lamp: uneven in scale, and some mirrored."""
    box = rs.load("cornell")
    grey = rs.Material(diffuse=(0.7, 0.7, 0.7))
    materials = [grey if any(one.emission) else one for one in box.materials]
    pane = [[-30.0, 0.0, -30.0], [30.0, 0.0, -30.0], [30.0, 0.0, 30.0], [-30.0, 0.0, 30.0]]
    lamp = rs.Scene(
        [rs.Mesh(pane, [[0, 1, 2], [0, 2, 3]])],
        materials=[rs.Material(emission=(30.0, 25.0, 20.0))],
    )
    transforms = np.tile(np.eye(3, 4), (4, 1, 1))
    for k in range(1, 4):
        transforms[k, :, :3] = np.diag([1.0, 0.7, 1.3 * (-1.0) ** k])
        transforms[k, :, 3] = (120.0 * k, 520.0 - 60.0 * k, 150.0 + 60.0 * k)
    objects = [box.replace(materials=materials), lamp]
    return rs.Scene.instances(objects, transforms, [0, 1, 1, 1], camera=box.camera)


@pytest.mark.parametrize("mode", ["path", "kajiya", "whitted", "raycast", "shadow"])
def test_lamps_in_instances_are_lights(lamps: rs.Scene, mode: str) -> None:
    (light,) = lamps.area_lights
    assert len(light.prim_ids) == 2
    assert len(lamps.flattened().area_lights) == 3
    images = [
        rs.render(scene, mode, (48, 48), samples=4, lights="file").pixels
        for scene in (lamps, lamps.flattened())
    ]
    close = np.isclose(*images, rtol=1e-3, atol=1e-4).all(axis=2)
    assert close.mean() > 0.99
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=5e-3)


@pytest.mark.ci
def test_samples_of_lamps_change_the_noise_and_not_the_mean(lamps: rs.Scene) -> None:
    means, noise = [], []
    for is_sampled in (True, False):
        runs = [
            rs.render(
                lamps,
                "path",
                (32, 32),
                samples=256,
                light_samples=is_sampled,
                seed=seed,
                lights="file",
                max_bounces=2,
            ).pixels
            for seed in range(4)
        ]
        means.append(np.mean(runs, axis=(0, 1, 2)))
        noise.append(np.std(runs, axis=0, ddof=1).mean())
    # Of 4 runs and a thousand pixels, whose noise hardly depends on that of others.
    error = np.hypot(*noise) / np.sqrt(4 * 32 * 32)
    assert abs(means[0] - means[1]) == pytest.approx([0.0] * 3, abs=5.0 * error)
    assert noise[0] < noise[1] / 2.0


def test_flat_lamps_do_not_block_their_light() -> None:
    """A lamp whose object is a thousand times as large, and one that is as much thinner."""
    pane = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]]
    ground = rs.Mesh(np.array(pane)[::-1] * 3.0 - [0.0, 2.0, 0.0], [[0, 1, 2], [0, 2, 3]])
    glowing = [rs.Material(emission=(5.0, 5.0, 5.0))]
    images = []
    for size, squeeze in ((1.0, 1.0), (1000.0, 1e-3), (1.0, 1e-6)):
        tilted = np.array(pane) * size
        tilted[:, 1] += tilted[:, 0] * min(1.0 / squeeze, 1e3) / 1e3
        lamp = rs.Scene([rs.Mesh(tilted, [[0, 1, 2], [0, 2, 3]])], materials=glowing)
        place = np.eye(3, 4)
        place[:, :3] = np.diag([1.0 / size, squeeze / size, 1.0 / size])
        camera = rs.Camera((0.0, -0.5, 4.0), (0.0, -2.0, 0.0))
        scene = rs.Scene.instances([ground, lamp], [np.eye(3, 4), place], [0, 1], camera=camera)
        images.append(rs.render(scene, "path", (24, 24), samples=16, lights="file").pixels)
    for image in images[1:]:
        assert image.mean() == pytest.approx(images[0].mean(), rel=0.01)


def test_a_lamp_far_from_the_rest_of_its_object_does_not_block_its_light() -> None:
    """Its object's coordinates are rounded more than those of the place where it stands."""
    pane = np.array([[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    faces, away = [[0, 1, 2], [0, 2, 3]], np.array([1000.0, 300.0, -700.0])
    ground = rs.Mesh(pane[::-1] * 3.0 - [0.0, 2.0, 0.0], faces)
    materials = [rs.Material(), rs.Material(emission=(5.0, 5.0, 5.0))]
    turn = random_rotation(np.random.default_rng(5))
    lamp = rs.Mesh(pane @ turn + away, faces, material_ids=[1, 1])
    rest = rs.Mesh(np.eye(3) - 1000.0, [[0, 1, 2]])
    place = np.concatenate([turn, -(turn @ away)[:, None]], axis=1)
    camera = rs.Camera((0.0, -0.5, 4.0), (0.0, -2.0, 0.0))
    objects = [
        rs.Scene([ground], materials=materials),
        rs.Scene([lamp, rest], materials=materials),
    ]
    scene = rs.Scene.instances(objects, [np.eye(3, 4), place], [0, 1], camera=camera)
    plain = rs.Scene(
        [ground, rs.Mesh(pane, faces, material_ids=[1, 1])], materials=materials, camera=camera
    )
    images = [
        rs.render(one, "path", (24, 24), samples=16, lights="file").pixels for one in (scene, plain)
    ]
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=0.01)


def test_too_many_lamps_glow_only(lamps: rs.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("raystream.rendering.emitters.MOST_EMITTERS", 5)
    with pytest.warns(rs.RaystreamWarning, match="6 triangles that emit light.*more than 5"):
        image = rs.render(lamps, "path", (8, 8), samples=4, lights="file")
    assert image.pixels.max() > 0.0


def test_lamps_are_patches_until_they_are_many(
    lamps: rs.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(area_patches(lamps)) == 3
    monkeypatch.setattr("raystream.rendering.lighting.MOST_PATCHES", 2)
    (patch,) = area_patches(lamps)
    assert patch.area == pytest.approx(3 * 60.0 * 60.0 * 1.3)
    assert patch.normal is None or abs(patch.normal[1]) == pytest.approx(1.0)
