"""Pages of larger scenes, of public models, and of rays with many hits."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.scene.samples import SAMPLES
from raystream.structures import names_with
from raystream.web.export import _with_known_textures
from web.page_answers import assert_same_hits, first_hits, picture, rays_of
from web.pages import Exported, browser  # noqa: F401  a fixture

#: Scenes, and the share of rays that hit them at least.
SCENES = {"spheres": 0.3, "bunny": 0.1, "robots": 0.1, "kitchen": 0.1}

SIZE = (64, 48)

#: Levels of 255 by which rounding changes a pixel, and the share of pixels with rays along edges
#: or by many mirrors, which another structure or device changes more.
LEVELS, DIFFERING = 3, 0.03

MODES = ("raycast", "whitted")

#: Too slow for images, in software; robots are small on a grid of the whole city.
SLOW = {("bunny", "brute"), ("robots", "brute"), ("kitchen", "brute"), ("robots", "grid")}

#: Those of everyday tests.
EVERYDAY = {("bunny", "bvh"), ("robots", "bvh")}

CASES = [
    pytest.param(
        scene,
        structure,
        marks=[pytest.mark.exhaustive] * ((scene, structure) not in EVERYDAY),
    )
    for scene in SCENES
    for structure in names_with("graphics")
]


def load(name, request):
    """A scene as pages have it; skips without the public models, if it is one."""
    if name in SAMPLES:
        request.getfixturevalue("scenes_folder")
    return _with_known_textures(rs.load(name))


def export(scene, tmp_path, structures):
    path = tmp_path / "page.html"
    rs.export_page(scene, path, structures=structures, size=SIZE)
    return path


@pytest.mark.filterwarnings("ignore::raystream.RaystreamWarning")  # kitchen's textures
@pytest.mark.parametrize(("name", "structure"), CASES)
def test_each_structure(browser, tmp_path, request, name, structure):  # noqa: F811
    scene = load(name, request)
    structures = ["bvh", structure] if structure != "bvh" else ["bvh"]
    with Exported(browser, export(scene, tmp_path, structures), SIZE) as page:
        is_slow = (name, structure) in SLOW
        rays = rays_of(scene, 64 if is_slow else 500)
        assert_same_hits(page, scene, structure, rays, SCENES[name])
        if is_slow:
            return
        page.wait_for_samples(1)
        page.page.select_option("#structure", structure)
        for mode in MODES if name == "spheres" else MODES[:1]:
            assert_same_picture(page, scene, mode, samples=2)
            assert page.run("page => page.structure") == structure
        if name == "spheres":  # paths behind glass: more at once than there was room for at first
            script = "async (page, name) => (await page.rendererOf(name, 'whitted')).room"
            assert page.run(script, structure) > 2


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::raystream.RaystreamWarning")
@pytest.mark.parametrize("name", [name for name in SCENES if name != "spheres"])
def test_whitted(browser, tmp_path, request, name):  # noqa: F811
    scene = load(name, request)
    with Exported(browser, export(scene, tmp_path, ["bvh"]), SIZE) as page:
        page.wait_for_samples(1)
        assert_same_picture(page, scene, "whitted", samples=4)


def assert_same_picture(page, scene, mode, samples):
    """What the canvas shows is Python's image of the same samples."""
    page.page.select_option("#mode", mode)
    page.light_after(samples)
    assert page.run("page => page.mode") == mode
    width, height = page.run("page => page.size")
    camera = scene.camera_for(width / height)
    image = rs.render(scene, mode, (width, height), samples=samples, camera=camera)
    difference = np.abs(picture(page) - image.to_bytes()[..., :3].astype(np.int16))
    share = (difference > LEVELS).any(axis=2).mean()
    assert share < DIFFERING, f"{mode}: mean difference {difference.mean():.3f} levels"
    assert image.to_bytes().std() > 10


@pytest.mark.parametrize("structure", ["bvh", pytest.param("grid", marks=pytest.mark.exhaustive)])
def test_rays_with_many_hits(browser, tmp_path, structure):  # noqa: F811
    """All of them are listed: as many as no ray had before, and twice as many by the next."""
    count = 300
    z = np.arange(count, dtype=np.float32)
    corners = np.float32([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]])
    vertices = (corners + z[:, None, None] * np.float32([0, 0, -0.01])).reshape(-1, 3)
    scene = rs.Scene.from_arrays(vertices, np.arange(3 * count).reshape(-1, 3))
    script = """async (page, [structure, ray]) =>
        (await page.queriesOf(structure).allHits(Float64Array.from(ray))).primId"""
    with Exported(browser, export(scene, tmp_path, [structure]), SIZE) as page:
        half = [0.1, 0.2, -0.01 * (count / 2 - 0.5), 0.0, 0.0, -1.0]
        whole = [0.1, 0.2, 1.0, 0.0, 0.0, -1.0]
        aside = [9.0, 0.2, 1.0, 0.0, 0.0, -1.0]
        for ray, first in ((half, count // 2), (whole, 0), (half, count // 2)):
            assert page.run(script, [structure, ray]) == list(range(first, count))
        assert page.run(script, [structure, aside]) == []
        _, prim_id = first_hits(page, structure, (np.array([whole[:3]]), np.array([whole[3:]])))
        assert prim_id.tolist() == [0]
