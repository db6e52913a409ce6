"""Pages of scenes without light, and with textures that shaders do not have."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere
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


def test_other_textures_are_left_out(tmp_path):
    texture = rs.Texture(np.full((2, 2, 3), 128, np.uint8))
    scene = rs.load("cornell")
    material = rs.Material(textures={"diffuse": texture, "specular": texture})
    scene = scene.replace(materials=[material, *scene.materials[1:]])
    with pytest.warns(rs.RaystreamWarning, match="left out those of specular"):
        rs.export_page(scene, tmp_path / "page.html", size=(8, 8))
    with pytest.raises(rs.RaystreamError, match="textures beside diffuse"):
        rs.export_page(rs.Tracer(scene), tmp_path / "page.html", size=(8, 8))
