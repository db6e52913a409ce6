"""Partly transparent surfaces, against coverage, and against images without them."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import cube
from raystream.core.errors import RaystreamWarning
from raystream.rendering.opacity import Opacity
from raystream.rendering.vertex_attributes import VertexAttributes
from z_test import assert_mean, assert_zero

BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
SUN = rs.DirectionalLight((0, 0, -1), (np.pi,) * 3)
AHEAD = rs.Camera((0.1, 0.2, 5), (0, 0, 0), fov=40)

#: Columns that are there and not, between two texels as far as they are uniform.
COLUMNS = np.repeat([[0, 0, 255, 255, 0, 0, 255, 255]], 4, axis=0).astype(np.uint8)[:, :, None]


def plate(z, material=0, size=4.0):
    """A square that faces +z, with u and v from 0 to 1 over it."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    vertices = np.column_stack([size * corners, np.full(4, z)])
    texcoords, faces = (corners + 1) / 2, [[0, 1, 2], [0, 2, 3]]
    return rs.Mesh(vertices, faces, material_ids=np.full(2, material), texcoords=texcoords)


def faint(alphas, material=0):
    """The same plate with an alpha at each corner, from the lower left counterclockwise."""
    mesh = plate(0, material)
    colors = np.column_stack([np.ones((4, 3)), alphas])
    attributes = {"texcoords": mesh.texcoords, "material_ids": mesh.material_ids}
    return rs.Mesh(mesh.vertices, mesh.faces, colors=colors, **attributes)


def masked(pixels, **looks):
    return rs.Material(textures={"opacity": rs.Texture(pixels, wrap="clamp")}, **looks)


def assert_share(values, share):
    """Fail where the share of ones among independent numbers is off by more than chance allows."""
    values = np.round(np.asarray(values, float), 6)
    assert np.isin(values, (0.0, 1.0)).all()
    assert 0.0 < values.mean() < 1.0
    variance = share * (1.0 - share) / values.size
    assert_zero(values.mean() - share, np.array(variance), 1.0)


@pytest.mark.parametrize("mode", ["raycast", "whitted", "shadow", "xray"])
def test_a_black_plate_covers_its_share_of_a_white_background(mode):
    """Coverage 0.25: one sample is a dither, with one ray in four on the plate."""
    material = rs.Material(diffuse=BLACK, opacity=0.25)
    scene = rs.Scene([plate(0)], materials=[material], lights=[SUN], background=WHITE, camera=AHEAD)
    options = {"opacity": 1.0} if mode == "xray" else {}
    image = rs.render(scene, mode, (64, 64), **options)
    assert_share(image.pixels[:, :, 0], 0.75)
    other = rs.render(scene, mode, (64, 64), seed=1, **options)
    assert (image.pixels != other.pixels).any()


@pytest.mark.parametrize("mode", ["path", "kajiya"])
def test_coverage_of_many_samples(mode):
    """Two plates, one behind the other, are independent."""
    materials = [rs.Material(diffuse=BLACK, opacity=0.25), rs.Material(diffuse=BLACK, opacity=0.5)]
    meshes = [plate(0), plate(-1, 1, 9)]
    scene = rs.Scene(meshes, materials=materials, background=WHITE, camera=AHEAD)
    assert_mean(rs.render(scene, mode, (32, 32), 16, sampler="random"), 0.75 * 0.5)


@pytest.mark.parametrize("mode", ["shadow", "path"])
def test_shadows_of_what_is_partly_clear(mode):
    """A wall under a plate of coverage 0.25, which the camera does not see."""
    materials = [rs.Material(diffuse=WHITE), rs.Material(diffuse=BLACK, opacity=0.25)]
    camera = rs.Camera((0.1, 0.2, 1), (0, 0, 0), fov=40)
    meshes = [plate(0), plate(2, 1, 50)]
    scene = rs.Scene(meshes, materials=materials, lights=[SUN], camera=camera)
    if mode == "shadow":
        assert_share(rs.render(scene, mode, (64, 64)).pixels[:, :, 0], 0.75)
    else:
        options = {"sampler": "random", "max_bounces": 1}
        assert_mean(rs.render(scene, mode, (32, 32), 16, **options), 0.75)


def test_ambient_occlusion_of_what_is_partly_clear():
    materials = [rs.Material(), rs.Material(opacity=0.25)]
    camera = rs.Camera((0.01, 0.02, 0.05), (0, 0, 0), fov=40)  # sees nothing but the first plate
    meshes = [plate(0), plate(0.1, 1, 500)]
    scene = rs.Scene(meshes, materials=materials, camera=camera)
    assert_mean(
        rs.render(scene, "ao", (32, 32), 4, rays=4, distance=np.inf, sampler="random"), 0.75
    )


def fence(material, behind=True):
    """A striped plate before a wall, with the light in between, so that it casts no shadow."""
    light = rs.PointLight((0.5, 1, 2.9), (9, 8, 7))
    wall, front = plate(0, 0, 9), plate(3, 1)
    meshes = [wall, front] if behind else [front]
    materials = [rs.Material(diffuse=(0.9, 0.6, 0.3)), material]
    camera = rs.Camera((0.3, 0.2, 9), (0, 0, 0), fov=30)
    return rs.Scene(meshes, materials=materials, lights=[light], camera=camera)


@pytest.mark.parametrize("mode", ["raycast", "whitted", "path"])
def test_a_mask_shows_exactly_what_is_behind(mode):
    options = {"size": (48, 32), "samples": 1, "lights": "file"}
    options |= {"max_bounces": 1} if mode == "path" else {}
    image = rs.render(fence(masked(COLUMNS, alpha_cutoff=0.5)), mode, **options).pixels
    solid = rs.render(fence(rs.Material()), mode, **options).pixels
    gone = rs.render(fence(rs.Material(opacity=0.4, alpha_cutoff=0.5)), mode, **options).pixels
    # Where the columns of the pixels' centres are: on the plate u is x / 8 + 1/2.
    tracer = rs.Tracer(rs.Scene([plate(3)]))
    hits = tracer.first_hit(*fence(rs.Material()).camera.rays(48, 32))
    u = hits.positions[:, :, 0] / 8 + 0.5
    is_there = hits.is_hit & (np.floor(u * 4) % 2 == 1)
    assert is_there.any()
    assert not is_there.all()
    assert_same_bits(image[is_there], solid[is_there])
    assert_same_bits(image[~is_there], gone[~is_there])
    assert (solid != gone)[is_there].any()


def test_the_cutoff_itself_is_there():
    grey = np.full((2, 2, 1), 128, np.uint8)
    for cutoff, is_seen in ((128 / 255, True), (129 / 255, False)):
        scene = rs.Scene([plate(0)], materials=[masked(grey, alpha_cutoff=cutoff)], camera=AHEAD)
        assert rs.render(scene, "vis", (8, 8)).pixels.any() == is_seen


def test_opacity_between_texels_is_bilinear():
    ramp = np.array([[0, 255]], np.uint8)[:, :, None]
    material = masked(ramp, diffuse=BLACK, opacity=0.8)
    camera = rs.Camera((0, 0, 50), (0, 0, 0), fov=1e-3)  # the middle: half of 0.8
    scene = rs.Scene([plate(0)], materials=[material], background=WHITE, camera=camera)
    assert_mean(rs.render(scene, "path", (32, 32), 16, sampler="random"), 0.6)


@pytest.mark.parametrize("alphas", [[0, 1, 1, 0], [0, 0, 1, 1]])
def test_the_alpha_of_vertices_is_interpolated(alphas):
    """Times an opacity of 0.8, it reaches the cutoff at 5/8 of the way from 0 to 1."""
    material = rs.Material(opacity=0.8, alpha_cutoff=0.5)
    camera = rs.Camera((0, 0, 1), (0, 0, 0), fov=2 * np.degrees(np.arctan(4)))  # all of the plate
    scene = rs.Scene([faint(alphas)], materials=[material], camera=camera)
    is_there = rs.render(scene, "vis", (32, 32)).pixels.any(axis=2)
    expected = np.zeros((32, 32), bool)
    expected[:, 20:] = True
    np.testing.assert_array_equal(is_there, expected if alphas[1] else expected.T[::-1])


def test_the_alpha_of_vertices_is_a_share_of_rays():
    """Without a cutoff; the plate behind it has no alpha."""
    materials = [rs.Material(diffuse=BLACK), rs.Material(diffuse=BLACK, opacity=0.5)]
    meshes = [faint([0.25] * 4), plate(-1, 1, 9)]
    scene = rs.Scene(meshes, materials=materials, background=WHITE, camera=AHEAD)
    assert_mean(rs.render(scene, "path", (32, 32), 16, sampler="random"), 0.75 * 0.5)


def test_what_glows_with_an_alpha_is_no_area_light():
    glowing = rs.Material(emission=(1, 1, 1))
    assert len(rs.Scene([plate(0)], materials=[glowing]).area_lights) == 1
    assert len(rs.Scene([faint([1] * 4)], materials=[glowing]).area_lights) == 1
    assert rs.Scene([faint([1, 1, 1, 0.5])], materials=[glowing]).area_lights == []


def test_a_sphere_behind_an_alpha_is_seen_by_a_share_of_rays():
    balls = rs.Scene.spheres([[0, 0, -9.0]], 8.0, materials=[rs.Material(diffuse=BLACK)])
    meshes = rs.Scene([faint([0.25] * 4)], materials=[rs.Material(diffuse=BLACK, emission=WHITE)])
    scene = rs.Scene.combine([meshes, balls], camera=AHEAD)
    assert_mean(rs.render(scene, "path", (32, 32), 16, sampler="random"), 0.25)


@pytest.mark.ci
@pytest.mark.parametrize("structure", ["kdtree", "grid", "graph", "brute"])
def test_all_structures_show_the_same(structure):
    """Masks, partly clear surfaces, and light through both."""
    rng = np.random.default_rng(3)
    meshes = [plate(0, 0, 9)]
    for z in (1.0, 1.5, 2.0, 2.5):
        mesh = plate(z, 1 + int(2 * z) % 2, 1.5)
        tilt = rng.normal(0.0, 0.2, 3)
        meshes.append(mesh.moved(mesh.vertices + mesh.vertices * tilt + rng.normal(0, 0.3, 3)))
    meshes.append(faint([0.25, 0.5, 0.75, 1.0]).moved(plate(1.2, size=1.5).vertices))
    materials = [rs.Material(), masked(COLUMNS, alpha_cutoff=0.5), masked(COLUMNS, opacity=0.6)]
    lights = [rs.PointLight((1, 2, 5), (90, 90, 90))]
    camera = rs.Camera((0.3, 0.2, 9), (0, 0, 0), fov=30)
    scene = rs.Scene(meshes, materials=materials, lights=lights, camera=camera)
    for mode, samples in (("path", 2), ("xray", 1)):
        first = rs.render(scene, mode, (24, 16), samples)
        image = rs.render(scene, mode, (24, 16), samples, structure=structure)
        assert_same_bits(image.pixels, first.pixels)


@pytest.mark.parametrize("light_samples", [True, False])
def test_a_furnace_with_holes(light_samples):
    """Walls that emit E, reflect rho, and are there with probability a: a E / (1 - a rho)."""
    vertices, faces = cube()
    walls = rs.Material(diffuse=(0.5, 0.8, 0.0), emission=(1.0, 0.25, 2.0), opacity=0.5)
    camera = rs.Camera((0.6, 0.55, 0.4), (1.5, 1.2, 0.9), fov=90)
    scene = rs.Scene([rs.Mesh(vertices, faces[:, ::-1])], materials=[walls], camera=camera)
    assert scene.area_lights == []
    scene = scene.replace(lights=[rs.PointLight((9, 9, 9), BLACK)])  # so that there is no white sky
    options = {"sampler": "random", "max_bounces": 1000, "light_samples": light_samples}
    image = rs.render(scene, "path", (32, 32), 16, **options)
    assert_mean(image, 0.5 * np.array(walls.emission) / (1.0 - 0.5 * np.array(walls.diffuse)))


# Opaque materials


def test_opaque_scenes_have_no_filter():
    solid = np.full((2, 2, 4), 255, np.uint8)
    opaque = [
        rs.Material(),
        rs.Material(opacity=0.7, alpha_cutoff=0.5),
        masked(solid[:, :, :1]),
        masked(solid, alpha_cutoff=1.0),
        masked(COLUMNS, alpha_cutoff=0.0),
    ]
    assert Opacity.of(rs.Scene([faint([1.0] * 4)]), 0) is None
    assert Opacity.of(rs.Scene([faint([1, 1, 1, 0.5])]), 0) is not None
    unused = rs.Material(opacity=0.5)
    for material in opaque:
        assert Opacity.of(rs.Scene([plate(0)], materials=[material, unused]), 0) is None
    for material in (unused, masked(COLUMNS), rs.Material(opacity=0.4, alpha_cutoff=0.5)):
        assert Opacity.of(rs.Scene([plate(0)], materials=[material]), 0) is not None


def test_the_alpha_channel_counts_if_there_is_one():
    color = np.zeros((1, 1, 4), np.uint8)
    color[...] = 255, 255, 255, 0
    scene = rs.Scene([plate(0)], materials=[masked(color)], camera=AHEAD)
    assert not rs.render(scene, "vis", (8, 8)).pixels.any()
    color[...] = 0, 0, 0, 255  # says nothing: the colours do
    scene = rs.Scene([plate(0)], materials=[masked(color)], camera=AHEAD)
    assert not rs.render(scene, "vis", (8, 8)).pixels.any()
    alpha = rs.Texture(color).alpha()
    assert alpha.pixels().tolist() == [[[255]]]
    assert rs.Texture(color[:, :, :3]).alpha().pixels().tolist() == [[[255]]]


def test_opacity_that_cannot_be_read_is_left_out(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no image")
    material = rs.Material(textures={"opacity": rs.Texture(tmp_path / "a.png")})
    with pytest.warns(RaystreamWarning, match=r"a\.png"):
        assert Opacity.of(rs.Scene([plate(0)], materials=[material]), 0) is None


def test_meshes_with_and_without_an_alpha_are_joined():
    """Neither the colours nor the other meshes change."""
    colors = np.random.default_rng(5).random((4, 4)).astype(np.float32)
    corners = plate(0)
    meshes = [
        rs.Mesh(corners.vertices, corners.faces, colors=colors[:, :3]),
        corners,
        rs.Mesh(corners.vertices, corners.faces, colors=colors, material_ids=1),
    ]
    scene = rs.Scene(meshes, materials=[rs.Material(), rs.Material()])
    whole = np.ones((12, 4), np.float32)
    whole[:4, :3], whole[8:] = colors[:, :3], colors
    assert_same_bits(scene.attributes.colors, whole)
    assert_same_bits(VertexAttributes.of(scene).colors, whole[:, :3].copy())
    assert scene.attributes.faint_materials == {1}
    assert not scene.is_opaque
    assert rs.Scene(meshes[:2]).attributes.colors.shape == (8, 3)
    assert rs.Scene(meshes[:2]).is_opaque
