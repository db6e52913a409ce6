"""Modes whose images have closed forms, or a recursive reference."""

import dataclasses

import numpy as np
import pytest

import raystream as rs
from meshes import cube
from raystream.rendering import sample_bands
from raystream.rendering.integrator import Integrator
from raystream.rendering.sampling.sampler import Sampler

DOWN = rs.DirectionalLight((0.0, 0.0, -1.0), (2.0, 1.0, 0.5))


def square(half, z, material=0, normal_up=True):
    """A horizontal square around the z axis."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * float(half)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    faces = faces if normal_up else faces[:, ::-1]
    return rs.Mesh(corners + [0, 0, z], faces, material_ids=np.full(2, material))


def disc(radius, z, sides=720):
    """A horizontal disc, as large as a round one: a ring of triangles around its middle."""
    angles = np.arange(sides) * 2 * np.pi / sides
    reach = radius * np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
    rim = np.stack([reach * np.cos(angles), reach * np.sin(angles), np.full(sides, z)], axis=1)
    faces = [[sides, k, (k + 1) % sides] for k in range(sides)]
    return rs.Mesh(np.vstack([rim, [0.0, 0.0, z]]), np.array(faces))


def looking_down(x=0.0, y=0.0, height=2.0, fov=0.02):
    """A camera that sees one point of the plane z = 0, at a slant that is next to nothing."""
    eye = (x + 1e-3, y, height)
    return rs.Camera(eye=eye, look_at=(x, y, 0.0), up=(0.0, 1.0, 0.0), fov=fov)


def mean_of(scene, mode, samples, **options):
    """The mean colour of an image of 8 x 8 pixels."""
    image = rs.render(scene, mode, size=(8, 8), samples=samples, **options)
    return image.pixels.reshape(-1, 3).mean(axis=0)


@pytest.mark.parametrize("height", [0.3, 1.0, 3.0])
def test_a_disc_hides_its_part_of_the_sky(height):
    scene = rs.Scene([square(50, 0.0), disc(1.0, height)])
    # From beside the disc, at the point below its middle.
    camera = rs.Camera(eye=(40.0, 0.0, height / 2), look_at=(0, 0, 0), up=(0, 0, 1), fov=1e-3)
    seen = mean_of(scene, "ao", 32, camera=camera, distance=np.inf)
    # sin(angle)**2 of the sky is hidden; 65,536 rays, a standard error below 0.002.
    np.testing.assert_allclose(seen, 1.0 - 1.0 / (1.0 + height**2), atol=0.01)


def test_a_distance_leaves_what_is_farther_out():
    scene = rs.Scene([square(50, 0.0), disc(20.0, 1.0)])
    camera = rs.Camera(eye=(40.0, 0.0, 0.5), look_at=(0, 0, 0), up=(0, 0, 1), fov=1e-3)
    assert mean_of(scene, "ao", 1, camera=camera, distance=np.inf).max() < 0.05
    assert mean_of(scene, "ao", 1, camera=camera, distance=0.99).min() == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [1.0, 1e4])
@pytest.mark.parametrize("height", [4.0, 5.1])
def test_rays_of_ao_reach_a_tenth_of_the_diagonal(height, scale):
    """A floor of 30 x 40 below a ceiling: rays of length r reach it at cosines above h / r."""
    plates = [
        rs.Mesh(np.array([15, 20, 1]) * mesh.vertices * scale, mesh.faces)
        for mesh in (square(1, 0.0), square(1, height))
    ]
    eye = np.array([12.0, 0.0, height / 2]) * scale
    camera = rs.Camera(eye=eye, look_at=(0, 0, 0), up=(0, 0, 1), fov=1e-3)
    reach = 0.1 * np.sqrt(30**2 + 40**2 + height**2)
    hidden = max(0.0, 1.0 - (height / reach) ** 2)
    seen = mean_of(rs.Scene(plates), "ao", 32, camera=camera)
    np.testing.assert_allclose(seen, 1.0 - hidden, atol=0.01 if hidden else 0.0)


def test_closed_rooms_are_not_black_in_ao():
    vertices, faces = cube()
    room = rs.Scene([rs.Mesh(vertices, faces[:, ::-1])])
    camera = rs.Camera(eye=(0.6, 0.55, 0.4), look_at=(1, 0.9, 0.7), fov=90)
    seen = rs.render(room, "ao", (8, 6), camera=camera)
    assert seen.pixels.mean() > 0.7
    same = rs.render(room, "ao", (8, 6), camera=camera, distance=0.1 * np.sqrt(3.0))
    np.testing.assert_array_equal(seen.pixels, same.pixels)
    assert not rs.render(room, "ao", (8, 6), camera=camera, distance=np.inf).pixels.any()


def test_a_surface_in_the_open_is_white_on_black_in_ao():
    camera = rs.Camera(eye=(0, 0, 5), look_at=(0, 0, 0), up=(0, 1, 0), fov=90.0)
    scene = rs.Scene([square(1, 0.0)])
    seen = rs.render(scene, "ao", (40, 30), camera=camera).pixels
    expected = rs.render(scene, "vis", (40, 30), camera=camera).pixels > 0.0
    assert 0 < expected.sum() < expected.size
    np.testing.assert_allclose(seen, expected, rtol=1e-6)


def test_shadow_is_the_ray_caster_where_nothing_blocks_the_light():
    matte, shiny = rs.Material(), rs.Material(specular=(0.3, 0.3, 0.3), shininess=9.0)
    scene = rs.Scene(
        [square(4, 0.0), square(1, 1.5, 1), square(0.3, 2.5, 1, normal_up=False)],
        materials=[matte, shiny],
        lights=[DOWN, rs.PointLight((3.0, 2.0, 5.0), (20.0, 10.0, 5.0))],
        camera=rs.Camera(eye=(6, -5, 7), look_at=(0, 0, 0.5), up=(0, 0, 1), fov=40.0),
    )
    tracer = rs.Tracer(scene)
    cast = [
        rs.render(
            rs.Tracer(rs.Scene(scene.meshes, materials=scene.materials, lights=[light])),
            "raycast",
            camera=scene.camera,
            size=(48, 36),
        ).pixels
        for light in scene.lights
    ]
    shadow = rs.render(tracer, "shadow", size=(48, 36)).pixels
    x, y = np.meshgrid(np.arange(48) + 0.5, np.arange(36) + 0.5)
    hits = tracer.first_hit(*scene.camera.rays(48, 36, x, y))
    expected = np.zeros_like(shadow)
    for light, picture in zip(scene.lights, cast, strict=True):
        if isinstance(light, rs.DirectionalLight):
            toward, reach = np.broadcast_to([0.0, 0.0, 1.0], hits.positions.shape), np.inf
        else:
            toward, reach = np.array(light.position) - hits.positions, 1.0
        blocked = tracer.any_hit(*hits.spawn(toward), t_max=reach)
        expected += np.where((blocked | ~hits.is_hit)[..., None], 0.0, picture)
    assert (expected == 0.0).any()
    # The ray caster's highlights are Phong's; those of the others have a lobe's energy.
    matte_hit = hits.is_hit & np.isin(hits.mesh_id, [0])
    np.testing.assert_allclose(shadow[matte_hit], expected[matte_hit], rtol=2e-5, atol=1e-6)


def recursive(scene, tracer, origins, directions, bounces):
    """Whitted's image of flat, matte mirrors under a sun, by recursion."""
    hits = tracer.first_hit(origins, directions)
    seen = np.broadcast_to(np.asarray(scene.background, float), (len(origins), 3)).copy()
    rows = np.flatnonzero(hits.is_hit)
    if not len(rows):
        return seen
    hits, view = hits[rows], directions[rows] / np.linalg.norm(directions[rows], axis=1)[:, None]
    ids = np.concatenate([mesh.material_ids for mesh in scene.meshes])[hits.prim_id]
    materials = [scene.materials[k] for k in ids]
    normals = hits.normals.astype(float)
    normals *= -np.sign(np.einsum("ij,ij->i", normals, view))[:, None]
    color = np.zeros((len(rows), 3))
    for light in scene.lights:
        toward = -np.array(light.direction) / np.linalg.norm(light.direction)
        cosine = np.maximum(normals @ toward, 0.0)[:, None]
        lit = ~tracer.any_hit(*hits.spawn(np.broadcast_to(toward, normals.shape)))[:, None]
        matte = np.array([m.diffuse for m in materials]) / np.pi
        color += lit * cosine * matte * np.array(light.irradiance)
    mirror = np.array([m.reflection for m in materials])
    if bounces and mirror.any():
        away = view - 2 * np.einsum("ij,ij->i", view, normals)[:, None] * normals
        away = away.astype(np.float32)
        color += mirror * recursive(scene, tracer, *hits.spawn(away), bounces - 1)
    seen[rows] = color
    return seen


@pytest.mark.parametrize("bounces", range(6))
def test_reflection_without_recursion(bounces):
    """Christen 2005, equation 5.1: a colour times 1 - r, plus r times the reflected radiance."""
    shares = [
        (0.9, 0.2, 0.1, 0.5),
        (0.1, 0.8, 0.3, 0.7),
        (0.2, 0.3, 0.9, 0.3),
        (0.7, 0.7, 0.6, 0.0),
    ]
    materials = [
        rs.Material(diffuse=tuple(c * (1 - r) for c in color), reflection=(r, r, r))
        for *color, r in shares
    ]
    wall = np.array([[0, 0, 0], [0, 3, 0], [0, 3, 3], [0, 0, 3]], float)
    faces = [[0, 1, 2], [0, 2, 3]]
    meshes = [square(3, 0.0, 3), square(0.5, 1.0, 2)]
    for k, (x, turn) in enumerate([(-2.0, 0.1), (2.0, -0.15)]):
        turned = wall - [0, 1.5, 0]
        turned[:, 0] += x + turn * turned[:, 1] + 0.2 * turned[:, 2]
        meshes.append(rs.Mesh(turned, faces, material_ids=[k, k]))
    scene = rs.Scene(
        meshes,
        materials=materials,
        lights=[rs.DirectionalLight((0.3, 0.4, -1.0), (3, 3, 3))],
        background=(0.1, 0.2, 0.4),
        camera=rs.Camera(eye=(-0.5, -4, 2.5), look_at=(0, 0, 1), up=(0, 0, 1), fov=50.0),
    )
    tracer = rs.Tracer(scene)
    image = rs.render(tracer, "whitted", size=(64, 48), max_bounces=bounces, min_weight=0.0)
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    rays = [array.reshape(-1, 3) for array in scene.camera.rays(64, 48, x, y)]
    expected = recursive(scene, tracer, *rays, bounces).reshape(48, 64, 3)
    np.testing.assert_allclose(image.pixels, expected, atol=1e-5, rtol=1e-5)


def test_glass_bends_rays_and_a_plate_moves_them():
    """Through a plate of thickness d at a slant: aside by d sin(a - b) / cos(b)."""
    glass = rs.Material(diffuse=(0, 0, 0), transmission=(1, 1, 1), ior=1.5)
    glow = rs.Material(diffuse=(0, 0, 0), emission=(1, 0, 0))
    lit = rs.Material(diffuse=(0, 0, 0))
    plate = [square(30, 1.0, 0, normal_up=False), square(30, 2.0, 0)]
    angle = np.radians(50.0)
    inside = np.arcsin(np.sin(angle) / 1.5)
    for shift, expected in ((np.tan(angle) * 2 + np.tan(inside), True), (3 * np.tan(angle), False)):
        # From z = 3 the ray crosses the plate, and meets the ground at this x.
        spot = square(0.02, 0.0, 1)
        moved = rs.Mesh(spot.vertices + [shift, 0, 0], spot.faces, material_ids=[1, 1])
        scene = rs.Scene([*plate, moved, square(90, -0.01, 2)], materials=[glass, glow, lit])
        direction = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        eye = np.array([0.0, 0.0, 3.0])
        camera = rs.Camera(eye=eye, look_at=eye + direction, up=(0, 1, 0), fov=0.01)
        red = rs.render(scene, "whitted", (1, 1), camera=camera, lights="file").pixels[0, 0, 0]
        assert (red > 0.5) == expected


@pytest.mark.parametrize("layers", [0, 1, 7])
def test_sheets_cover_what_is_behind_them(layers):
    materials = [rs.Material(diffuse=(0.5, 0.25, 1.0))]
    meshes = [square(3, -float(z)) for z in range(layers)] or [square(1, 50.0)]
    scene = rs.Scene(meshes, materials=materials, background=(1.0, 1.0, 0.0))
    camera = rs.Camera(eye=(0, 0, 9), look_at=(0, 0, 0), up=(0, 1, 0), fov=0.001)
    seen = mean_of(scene, "xray", 1, camera=camera, opacity=0.3)
    passed = 0.7**layers
    expected = (1 - passed) * np.array([0.5, 0.25, 1.0]) + passed * np.array([1.0, 1.0, 0.0])
    np.testing.assert_allclose(seen, expected, rtol=1e-5, atol=1e-6)


def test_solids_absorb_by_their_thickness():
    top, bottom = square(1, 2.0), square(1, 0.5, normal_up=False)
    scene = rs.Scene(
        [
            rs.Mesh(
                np.vstack([top.vertices, bottom.vertices]), np.vstack([top.faces, bottom.faces + 4])
            )
        ]
    )
    camera = rs.Camera(eye=(0, 0, 9), look_at=(0, 0, 0), up=(0, 1, 0), fov=0.001)
    seen = mean_of(scene, "xray", 1, camera=camera, absorption=0.8)
    np.testing.assert_allclose(seen, np.exp(-0.8 * 1.5), rtol=1e-5)


@pytest.mark.parametrize(
    ("mode", "options", "message"),
    [
        ("path", {"max_bounces": -1}, "max_bounces: expected 0 to"),
        ("whitted", {"max_bounces": 1001}, "max_bounces: expected 0 to"),
        ("whitted", {"min_weight": float("nan")}, "min_weight: expected"),
        ("ao", {"rays": 0}, "rays: expected 1 to"),
        ("ao", {"distance": 0.0}, "distance: expected"),
        ("xray", {"opacity": 1.5}, "opacity: expected 0 to 1"),
        ("xray", {"absorption": -1.0}, "absorption: expected"),
        ("path", {"max_bounces": 2.5}, "max_bounces: expected an integer, got 2.5"),
        ("path", {"light_samples": "no"}, "light_samples: expected True or False"),
        ("path", {"clamp": 0.0}, "clamp: expected a number above 0"),
        ("kajiya", {"clamp": None}, "clamp: expected a number, got None"),
        ("ao", {"distance": "far"}, "distance: expected a number, got 'far'"),
        ("path", {"noise": 0.0}, "noise: expected a number above 0"),
        ("path", {"time_limit": float("inf")}, "time_limit: expected a number above 0"),
        ("path", {"sampler": "halton"}, "expected one of"),
    ],
)
def test_bad_options(mode, options, message):
    with pytest.raises(ValueError, match=message):
        rs.render(rs.Scene([square(1, 0.0)]), mode, size=(4, 4), **options)


def test_options_of_another_mode_are_not_taken():
    with pytest.raises(TypeError, match="rays"):
        rs.render(rs.Scene([square(1, 0.0)]), "path", size=(4, 4), rays=3)


def test_raycast_is_shadow_where_nothing_is_in_the_way():
    """Matte, gloss, metal, a bulb, a lamp and ambient light on a floor."""
    materials = [
        rs.Material(diffuse=(0.5, 0.3, 0.2), specular=(0.4, 0.4, 0.4), shininess=20),
        rs.Material(diffuse=(0.9, 0.6, 0.2), roughness=0.4, metallic=0.7),
        rs.Material(emission=(5.0, 4.0, 3.0)),
    ]
    lights = [DOWN, rs.PointLight((1.0, 1.0, 2.0), (3.0, 2.0, 1.0))]
    floors = [square(2, 0.0, 0), square(6, -0.1, 1)]
    lamp = square(0.5, 8.0, 2, normal_up=False)
    scene = rs.Scene([*floors, lamp], materials=materials, lights=lights)
    camera = rs.Camera(eye=(0, -5, 3), look_at=(0, 0, 0), up=(0, 0, 1), fov=60)
    raycast, shadow = (
        rs.render(scene, mode, size=(24, 18), samples=2, camera=camera).pixels
        for mode in ("raycast", "shadow")
    )
    # The upper floor hides the lower one from lights at its rim only.
    np.testing.assert_allclose(np.median(raycast - shadow), 0.0, atol=1e-6)
    assert (np.abs(raycast - shadow).max(axis=2) <= 1e-5).mean() > 0.9
    assert raycast.std() > 0.05


def test_every_mode_renders_nothing_at_all():
    empty = rs.Scene.from_arrays(np.empty((0, 3)), np.empty((0, 3), int))
    for mode in rs.MODES:
        image = rs.render(empty, mode, size=(5, 4), samples=2)
        assert np.isfinite(image.pixels).all(), mode


def test_every_mode_renders_one_pixel():
    scene = rs.Scene([square(1, 0.0)], lights=[DOWN], camera=looking_down())
    for mode in rs.MODES:
        assert rs.render(scene, mode, size=(1, 1)).pixels.any(), mode


def test_samples_of_a_picture_that_goes_on_are_those_of_a_longer_one(tmp_path):
    scene = rs.Scene([square(4, 0.0), square(1, 1.0)], lights=[DOWN])
    file = tmp_path / "samples.npz"
    options = {"size": (12, 10), "seed": 3}
    whole = rs.render(scene, "path", samples=12, **options)
    rs.render(scene, "path", samples=5, checkpoint=file, **options)
    again = rs.render(scene, "path", samples=12, checkpoint=file, **options)
    np.testing.assert_array_equal(again.pixels, whole.pixels)
    np.testing.assert_array_equal(again.layers["samples"], 12)
    with pytest.raises(rs.FileFormatError, match="another image"):
        rs.render(scene, "path", samples=12, checkpoint=file, **{**options, "seed": 4})


@pytest.mark.parametrize("mode", ["ao", "whitted", "path"])
def test_pictures_do_not_depend_on_bands(mode, monkeypatch):
    """Where a pixel sends many rays, bands have few pixels, so that memory is bounded."""
    materials = [rs.Material(reflection=(0.3, 0.3, 0.3)), rs.Material()]
    scene = rs.Scene(
        [square(4, 0.0), square(1, 1.0, 1)],
        materials=materials,
        lights=[DOWN, rs.PointLight((2.0, 1.0, 4.0), (9.0, 9.0, 9.0))],
        camera=rs.Camera(eye=(6, -5, 7), look_at=(0, 0, 0.5), up=(0, 0, 1), fov=40.0),
    )
    whole = rs.render(scene, mode, size=(16, 12), samples=2, lights="file").pixels
    counted = []
    trace = Integrator.trace

    def spy(renderer, context, rows, *others):
        counted.append(len(rows))
        return trace(renderer, context, rows, *others)

    monkeypatch.setattr(Integrator, "trace", spy)
    monkeypatch.setattr(sample_bands, "MOST_RAYS", 64)
    monkeypatch.setattr(sample_bands, "MOST_BAND", 64)
    image = rs.render(scene, mode, size=(16, 12), samples=2, lights="file")
    np.testing.assert_array_equal(image.pixels, whole)
    assert max(counted) == {"ao": 1, "whitted": 2, "path": 4}[mode]


def test_noise_ends_a_picture_early():
    scene = rs.Scene([square(4, 0.0), square(1, 1.0)], lights=[rs.EnvironmentLight()])
    camera = rs.Camera(eye=(0, -6, 4), look_at=(0, 0, 0), up=(0, 0, 1), fov=40.0)
    image = rs.render(scene, "path", (16, 12), samples=4096, camera=camera, noise=0.05)
    assert 8 <= image.figures["samples"] < 4096
    assert image.figures["error"] <= 0.05


def test_sampler_of_one_sample_goes_through_the_centres():
    scene = rs.Scene([square(4, 0.0)], lights=[DOWN])
    image = rs.render(scene, "shadow", size=(9, 7))
    same = rs.render(scene, "shadow", size=(9, 7), seed=5, sampler="random")
    np.testing.assert_array_equal(image.pixels, same.pixels)
    assert Sampler.of("sobol", 0, 1).sample_count == 1


def test_a_lens_blurs_what_is_out_of_focus():
    camera = rs.Camera(eye=(0, 0, 4), look_at=(0, 0, 0), up=(0, 1, 0), fov=30.0)
    glow = rs.Material(emission=(1, 1, 1))
    scene = rs.Scene([square(0.5, 0.0)], materials=[glow])
    sharp = rs.render(scene, "path", (24, 24), 64, camera=camera).pixels
    blurred = dataclasses.replace(camera, aperture=0.5, focus=1.0)
    focused = dataclasses.replace(camera, aperture=0.5, focus=4.0)
    edges = {}
    for name, view in (("blurred", blurred), ("focused", focused)):
        pixels = rs.render(scene, "path", (24, 24), 64, camera=view).pixels
        edges[name] = np.abs(pixels - sharp).mean()
    assert edges["focused"] < 0.01 < 0.1 < edges["blurred"]


def test_a_checkpoint_of_other_texture_pixels_is_another_picture(tmp_path):
    file = tmp_path / "samples.npz"
    for shade, refused in ((200, False), (20, True)):
        texture = rs.Texture(np.full((2, 2, 3), shade, np.uint8))
        mesh = square(1, 0.0)
        mesh = rs.Mesh(mesh.vertices, mesh.faces, texcoords=np.zeros((4, 2)))
        scene = rs.Scene([mesh], materials=[rs.Material(textures={"diffuse": texture})])
        if refused:
            with pytest.raises(rs.FileFormatError, match="another image"):
                rs.render(scene, "path", (4, 3), 3, checkpoint=file)
        else:
            rs.render(scene, "path", (4, 3), 2, checkpoint=file)
