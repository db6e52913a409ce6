"""The viewer's device "this browser": the page traces what the server would render."""

from __future__ import annotations

import time
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from viewer.browser import Viewer, serving
from web.pages import browser  # noqa: F401  a fixture

#: A small image beside the controls.
WINDOW = {"viewport": {"width": 768, "height": 160}}
SAMPLES = 4
FRAGMENT = f"#samples={SAMPLES}"

#: Hides what lies on the image, which shows that of the browser or else the server's.
BARE = """() => {
  for (const one of document.querySelectorAll("#stage > *:not(canvas), #toasts")) {
    one.style.visibility = "hidden";
  }
}"""

#: Keeps the devices of the GPU that the page opens.
KEPT = """
  globalThis.devices = [];
  globalThis.isBroken = false;
  const request = GPUAdapter.prototype.requestDevice;
  GPUAdapter.prototype.requestDevice = async function (...options) {
    const device = await request.apply(this, options);
    devices.push(device);
    if (isBroken) device.destroy();
    return device;
  };
"""


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture(scope="module")
def address():
    with serving("cornell") as address:
        yield address


@pytest.fixture
def viewer(browser, address):  # noqa: F811
    viewer = Viewer(browser, address, FRAGMENT, **WINDOW)
    viewer.page.evaluate(BARE)
    yield viewer
    viewer.close()


def choose_browser(viewer: Viewer) -> None:
    viewer.page.select_option("select[name=device]", "browser")


def says(viewer: Viewer) -> str:
    """What the page says of this device."""
    return str(viewer.page.locator("#device-says").text_content())


def wait_until_it_says(viewer: Viewer, text: str) -> None:
    viewer.wait(lambda: text in says(viewer), text)


def traced(viewer: Viewer, samples: int = SAMPLES) -> np.ndarray:
    """The image, once the browser has traced it."""
    canvas = viewer.page.locator("#traced")
    viewer.wait(
        lambda: canvas.is_visible() and canvas.get_attribute("data-samples") == str(samples),
        "an image",
    )
    return shown(viewer)


def shown(viewer: Viewer) -> np.ndarray:
    """The pixels of the image on the screen."""
    box = viewer.page.locator("#picture").bounding_box()
    viewer.page.evaluate("document.activeElement.blur()")  # else it has an outline
    return pixels(viewer.page.screenshot(clip=box))


def rendered(viewer: Viewer, scene: rs.Scene) -> np.ndarray:
    """The image as the server renders it, with the last settings and camera."""
    camera, settings = viewer.camera, viewer.last("settings")
    size = [one for one in viewer.sent if one["type"] == "size"][-1]
    seen = rs.Camera(**{name: camera[name] for name in ("eye", "look_at", "up", "fov")})
    bounces = settings["max_bounces"]
    image = rs.render(
        scene,
        settings["mode"],
        (size["width"], size["height"]),
        samples=settings["samples"],
        camera=seen,
        **({} if bounces is None else {"max_bounces": bounces}),
    )
    return image.to_bytes(settings["exposure"]).astype(np.int16)


def saved(viewer: Viewer) -> np.ndarray:
    """The image that the page saves."""
    with viewer.page.expect_download() as download:
        viewer.page.locator("#picture").press("p")
    return pixels(Path(download.value.path()).read_bytes())


def pixels(file: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(file)).convert("RGB"), dtype=np.int16)


def assert_same(image: np.ndarray, other: np.ndarray, within: int = 2, share: float = 0.99) -> None:
    assert image.shape == other.shape
    assert image.std() > 10
    same = (abs(image - other) <= within).all(axis=2)
    assert same.mean() > share


def move(viewer: Viewer, how: Any) -> np.ndarray:
    """The image that the browser traces after a movement of the camera."""
    before = traced(viewer)
    how()
    viewer.wait(lambda: (shown(viewer) != before).any(), "another image")
    viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    return traced(viewer)


def test_the_server_and_the_browser_show_the_same_and_the_camera_stays(viewer, scene):
    viewer.wait_for_rest()
    by_server = shown(viewer)
    choose_browser(viewer)
    image = traced(viewer)
    assert says(viewer).startswith("Traced by ")
    assert_same(image, rendered(viewer, scene))
    assert_same(image, by_server, within=12)  # a JPEG
    assert_same(image, saved(viewer), within=0, share=0.9999)
    outline = "getComputedStyle(document.getElementById('traced')).outlineStyle"
    assert viewer.page.evaluate(outline) == "solid"  # of the focused image below
    start = viewer.camera
    turned = move(viewer, lambda: viewer.drag((0.5, 0.5), (0.6, 0.45), steps=1))
    assert (abs(turned - image) > 8).mean() > 0.05
    assert viewer.camera["eye"] != start["eye"]
    assert_same(turned, rendered(viewer, scene))
    there = viewer.camera
    count = len(viewer.messages)
    viewer.page.select_option("select[name=device]", "cpu")
    viewer.page.locator("#traced").wait_for(state="hidden")
    viewer.wait(
        lambda: any(one["type"] == "frame" for one in viewer.messages[count:]), "the server's frame"
    )
    viewer.wait_for_rest()
    assert_same(shown(viewer), turned, within=12)
    assert viewer.camera["eye"] == there["eye"]


#: From now on the first sample of an image has bands of few pixels, and pauses after one of them.
PAUSED = """async () => {
  const {ImageRenderer} = await import(new URL("page/images.js", document.baseURI));
  const {trace} = ImageRenderer.prototype;
  globalThis.isPaused = false;
  ImageRenderer.prototype.trace = async function (sample, first) {
    this.size.size = Math.min(this.size.size, 1024);
    if (first && !sample) {
      isPaused = true;
      await new Promise(done => { globalThis.goOn = done; });
      ImageRenderer.prototype.trace = trace;
    }
    return trace.call(this, sample, first);
  };
}"""


def test_a_saved_image_has_one_view(viewer, scene):
    """Also while the first sample of another view is traced; errors are messages."""
    choose_browser(viewer)
    before = traced(viewer)
    viewer.page.evaluate(PAUSED)
    viewer.page.locator("#picture").press("+")
    viewer.wait(lambda: viewer.page.evaluate("isPaused"), "a part of another view")
    with viewer.page.expect_download() as download:
        viewer.page.locator("#picture").press("p")
        time.sleep(0.3)
        viewer.page.evaluate("goOn()")
    image = pixels(Path(download.value.path()).read_bytes())
    after = traced(viewer)
    height = len(before)
    for part in (slice(0, height // 3), slice(height // 2, height)):
        assert abs(image[part] - after[part]).mean() < 0.5 * abs(image[part] - before[part]).mean()
    viewer.page.evaluate("void (HTMLCanvasElement.prototype.toBlob = done => done(null))")
    viewer.page.locator("#picture").press("p")
    said = viewer.page.locator(".toast", has_text="could not make a file of the image")
    said.wait_for(state="attached")  # it is hidden here


def test_the_server_rests_while_the_browser_traces_and_picks_for_it(viewer, scene):
    viewer.wait_for_rest()
    choose_browser(viewer)
    traced(viewer)
    assert viewer.sent[-1] == {"type": "pause", "paused": True}
    count = len(viewer.messages)
    viewer.page.evaluate("document.getElementById('hits').style.visibility = ''")
    viewer.page.mouse.click(*viewer.place(0.6, 0.6))
    viewer.page.locator("#hits tbody tr").first.wait_for()
    hits = viewer.last("hits")
    known = rs.Tracer(scene).multi_hit([hits["origin"]], [hits["direction"]])
    assert [one["prim_id"] for one in hits["hits"]] == known.prim_id.tolist()
    assert not [one for one in viewer.messages[count:] if one["type"] == "frame"]


@pytest.mark.exhaustive
def test_exposure_bounces_and_samples_are_the_server_s(viewer, scene):
    choose_browser(viewer)
    plain = traced(viewer)
    viewer.page.locator("input[name=exposure]").fill("1")
    viewer.wait(lambda: viewer.last("settings")["exposure"] == 2.0, "twice the light")
    viewer.wait(lambda: shown(viewer).mean() > 1.2 * plain.mean(), "a brighter image")
    assert_same(shown(viewer), rendered(viewer, scene))
    viewer.page.select_option("select[name=mode]", "path")
    viewer.page.fill("input[name=samples]", "1")
    viewer.page.keyboard.press("Enter")
    viewer.wait(lambda: viewer.last("settings")["samples"] == 1, "one sample")
    image = traced(viewer, 1)
    assert_same(image, rendered(viewer, scene), share=0.97)
    viewer.page.fill("input[name=max_bounces]", "1")
    viewer.page.keyboard.press("Enter")
    viewer.wait(lambda: viewer.last("settings")["max_bounces"] == 1, "one bounce")
    viewer.wait(
        lambda: viewer.page.locator("#traced").is_visible() and (shown(viewer) != image).any(),
        "another image",
    )
    assert_same(shown(viewer), rendered(viewer, scene), share=0.97)


def test_the_server_renders_what_browsers_do_not_trace(viewer):
    choose_browser(viewer)
    traced(viewer)
    canvas = viewer.page.locator("#traced")
    viewer.page.select_option("select[name=mode]", "kajiya")
    canvas.wait_for(state="hidden")
    assert says(viewer) == "Browsers cannot trace mode kajiya. The server renders."
    viewer.wait(lambda: viewer.last("settings")["mode"] == "kajiya", "the mode")
    viewer.wait_for_rest()
    option = viewer.page.locator("select[name=device] option[value=browser]")
    assert option.text_content() == "This browser (unavailable)"
    viewer.page.select_option("select[name=mode]", "raycast")
    traced(viewer)
    assert option.text_content() == "This browser"
    viewer.page.locator("#picture").press("o")
    canvas.wait_for(state="hidden")
    assert says(viewer) == "Orthographic views cannot be traced by browsers. The server renders."
    viewer.wait_for_rest()
    viewer.page.locator("#picture").press("o")
    canvas.wait_for()
    viewer.page.select_option("select[name=heatmap]", "steps")
    canvas.wait_for(state="hidden")
    assert says(viewer) == "Browsers cannot trace heat maps. The server renders."


@pytest.mark.exhaustive
def test_a_structure_is_loaded_when_it_is_chosen(viewer):
    asked = []
    viewer.page.on("request", lambda one: asked.append(one.url.rsplit("/", 1)[1]))
    viewer.choose("structure", "kdtree")
    viewer.wait_for_rest()
    assert "scene" not in asked
    choose_browser(viewer)
    image = traced(viewer)
    assert asked.count("scene") == 1
    viewer.page.select_option("select[name=structure]", "grid")
    viewer.wait(lambda: asked.count("scene") == 2, "the grid")
    assert_same(traced(viewer), image)
    viewer.page.select_option("select[name=mode]", "shadow")
    viewer.wait(lambda: viewer.last("settings")["mode"] == "shadow", "the mode")
    viewer.wait(lambda: (shown(viewer) != image).any(), "another image")
    assert asked.count("scene") == 2


def test_a_scene_that_is_not_supported_says_so(browser):  # noqa: F811
    scene = rs.Scene.spheres([[0.0, 0.0, 0.0]], 1.0)
    with rs.view(scene) as served:
        viewer = Viewer(browser, served.url, FRAGMENT, **WINDOW)
        viewer.wait(lambda: [m for m in viewer.messages if m["type"] == "structure"], "a structure")
        reason = "The shaders of pages do not support spheres, height fields and shapes."
        choose_browser(viewer)
        wait_until_it_says(viewer, f"{reason} The server renders.")
        viewer.wait_for_rest()
        assert viewer.page.locator("#traced").is_hidden()
        option = viewer.page.locator("select[name=device] option[value=browser]")
        assert option.get_attribute("title") == reason
        viewer.close()


def test_without_webgpu_the_page_says_so_and_the_server_renders(browser, address):  # noqa: F811
    before = "Object.defineProperty(Navigator.prototype, 'gpu', {get: () => undefined});"
    viewer = Viewer(browser, address, f"{FRAGMENT}&device=browser", before=before, **WINDOW)
    wait_until_it_says(viewer, "This browser has no WebGPU. The server renders.")
    viewer.wait_for_rest()
    with viewer.changing_picture():
        viewer.drag((0.5, 0.5), (0.6, 0.45), steps=1)
    viewer.close()


@pytest.mark.exhaustive
def test_a_view_may_change_before_the_first_image(browser, address, scene):  # noqa: F811
    viewer = Viewer(browser, address, f"{FRAGMENT}&device=browser", before=KEPT, **WINDOW)
    viewer.page.evaluate(BARE)
    viewer.wait(lambda: viewer.page.evaluate("devices.length"), "a device")
    time.sleep(0.3)  # the image has begun, and shaders are compiled
    before = viewer.camera
    viewer.page.locator("#picture").press("+")
    viewer.wait(lambda: viewer.camera["eye"] != before["eye"], "another view")
    assert viewer.page.locator("#traced").is_hidden()
    assert_same(traced(viewer), rendered(viewer, scene))
    viewer.close()


@pytest.mark.exhaustive
def test_a_lost_gpu_is_opened_again_and_given_up_the_second_time(browser, address):  # noqa: F811
    viewer = Viewer(browser, address, f"{FRAGMENT}&device=browser", before=KEPT, **WINDOW)
    traced(viewer)
    viewer.page.evaluate("devices[0].destroy()")
    viewer.toast("The GPU stopped; this page starts it again.")
    viewer.wait(lambda: viewer.page.evaluate("devices.length") == 2, "another device")
    viewer.wait(lambda: viewer.page.locator(".toast").count() == 1, "one message")
    traced(viewer)
    viewer.page.evaluate("isBroken = true; devices[1].destroy()")
    wait_until_it_says(viewer, "The GPU stopped again.")
    assert viewer.page.locator("#traced").is_hidden()
    with viewer.changing_picture():
        viewer.page.locator("#picture").press("+")
    viewer.page.evaluate("isBroken = false")
    viewer.page.select_option("select[name=mode]", "shadow")
    traced(viewer)
    viewer.problems.clear()  # the browser's warnings of the destroyed devices
    viewer.close()
