"""Pages of scenes without light, and with textures that shaders do not have."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from dark_views import DARK_VIEWS
from meshes import icosphere
from raystream.graphics.rendering.scene_buffers import light_samples, punctual_rows
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.view_light import USUAL_SIZE, decide
from raystream.web.export import _with_known_textures
from raystream.web.scene_data import page_scene
from web.pages import Exported, browser  # noqa: F401  a fixture


def test_the_light_at_the_eye_follows(browser, tmp_path):  # noqa: F811
    scene = rs.Scene.from_arrays(*icosphere(2))
    rs.export_page(scene, tmp_path / "ball.html", size=(96, 72))
    with Exported(browser, tmp_path / "ball.html") as page:
        page.wait_for_samples(8)
        before = page.light()[36, 48]
        page.run(
            "page => { page.view = {...page.view, yaw: page.view.yaw + Math.PI}; page.change(); }"
        )
        page.wait_for_samples(8)
        after = page.light()[36, 48]
        assert page.run("page => page.errorCount") == 0
        assert not page.problems
    assert before.min() > 0.1
    np.testing.assert_allclose(after, before, rtol=0.1)


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize("name", DARK_VIEWS)
def test_pages_have_the_lights_that_images_have_by_default(name):
    scene = DARK_VIEWS[name]()
    made = page_scene([rs.Tracer(scene)], scene.camera)
    for mode in ("raycast", "shadow", "whitted", "path"):
        renderer = RENDERERS[mode]
        samples = Sampler.of("sobol", 0, renderer.default_samples)
        options = renderer.check(renderer.complete({}))
        usual = decide(renderer, rs.Tracer(scene), None, USUAL_SIZE, samples, options)
        expected = light_samples(usual) if mode == "path" else punctual_rows(usual).ravel()
        np.testing.assert_array_equal(made.arrays[made.manifest["modes"][mode]["lights"]], expected)


def test_other_textures_are_left_out(tmp_path):
    texture = rs.Texture(np.full((2, 2, 3), 128, np.uint8))
    scene = rs.load("cornell")
    material = rs.Material(textures={"diffuse": texture, "specular": texture})
    scene = scene.replace(materials=[material, *scene.materials[1:]])
    with pytest.warns(rs.RaystreamWarning, match="left out those of specular"):
        rs.export_page(scene, tmp_path / "page.html", size=(8, 8))
    with pytest.raises(rs.RaystreamError, match="textures other than diffuse"):
        rs.export_page(rs.Tracer(scene), tmp_path / "page.html", size=(8, 8))


def test_what_glows_by_a_texture_has_its_mean():
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0] = 255, 188, 0
    glow = rs.Material(emission=(8.0, 4.0, 2.0), textures={"emission": rs.Texture(pixels)})
    scene = rs.load("cornell")
    scene = scene.replace(materials=[glow, *scene.materials[1:]])
    with pytest.warns(rs.RaystreamWarning, match="left out those of emission"):
        kept = _with_known_textures(scene)
    assert not kept.materials[0].textures
    np.testing.assert_allclose(kept.materials[0].emission, (2.0, 0.5, 0.0), rtol=0.01)
    assert kept.materials[1:] == scene.materials[1:]
