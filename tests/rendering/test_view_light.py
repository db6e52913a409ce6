"""Lights that are added where a scene's own do not reach what the camera sees."""

from __future__ import annotations

import inspect
import warnings

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits, tier
from dark_views import DARK_VIEWS, box, closed_room, far_lamp
from raystream.rendering import view_light
from raystream.rendering.contexts import make_context, seen_by
from raystream.rendering.lighting import ADDED, needs_light
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.tone import auto_exposure

SIZE = (32, 24)


@pytest.mark.parametrize("make", [closed_room, far_lamp])
@pytest.mark.parametrize("mode", ["shadow", "whitted", "kajiya", "path"])
def test_a_view_in_the_dark_gets_light(make, mode):
    scene = make()
    assert not needs_light(scene)  # the lights suffice elsewhere
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dark = rs.render(scene, mode, SIZE, 16, lights="file")
    assert np.median(dark.pixels) < 0.01
    with pytest.warns(rs.RaystreamWarning, match="do not reach what the camera sees: added"):
        image = rs.render(scene, mode, SIZE, 16)
    assert np.quantile(image.pixels.max(axis=2), 0.05) > 0.03
    insisted = rs.render(scene, mode, SIZE, 16, lights="added")
    np.testing.assert_array_equal(image.pixels, insisted.pixels)


def test_a_room_without_lights_gets_one_that_reaches_it():
    """The sky stays outside."""
    scene = closed_room().replace(lights=())
    assert needs_light(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # there is no light that does not suffice
        image = rs.render(scene, "path", SIZE, 16)
    assert np.quantile(image.pixels.max(axis=2), 0.05) > 0.03
    insisted = rs.render(scene, "path", SIZE, 16, lights="added")
    np.testing.assert_array_equal(image.pixels, insisted.pixels)


@pytest.mark.parametrize("mode", ADDED)
@pytest.mark.parametrize(
    "name",
    [
        "cornell",
        *(pytest.param(n, marks=pytest.mark.ci) for n in ("robots", "spheres", "building")),
    ],
)
def test_views_that_are_lit_are_left_alone(name, mode):
    scene = rs.load(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image = rs.render(scene, mode, SIZE, 1)
    own = rs.render(scene, mode, SIZE, 1, lights="file")
    np.testing.assert_array_equal(image.pixels, own.pixels)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("options", [{"preset": "arnold"}, {"light_samples": False}])
def test_paths_that_find_lights_by_chance_leave_a_lit_view_alone(options, seed):
    """One sample of them hits the lamp too rarely to judge by."""
    scene, options = rs.load("cornell"), {**options, "max_bounces": 2, "seed": seed}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image = rs.render(scene, "path", (17, 9), 1, **options)
    own = rs.render(scene, "path", (17, 9), 1, lights="file", **options)
    np.testing.assert_array_equal(image.pixels, own.pixels)


@pytest.mark.parametrize("lights", ["auto", "added"])
def test_lights_that_are_added_follow_the_camera(lights):
    """Another view of a context is the image of that view."""
    scene = rs.Scene([box(2.0)], camera=rs.Camera((3.0, 2.0, 4.0), (0, 0, 0)))
    back = rs.Camera((-4.0, 2.0, -3.0), (0, 0, 0))
    renderer, one = RENDERERS["path"], Sampler.of("sobol", 0, 1)
    options = renderer.check(renderer.complete({}))
    context = make_context(rs.Tracer(scene), scene.camera, SIZE, one, options, (), lights)
    assert context.is_light_added
    light, _ = trace_sample(renderer, seen_by(context, back), 0)
    expected = rs.render(scene, "path", SIZE, 1, camera=back, lights=lights).pixels
    np.testing.assert_array_equal(light.reshape(expected.shape), expected)
    assert expected.max() > 0.3  # its sunny side is seen


def test_the_choice_is_the_same_on_all_structures_and_threads():
    scene = far_lamp()
    expected = rs.render(scene, "path", SIZE, 4, lights="added").pixels
    for structure in ("brute", "kdtree"):
        with pytest.warns(rs.RaystreamWarning, match="do not reach"):
            found = rs.render(scene, "path", SIZE, 4, structure).pixels
        np.testing.assert_array_equal(found, expected)


def decided(tracer, mode="shadow", size=SIZE):
    renderer = RENDERERS[mode]
    options, samples = renderer.check(renderer.complete({})), Sampler.of("sobol", 0, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RaystreamWarning)
        return view_light.decide(renderer, tracer, None, size, samples, options)


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize(
    ("name", "mode"),
    [
        pytest.param(name, mode, marks=tier(is_everyday=mode == "shadow"))
        for name in DARK_VIEWS
        for mode in ("shadow", "whitted", "kajiya", "path")
    ],
)
def test_passes_show_what_one_program_does(name, mode):
    """Images by the defaults, on a machine whose queries take thousands of passes."""
    scene = DARK_VIEWS[name]()
    branching, passes = (
        rs.render(rs.Tracer(scene, "grid", machine=machine), mode, SIZE, 2)
        for machine in ("branching", "multipass")
    )
    assert passes.figures["passes"]["eye rays"] >= 2  # in one loop, but for the trial
    assert_same_bits(passes.pixels, branching.pixels)
    assert np.median(passes.pixels) > 0.01


def test_brute_force_of_many_triangles_is_not_what_decides(monkeypatch):
    scene, traced = rs.load("spheres"), []
    assert len(scene.triangles) > 8
    monkeypatch.setattr(view_light, "_MOST_BY_BRUTE_FORCE", 8)
    shows = view_light._shows
    monkeypatch.setattr(
        view_light,
        "_shows",
        lambda renderer, seen: traced.append(seen.tracer) or shows(renderer, seen),
    )
    for structure in ("brute", "grid"):
        tracer = rs.Tracer(scene, structure)
        context = decided(tracer)
        assert context.tracer is tracer
        assert context.bands is None
    assert [one.structure.name for one in traced] == ["bvh", "grid"]


def test_there_is_no_trial_that_changes_nothing(monkeypatch):
    """Of a scene without lights, which gets a light at the eye anyway; or by request."""
    monkeypatch.setattr(view_light, "_shows", None)
    scene = DARK_VIEWS["unlit_room"]()
    for mode in ("raycast", "shadow", "whitted"):
        image = rs.render(scene, mode, SIZE)
        assert_same_bits(image.pixels, rs.render(scene, mode, SIZE, lights="added").pixels)
    for lights in ("file", "added"):
        rs.render(closed_room(), "shadow", SIZE, lights=lights)
    rs.render(closed_room(), "vis", SIZE)


def test_pages_and_the_viewer_decide_for_the_default_size():
    assert inspect.signature(rs.render).parameters["size"].default == view_light.USUAL_SIZE
    scene = DARK_VIEWS["unlit_room"]().replace(camera=None)
    context = decided(rs.Tracer(scene), size=(40, 20))
    assert context.camera == scene.camera_for(2.0)


def test_lights_that_are_off_and_empty_views_stay_dark():
    scene = closed_room().replace(lights=[rs.PointLight((0, 0, 0), (0.0, 0.0, 0.0))])
    assert not rs.render(scene, "path", SIZE, 4).pixels.any()
    away = rs.Camera((0.0, 0.0, 50.0), (0.0, 0.0, 90.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not rs.render(closed_room(), "whitted", SIZE, camera=away).pixels.any()


@pytest.mark.parametrize("mode", ["raycast", "shadow", "whitted"])
def test_rough_metal_reflects_its_surroundings(mode):
    """Without highlights it shows the ambient light, and half of what others give."""
    floor = rs.Mesh([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])
    metal = rs.Material(diffuse=(1.0, 0.8, 0.2), roughness=0.5, metallic=1.0)
    view = rs.Camera((0, 5, 5), (0, 0, 0))
    sky = rs.Scene(
        [floor], materials=[metal], lights=[rs.EnvironmentLight((0.5, 0.5, 1.0))], camera=view
    )
    seen = rs.render(sky, mode, SIZE).pixels[20, 16]
    np.testing.assert_allclose(seen, (0.5, 0.4, 0.2), rtol=1e-5)
    # A sun that grazes it leaves no highlight in view; a white surface would show 1 / pi of it.
    sun = rs.DirectionalLight((1.0, -1e-3, 0.0), (np.pi, np.pi, np.pi))
    lit = rs.render(sky.replace(lights=[sun]), mode, SIZE).pixels[20, 16]
    np.testing.assert_allclose(lit, (0.5, 0.4, 0.1), atol=0.02)


# Exposure


def test_automatic_exposure_shows_dim_and_bright_images():
    rng = np.random.default_rng(1)
    image = rs.Image(rng.uniform(0.2, 1.0, (24, 32, 3)))
    usual = image.to_bytes("auto")
    for factor in (1e-6, 1e-2, 300.0, 1e9):
        scaled = rs.Image(image.pixels * np.float32(factor))
        assert np.abs(scaled.to_bytes("auto").astype(int) - usual).max() <= 1
    assert 100 < usual.mean() < 240


def test_a_lamp_in_view_does_not_darken_the_room():
    pixels = np.full((100, 100, 3), 0.02)
    pixels[:20, :20] = 50.0  # a twenty-fifth of the image
    factor = auto_exposure(pixels)
    np.testing.assert_allclose(0.02 * factor, 0.18, rtol=0.5)
    pixels[50:] = 0.0  # black does not count
    np.testing.assert_allclose(auto_exposure(pixels) / factor, 1.0, rtol=0.5)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_images_that_show_nothing_have_a_usable_exposure(value):
    factor = auto_exposure(np.full((4, 4, 3), value))
    assert factor == 1.0
    with pytest.raises(ValueError, match="exposure: expected a number above 0 or 'auto'"):
        rs.Image(np.zeros((2, 2, 3))).to_bytes("bright")
