"""Mirrors in mirrors by fragment programs, beside the whitted renderer."""

import numpy as np
import pytest

import raystream as rs
from raystream_lab.christen.scenes import christen_scene

pytestmark = pytest.mark.usefixtures("opened")

SIZE = 48, 40


def pictures(scene, bounces, size=SIZE, structure="grid", **options):
    """The same image by fragment programs, and by the renderer on the CPU."""
    from raystream.graphics import render_bounces

    tracer, camera = rs.Tracer(scene, structure), scene.camera_for(size[0] / size[1])
    ours = render_bounces(tracer, size, camera=camera, max_bounces=bounces, **options)
    theirs = rs.render(tracer, "whitted", size, camera=camera, max_bounces=bounces, **options)
    return ours, theirs


def differing(ours, theirs, allowed=1e-4):
    """Number of pixels that differ by more than rounding, relative to brightness."""
    difference = np.abs(ours.pixels - theirs.pixels)
    return np.count_nonzero((difference > allowed * np.maximum(theirs.pixels, 1.0)).any(axis=2))


@pytest.mark.parametrize("bounces", range(5))
def test_scene_a_has_the_iterations_of_equation_5_1(bounces):
    """Every surface mirrors: every iteration shows."""
    ours, theirs = pictures(christen_scene("A"), bounces)
    assert ours.figures["iterations"] == bounces + 1
    assert ours.pixels.max() > 0.1
    assert differing(ours, theirs) <= 4


@pytest.mark.exhaustive
@pytest.mark.parametrize("letter", ["B", "C"])
def test_scenes_with_many_and_with_curved_mirrors(letter):
    ours, theirs = pictures(christen_scene(letter), 3)
    assert differing(ours, theirs) <= 10


def test_a_scene_without_mirrors_takes_one_iteration():
    ours, theirs = pictures(rs.load("cornell"), 4)
    assert ours.figures == {"iterations": 1, "passes": 8}  # one light
    assert differing(ours, theirs) == 0


def test_two_mirrors_that_face_each_other_add_up_to_a_geometric_series():
    """The eye between two walls of r = 1/2 that glow: 1 + 1/2 + 1/4 + ... of that."""
    glowing = rs.Material(diffuse=(0.0,) * 3, reflection=(0.5,) * 3, emission=(1.0, 2.0, 4.0))
    corners = np.array([[-9.0, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1]])
    ahead = rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    behind = rs.Mesh(corners * [1, 1, -1], [[0, 2, 1], [0, 3, 2]])
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=4.0)
    scene = rs.Scene([ahead, behind], materials=[glowing], camera=camera)
    from raystream.graphics import render_bounces

    for bounces in (0, 1, 5):
        image = render_bounces(scene, (8, 8), "brute", max_bounces=bounces, min_weight=0.0)
        expected = np.array([1.0, 2.0, 4.0]) * (2.0 - 0.5**bounces)
        np.testing.assert_allclose(image.pixels, np.broadcast_to(expected, (8, 8, 3)), rtol=1e-5)
    ends = render_bounces(scene, (8, 8), "brute", max_bounces=9, min_weight=0.3)
    np.testing.assert_allclose(ends.pixels[4, 4], [1.5, 3.0, 6.0], rtol=1e-5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_diffuse_textures_are_looked_up_alike(rng, wrap):
    """Coordinates from -1 to 3 over a few texels, and a mesh without any."""
    bitmap = rng.integers(0, 256, (3, 5, 3)).astype(np.uint8)
    corners = np.array([[-1.0, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2]])
    texcoords = [[-1.0, -1], [3, -1], [3, 2.5], [-1, 2.5]]
    textured = rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]], texcoords=texcoords)
    plain = rs.Mesh(corners * 0.3 + [0, 0, -0.4], [[0, 1, 2], [0, 2, 3]])
    material = rs.Material(
        diffuse=(0.9, 0.8, 0.7), textures={"diffuse": rs.Texture(bitmap, wrap=wrap)}
    )
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=60.0)
    scene = rs.Scene([textured, plain], materials=[material], camera=camera)
    ours, theirs = pictures(scene, 0, structure="brute")
    assert differing(ours, theirs) == 0
    assert len(np.unique(theirs.pixels.reshape(-1, 3), axis=0)) > 100


LIGHTS = {
    "point": rs.PointLight((1.0, 2.0, 1.0), (5.0, 4.0, 3.0)),
    "steady": rs.PointLight((1.0, 2.0, 1.0), (0.5, 0.4, 0.3), falloff="none"),
    "sun": rs.DirectionalLight((-1.0, -3.0, -0.5), (2.0, 2.0, 1.0)),
    "sky": rs.EnvironmentLight((0.2, 0.3, 0.4)),
}


def test_lights_colours_normals_and_far_frames_are_those_of_the_renderer():
    """Several lights of each kind, glossy and coloured, far from the origin and small."""
    away = np.array([4000.0, -70.0, 900.0])
    base = [[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]]
    floor = rs.Mesh(
        base + away, [[0, 2, 1], [0, 3, 2]], colors=np.eye(4, 3), material_ids=np.zeros(2, int)
    )
    tilted = np.array([[-1.0, 1, 0.2], [1, 1, 0.2], [0, 1, -1]]) / np.sqrt([[2.04], [2.04], [2]])
    roof = rs.Mesh(
        np.array([[-1, 1, 0], [1, 1, 0], [0, 1.5, -1]]) * 0.5 + away,
        [[0, 1, 2]],
        normals=tilted,
        material_ids=np.ones(1, int),
    )
    glossy = rs.Material(diffuse=(0.5,) * 3, specular=(0.3,) * 3, shininess=20.0)
    mirror = rs.Material(diffuse=(0.3,) * 3, specular=(0.4,) * 3, reflection=(0.6,) * 3)

    def moved(light):
        if isinstance(light, rs.PointLight):
            return rs.PointLight(away + light.position, light.intensity, light.falloff)
        return light

    scene = rs.Scene(
        [floor, roof],
        materials=[glossy, mirror],
        lights=list(map(moved, LIGHTS.values())),
        camera=rs.Camera(tuple(away + [0.5, 2.0, 4.0]), tuple(away)),
        background=(0.1, 0.2, 0.3),
    )
    ours, theirs = pictures(scene, 2, structure="brute")
    assert differing(ours, theirs) <= 4
    assert len(np.unique(theirs.pixels.reshape(-1, 3), axis=0)) > 100


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (rs.Material(transmission=(0.5,) * 3), "transmits light"),
        (rs.Material(roughness=0.5), "has a roughness"),
        (rs.Material(opacity=0.5), "is not opaque"),
        (rs.Material(absorption=(1.0,) * 3), "absorbs light"),
        (rs.Material(textures={"bump": rs.Texture(np.zeros((1, 1, 3), np.uint8))}), "textures"),
    ],
)
def test_what_is_not_drawn_is_refused(material, message):
    from raystream.graphics import render_bounces

    mesh = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(ValueError, match=f"material 0 .* {message}"):
        render_bounces(rs.Scene([mesh], materials=[material]), (8, 8), "brute")


def test_options_are_those_of_the_renderer():
    from raystream.graphics import render_bounces

    with pytest.raises(ValueError, match="max_bounces: expected 0 to"):
        render_bounces(rs.Scene(), (8, 8), max_bounces=-1)
    with pytest.raises(TypeError, match="scene: expected a Scene"):
        render_bounces("cornell", (8, 8))
    image = render_bounces(rs.Scene(background=(0.5, 0.25, 1.0)), (4, 3), "brute")
    np.testing.assert_array_equal(image.pixels, np.broadcast_to([0.5, 0.25, 1.0], (3, 4, 3)))


def test_a_search_that_does_not_end_is_an_error_and_no_hang(monkeypatch):
    from dataclasses import replace

    from raystream.graphics import bounces, render_bounces
    from raystream.graphics.errors import GraphicsError

    shader_structure_of = bounces.shader_structure_of
    monkeypatch.setattr(
        bounces, "shader_structure_of", lambda one: replace(shader_structure_of(one), budget=3)
    )
    with pytest.raises(GraphicsError, match="took more than 3 steps and tests"):
        render_bounces(rs.load("cornell"), (16, 16), "brute")
