"""The viewer's page, in a browser: all settings, and rarer actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import raystream as rs
from raystream.structures import STRUCTURES
from viewer.browser import Viewer, chromium, serving  # noqa: F401  a fixture
from viewer.test_page import TRIANGLE, check_hits

pytestmark = pytest.mark.exhaustive

MODES = ("raycast", "vis", "shadow", "whitted", "xray", "ao", "kajiya", "path")
TRAVERSALS = ("stack", "restart", "backtrack", "short-stack")

#: Makes a drop of a file of some text, as a browser would.
DROP = """(target, [name, text]) => {
  const transfer = new DataTransfer();
  transfer.items.add(new File([text], name));
  for (const type of ["dragenter", "dragover", "drop"]) {
    const how = {dataTransfer: transfer, bubbles: true, cancelable: true};
    target.dispatchEvent(new DragEvent(type, how));
  }
}"""

#: Runs camera mathematics of the page's module, there.
TURNED = """async () => {
  const view = await import("/page/view.js");
  const worlds = [[0, 1, 0], [0, 0, 1]];
  const found = [];
  for (const up of worlds) {
    const world = view.worldOf(up, 4);
    for (const projection of ["perspective", "orthographic"]) {
      const camera = {eye: [3, 2, 4], look_at: [1, 0, 0], up, fov: 50, projection, height: 3};
      const start = view.fromCamera(camera, world, 1.5);
      const point = view.pointAt(start, 0.8, 0.3);
      let steepest = start;
      for (let step = 0; step < 40; step++) steepest = view.orbit(steepest, 0.01, 0.1);
      const picked = view.lookAt(start, [0, 0, 1]);
      const framed = view.frame(view.facing(start, "top"), [-1, -2, -3], [4, 5, 6]);
      found.push({
        up, camera, again: view.toCamera(start),
        place: view.place(start, point), zoomed: view.place(view.zoom(start, 0.5, 0.8, 0.3), point),
        panned: view.place(view.pan(start, 0.1, -0.2), start.target),
        steepest: view.toCamera(steepest), picked: view.toCamera(picked),
        corners: [0, 1, 2, 3, 4, 5, 6, 7].map(corner => view.place(framed, [
          corner & 1 ? 4 : -1, corner & 2 ? 5 : -2, corner & 4 ? 6 : -3])),
        looked: view.eyeOf(view.look(start, 0.2, 0.1)),
        halfway: view.toCamera(view.between(start, picked, 1)),
      });
    }
  }
  return found;
}"""


@pytest.fixture(scope="module")
def address():
    with serving("cornell") as address:
        yield address


@pytest.fixture
def viewer(chromium, address):  # noqa: F811
    viewer = Viewer(chromium, address)
    yield viewer
    viewer.close()


def options_of(viewer: Viewer, name: str) -> list[str]:
    """The options of a select element."""
    options = viewer.page.locator(f"select[name={name}] option").all()
    return [option.get_attribute("value") for option in options]


def test_every_mode_with_every_structure(viewer):
    assert set(options_of(viewer, "mode")) == set(MODES)
    assert set(options_of(viewer, "structure")) == set(STRUCTURES)
    pictures: dict[str, set[str]] = {}
    for structure in STRUCTURES:
        viewer.choose("structure", structure)
        for mode in MODES:
            viewer.choose("mode", mode)
            pictures.setdefault(mode, set()).add(viewer.wait_for_rest())
    # The same image from every structure, and another one from each mode; but nothing here
    # mirrors, so that shadow and whitted agree.
    assert {mode: len(found) for mode, found in pictures.items()} == dict.fromkeys(MODES, 1)
    assert pictures.pop("shadow") == pictures["whitted"]
    assert len(set.union(*pictures.values())) == len(MODES) - 1


def test_every_traversal_and_machine(viewer):
    viewer.choose("structure", "kdtree")
    assert set(options_of(viewer, "traversal")) == set(TRAVERSALS)
    first = viewer.wait_for_rest()
    for traversal in TRAVERSALS:
        viewer.choose("traversal", traversal)
        assert viewer.wait_for_rest() == first
    viewer.choose("machine", "multipass")
    for scheduler in options_of(viewer, "scheduler"):
        viewer.choose("scheduler", scheduler)
        assert viewer.wait_for_rest() == first
    viewer.choose("structure", "bvh")
    assert not viewer.page.locator("select[name=traversal]").is_visible()


@pytest.mark.parametrize("heatmap", ["cells", "tests", "steps"])
def test_heat_maps_have_a_legend(viewer, heatmap):
    viewer.wait_for_rest()
    with viewer.changing_picture():
        viewer.choose("heatmap", heatmap)
    legend = viewer.page.locator("#legend")
    legend.wait_for()
    viewer.page.fill("input[name=maximum]", "7")
    viewer.page.keyboard.press("Enter")
    viewer.page.locator("#legend-top", has_text="7").wait_for()
    assert viewer.last("settings")["maximum"] == 7
    viewer.page.locator("summary", has_text="Counters").click()
    viewer.page.locator("#counters dd").first.wait_for()
    viewer.choose("heatmap", "")
    legend.wait_for(state="hidden")


def test_tone_exposure_and_bounces(viewer):
    page = viewer.page
    viewer.wait_for_rest()
    with viewer.changing_picture():
        page.locator("input[name=exposure]").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
    assert viewer.last("settings")["exposure"] == pytest.approx(2**0.5)
    with viewer.changing_picture():
        viewer.choose("tone", "reinhard")
    assert not page.locator("input[name=max_bounces]").is_visible()
    viewer.choose("mode", "path")
    viewer.wait_for_rest()
    with viewer.changing_picture():
        page.fill("input[name=max_bounces]", "0")
        page.keyboard.press("Enter")
    assert page.locator("input[name=max_bounces]").input_value() == "0"


def test_a_drop_opens_a_model(viewer):
    page = viewer.page
    page.locator("#picture").evaluate(DROP, ["dropped.ply", TRIANGLE])
    page.locator("#scene-name", has_text="dropped.ply").wait_for()
    assert viewer.last("scene")["triangles"] == 1
    page.locator("#first-scene").click()
    page.locator("#scene-name", has_text="cornell").wait_for()


def test_keys_alone_do_everything(viewer):
    page = viewer.page
    scene = viewer.last("scene")
    viewer.wait_for_rest()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "picture"
    for key in "wasdqe":
        before = viewer.camera
        page.keyboard.down(key)
        viewer.wait(lambda before=before: viewer.camera["eye"] != before["eye"], f"a walk by {key}")
        page.keyboard.up(key)
        viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    before = viewer.camera
    page.keyboard.down("ArrowLeft")
    viewer.wait(lambda: viewer.camera["look_at"] != before["look_at"], "a turn")
    page.keyboard.up("ArrowLeft")
    for key in ("1", "2", "3", "+", "f"):
        before = viewer.camera
        page.keyboard.press(key)
        viewer.wait(lambda before=before: viewer.camera["eye"] != before["eye"], f"a view by {key}")
        viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    page.keyboard.press("o")
    viewer.wait(lambda: viewer.camera["projection"] == "orthographic", "parallel rays")
    page.keyboard.press("h")
    viewer.wait(lambda: viewer.camera["projection"] == "perspective", "the scene's view")
    viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    np.testing.assert_allclose(viewer.camera["eye"], scene["camera"]["eye"], rtol=1e-9)
    page.keyboard.press("x")
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    check_hits(viewer, rs.load("cornell"))
    pick = [one for one in viewer.sent if one["type"] == "pick"][-1]
    assert (pick["x"], pick["y"]) == pytest.approx((0.55, 0.51))
    page.keyboard.press("Escape")
    assert not page.locator("#hits").is_visible()
    page.keyboard.press("z")
    point = viewer.last("hits")["hits"][0]["position"]
    viewer.wait(lambda: np.allclose(viewer.camera["look_at"], point), "a new centre")
    page.keyboard.press("?")
    page.locator("#help").wait_for()
    page.keyboard.press("Escape")
    page.locator("#help").wait_for(state="hidden")
    with page.expect_download():
        page.keyboard.press("p")
    page.keyboard.press("c")
    page.locator("#controls").wait_for(state="hidden")


def test_every_control_can_be_reached_and_has_a_name(viewer):
    page = viewer.page
    page.locator("#picture").focus()
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.name"))
    wanted = {"home", "frame-all", "aim", "screenshot", "help-open", "controls-open", "open"}
    wanted |= {"mode", "samples", "exposure", "tone", "heatmap", "structure", "machine", "device"}
    assert wanted | {"camera", "projection", "size"} <= reached
    nameless = page.evaluate("""() => [...document.querySelectorAll("button, select, input")]
      .filter(one => !one.ariaLabel && !one.textContent.trim() && !(one.labels || []).length)
      .map(one => one.outerHTML)""")
    assert nameless == []


def test_a_double_click_makes_a_new_centre(viewer):
    viewer.wait_for_rest()
    eye = viewer.camera["eye"]
    viewer.page.mouse.dblclick(*viewer.place(0.5, 0.8))
    viewer.wait(lambda: [one for one in viewer.messages if one["type"] == "hits"], "hits")
    point = viewer.last("hits")["hits"][0]["position"]
    # The view turns in steps, and the last but one is near: all digits are those of the last.
    viewer.wait(lambda: np.allclose(viewer.camera["look_at"], point, rtol=1e-12), "a new centre")
    np.testing.assert_allclose(viewer.camera["eye"], eye)
    assert not viewer.page.locator("#hits").is_visible()


def test_sizes(viewer):
    page = viewer.page
    viewer.wait_for_rest()
    page.select_option("#size", "640x480")
    viewer.wait(lambda: (viewer.sent[-1].get("type"), viewer.said.get("size"))[1], "the address")
    size = [one for one in viewer.sent if one["type"] == "size"][-1]
    assert (size["width"], size["height"]) == (640, 480)
    page.select_option("#size", "fit")
    page.set_viewport_size({"width": 1000, "height": 500})
    viewer.wait(
        lambda: [one for one in viewer.sent if one["type"] == "size"][-1]["height"] == 500,
        "the window's size",
    )
    viewer.wait_for_rest()


def test_a_lost_connection_comes_back_as_it_was(chromium):  # noqa: F811
    with serving("cornell") as address:
        viewer = Viewer(chromium, address, "#samples=1&mode=vis")
        before = viewer.camera
        viewer.drag((0.5, 0.5), (0.6, 0.5), steps=1)  # one change of the view, which then rests
        viewer.wait(lambda: viewer.camera["eye"] != before["eye"], "a turn")
        viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
        there = viewer.camera
    viewer.page.locator("#banner", has_text="No connection").wait_for()
    port = address.rstrip("/").rsplit(":", 1)[1]
    viewer.messages.clear()
    viewer.sent.clear()
    with serving("cornell", "--port", port):
        viewer.page.locator("#banner").wait_for(state="hidden")
        viewer.wait(
            lambda: [m for m in viewer.messages if m["type"] == "settings" and m["mode"] == "vis"],
            "vis",
        )
        viewer.wait(lambda: [m for m in viewer.sent if m["type"] == "camera"], "a camera")
        np.testing.assert_allclose(viewer.camera["eye"], there["eye"])
        # The browser reported errors while the server was down.
        viewer.problems.clear()
        viewer.close()


def test_cameras_turn_without_flipping(viewer):
    cases: list[dict[str, Any]] = viewer.page.evaluate(TURNED)
    for case in cases:
        camera, again = case["camera"], case["again"]
        np.testing.assert_allclose(again["eye"], camera["eye"], atol=1e-12)
        np.testing.assert_allclose(again["look_at"], camera["look_at"], atol=1e-12)
        np.testing.assert_allclose(case["place"], [0.8, 0.3], atol=1e-12)
        np.testing.assert_allclose(case["zoomed"], [0.8, 0.3], atol=1e-12)
        np.testing.assert_allclose(case["panned"], [0.5 + 0.1 / 1.5, 0.3], atol=1e-12)
        np.testing.assert_allclose(case["looked"], camera["eye"], atol=1e-12)
        np.testing.assert_allclose(case["picked"]["eye"], camera["eye"], atol=1e-12)
        np.testing.assert_allclose(case["picked"]["look_at"], [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(case["halfway"]["eye"], camera["eye"], atol=1e-9)
        above = np.subtract(case["steepest"]["eye"], case["steepest"]["look_at"])
        along = above @ case["up"] / np.linalg.norm(above)
        assert along == pytest.approx(1.0)
        assert abs(np.dot(case["steepest"]["up"], above)) < 1e-9
        places = np.array(case["corners"])
        assert places.min() >= 0.0
        assert places.max() <= 1.0
        assert np.ptp(places, axis=0).max() > 0.9
        rs.Camera(**{name: again[name] for name in ("eye", "look_at", "up", "fov", "projection")})
