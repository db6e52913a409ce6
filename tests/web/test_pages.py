"""Exported pages: their hits, images and controls, in a browser."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

import raystream as rs
from raystream.graphics.shader_source import shader_files
from raystream.structures import names_with
from raystream.web.scene_data import MODES
from web.page_answers import assert_same_hits, assert_same_light, rays_of
from web.pages import Exported, browser  # noqa: F401  a fixture

STRUCTURES = names_with("graphics")


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture(scope="module")
def path(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("pages") / "cornell.html"
    rs.export_page(scene, path, structures=STRUCTURES, size=(96, 72))
    return path


@pytest.fixture(scope="module")
def opened(browser, path):  # noqa: F811
    with Exported(browser, path) as page:
        page.wait_for_samples(1)
        yield page


@pytest.mark.parametrize("structure", STRUCTURES)
def test_hits_are_the_cpu_s(opened, scene, structure):
    assert_same_hits(opened, scene, structure, rays_of(scene))


@pytest.mark.parametrize("mode", MODES)
def test_images_are_the_cpu_s(opened, scene, mode):
    """Sample after sample: the same numbers, so the same noise."""
    opened.page.select_option("#mode", mode)
    opened.wait(f"raystream.opened.then(page => page.mode === '{mode}' && page.sample >= 2)")
    opened.run("page => { page.scene.samples = page.sample; }")
    opened.wait("raystream.opened.then(page => !page.isRunning)")
    count, size = opened.run("page => [page.sample, page.size]")
    light = opened.light()
    opened.run("page => { page.scene.samples = 256; }")
    camera = scene.camera_for(size[0] / size[1])
    image = rs.render(scene, mode, tuple(size), samples=count, camera=camera)
    close = np.isclose(light, image.pixels, rtol=2e-3, atol=2e-3).all(axis=2)
    assert close.mean() > 0.97
    assert light.mean() == pytest.approx(image.pixels.mean(), rel=0.01)
    assert light.std() > 0.05


def test_structures_have_one_image(opened):
    """Switching the structure begins the image again, with the same samples."""
    opened.page.select_option("#mode", "raycast")
    before = opened.light_after(2)
    for structure in STRUCTURES[::-1]:
        opened.page.select_option("#structure", structure)
        opened.wait(f"raystream.opened.then(page => page.structure === '{structure}')")
        assert_same_light(opened.light_after(2), before)


@pytest.fixture(scope="module")
def large(browser, path):  # noqa: F811
    with Exported(browser, path, (480, 360)) as page:
        page.wait_for_samples(1)
        yield page


def test_a_pixel_is_picked(large, scene):
    large.page.locator("#picture").click(position={"x": 240, "y": 180})
    large.wait("!document.getElementById('hits').hidden")
    ray = large.run("page => page.rayThrough(0.5, 0.5)")
    known = rs.Tracer(scene).multi_hit(ray[:3], ray[3:])
    rows = large.page.locator("#hits-list li").all_inner_texts()
    assert [int(re.match(r"triangle (\d+)", row)[1]) for row in rows] == known.prim_id.tolist()
    distances = [float(row.split(" at ")[1]) for row in rows]
    np.testing.assert_allclose(distances, known.t * np.linalg.norm(ray[3:]), rtol=1e-5)
    large.page.locator("#hits-close").click()
    assert large.page.locator("#hits").is_hidden()


def test_the_camera_moves_and_returns(large):
    large.page.locator("#picture").focus()
    before = large.run("page => page.camera.eye")
    large.page.keyboard.press("ArrowLeft")
    turned = large.run("page => page.camera.eye")
    assert not np.allclose(before, turned)
    large.page.mouse.move(240, 180)
    large.page.mouse.wheel(0, -200)
    large.wait("raystream.opened.then(page => page.view.distance < page.home.distance)")
    large.page.mouse.down()
    large.page.mouse.move(300, 200, steps=3)
    large.page.mouse.up()
    assert not np.allclose(turned, large.run("page => page.camera.eye"))
    large.wait_for_samples(1)
    large.page.locator("#home").click()
    np.testing.assert_allclose(large.run("page => page.camera.eye"), before)
    large.wait_for_samples(1)


def test_the_image_has_the_window_s_size(browser, path):  # noqa: F811
    """And is the same image when the window has its first size again."""
    with Exported(browser, path) as page:
        page.wait_for_samples(1)
        before = page.light_after(2)
        page.page.set_viewport_size({"width": 64, "height": 96})
        page.wait("raystream.opened.then(p => p.canvas.width === 64 && p.canvas.height === 96)")
        assert page.light_after(2).shape == (96, 64, 3)
        page.page.set_viewport_size({"width": 96, "height": 72})
        page.wait("raystream.opened.then(p => p.canvas.width === 96 && p.canvas.height === 72)")
        assert_same_light(page.light_after(2), before)


def lose_the_gpu(page):
    """Lose it; waits for an image by another."""
    page.run("page => { page.first = page.gpu; page.gpu.device.destroy(); }")
    page.wait("raystream.opened.then(p => p.gpu !== p.first && p.sample >= 2)")
    assert page.message == ""
    assert page.page.locator("#picture").is_visible()


def test_a_lost_gpu_is_opened_again(browser, path):  # noqa: F811
    """With the same image."""
    with Exported(browser, path) as page:
        page.wait_for_samples(1)
        before = page.light_after(2)
        lose_the_gpu(page)
        assert_same_light(page.light_after(2), before)


@pytest.mark.exhaustive
def test_a_gpu_that_is_lost_again_and_again(browser, path):  # noqa: F811
    """It is opened each time; after two losses without a sample between, on request."""
    with Exported(browser, path) as page:
        page.wait_for_samples(1)
        before = page.light_after(2)
        for _ in range(2):
            lose_the_gpu(page)
            assert_same_light(page.light_after(2), before)
        page.run(
            """page => {
                page.frame = async () => { page.gpu.device.destroy(); throw new Error("lost"); };
                page.change();
            }"""
        )
        page.wait("raystream.opened.then(page => page.isStopped && !page.isRunning)")
        assert "stopped again" in page.message
        assert page.page.locator("#preview").is_visible()
        page.run("page => { delete page.frame; }")
        page.page.select_option("#mode", "shadow")
        page.wait("raystream.opened.then(p => p.mode === 'shadow' && p.sample >= 1)")
        assert page.message == ""
        assert page.page.locator("#preview").is_hidden()


def test_without_webgpu_the_page_shows_its_image_and_says_so(browser, path):  # noqa: F811
    before = "Object.defineProperty(Navigator.prototype, 'gpu', {get: () => undefined});"
    with Exported(browser, path, before=before) as page:
        page.wait("!document.getElementById('message').hidden")
        assert "no WebGPU" in page.message
        assert page.page.locator("#preview").is_visible()
        assert page.page.evaluate("document.getElementById('preview').naturalWidth") == 96
        assert page.page.locator("#controls").is_hidden()


@pytest.mark.parametrize("kind", ["truncated", "changed"])
def test_damaged_data_is_named(browser, path, tmp_path, kind):  # noqa: F811
    text = path.read_text()
    start = text.index(">", text.index('id="data"')) + 1
    end = text.index("</script>", start)
    data = text[start:end]
    middle = len(data) // 2
    other = (
        data[: middle // 4 * 4]
        if kind == "truncated"
        else (data[:middle] + ("A" if data[middle] != "A" else "B") + data[middle + 1 :])
    )
    broken = tmp_path / "broken.html"
    broken.write_text(text[:start] + other + text[end:])
    with Exported(browser, broken) as page:
        page.wait("!document.getElementById('message').hidden")
        assert "incomplete or damaged" in page.message
        assert page.page.locator("#preview").is_visible()


def test_nothing_else_is_asked_for(opened, path):
    assert opened.requests[0] == path.as_uri()
    assert all(one.startswith(("data:", "blob:")) for one in opened.requests[1:])
    policy = opened.page.locator("meta[http-equiv]").get_attribute("content")
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy


def test_the_shaders_are_the_package_s(opened):
    """The same files: no shader stands twice."""
    shipped = opened.run("page => page.scene.shaders")
    folder = Path(rs.__file__).parent / "graphics" / "shaders"
    for name, text in shipped.items():
        known = hashlib.sha256((folder / name).read_bytes()).digest()
        assert hashlib.sha256(text.encode()).digest() == known, name
    wanted = {"compute.wgsl", "rendering/compute.wgsl", "rendering/path.wgsl", "bvh.wgsl"}
    assert set(shipped) >= set(shader_files(wanted))
    assert not list((folder.parents[1] / "web").rglob("*.wgsl"))
