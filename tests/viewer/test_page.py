"""The viewer's page, in a browser: the most common actions."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from raystream.rendering.color import encode_srgb
from raystream.rendering.false_colors import color_ramp
from raystream.viewer.server.page_files import read_page_files
from viewer.browser import PHONE, Viewer, chromium, serving  # noqa: F401  a fixture

PAGE = Path(rs.__file__).parent / "viewer" / "page"
SHARED = Path(rs.__file__).parent / "web" / "shared"

TRIANGLE = """\
ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture(scope="module")
def address():
    with serving("cornell") as address:
        yield address


@pytest.fixture
def viewer(chromium, address):  # noqa: F811
    viewer = Viewer(chromium, address)
    yield viewer
    viewer.close()


def shown_hits(viewer: Viewer) -> list[tuple[float, int]]:
    """t and triangle of each row in the panel."""
    viewer.page.locator("#hits tbody tr").first.wait_for()
    rows = viewer.page.locator("#hits tbody tr").all()
    cells = [row.locator("td").all_inner_texts() for row in rows]
    return [(float(one[1]), int(one[2].replace(",", ""))) for one in cells]


def check_hits(viewer: Viewer, scene: rs.Scene) -> None:
    """The panel's rows are the engine's hits of that ray."""
    rows = shown_hits(viewer)
    ray = viewer.last("hits")
    known = rs.Tracer(scene).multi_hit([ray["origin"]], [ray["direction"]])
    assert [prim_id for _, prim_id in rows] == known.prim_id.tolist()
    np.testing.assert_allclose([t for t, _ in rows], known.t, rtol=1e-5)


def test_the_mouse_moves_the_camera_and_the_address_brings_it_back(viewer):
    page = viewer.page
    scene = viewer.last("scene")
    np.testing.assert_allclose(viewer.camera["eye"], scene["camera"]["eye"], rtol=1e-6)
    first = viewer.wait_for_rest()
    with viewer.changing_picture():
        viewer.drag((0.5, 0.5), (0.6, 0.45))
    turned = viewer.camera
    assert np.linalg.norm(np.subtract(turned["eye"], scene["camera"]["eye"])) > 0
    np.testing.assert_allclose(turned["look_at"], scene["camera"]["look_at"], atol=1e-9)
    viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    with viewer.changing_picture():
        page.mouse.wheel(0, -200)
        viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    apart = [np.subtract(one["eye"], one["look_at"]) for one in (turned, viewer.camera)]
    assert np.linalg.norm(apart[1]) < np.linalg.norm(apart[0])
    rest = viewer.wait_for_rest()
    assert rest != first
    there = viewer.camera
    viewer.wait(lambda: "eye" in viewer.said, "the address")
    page.wait_for_timeout(400)
    page.reload()
    page.locator("#stage[data-frame]").wait_for()
    viewer.wait_for_rest()
    np.testing.assert_allclose(viewer.camera["eye"], there["eye"], rtol=1e-5)
    np.testing.assert_allclose(viewer.camera["look_at"], there["look_at"], rtol=1e-5)


def test_a_click_shows_all_hits_of_the_ray_and_its_walk(viewer, scene):
    page = viewer.page
    viewer.wait_for_rest()
    page.mouse.click(*viewer.place(0.7, 0.6))
    check_hits(viewer, scene)
    assert page.locator("#marker").is_visible()
    message = viewer.last("hits")
    assert page.locator("#hits .steps li").count() == len(message["walk"]["steps"]) > 0
    assert message["walk"]["structure"] == "bvh"
    page.locator("#hits-copy").focus()
    page.keyboard.press("Escape")
    assert not page.locator("#hits").is_visible()
    assert not page.locator("#marker").is_visible()


def test_a_screenshot_is_a_png_of_the_picture(viewer):
    viewer.wait_for_rest()
    with viewer.page.expect_download() as download:
        viewer.page.locator("#screenshot").click()
    assert download.value.suggested_filename == "cornell-1.png"
    image = Image.open(BytesIO(Path(download.value.path()).read_bytes()))
    assert image.format == "PNG"
    box = viewer.page.locator("#picture").bounding_box()
    assert image.size == (round(box["width"]), round(box["height"]))


def test_models_come_by_files_and_wrong_ones_are_refused(viewer, tmp_path):
    page = viewer.page
    model = tmp_path / "triangle.ply"
    model.write_text(TRIANGLE)
    wrong = tmp_path / "wrong.ply"
    wrong.write_text("ply\nformat ascii 1.0\nelement vertex many\nend_header\n")
    page.locator("#files").set_input_files(model)
    viewer.wait(lambda: viewer.last("scene")["own"], "the model")
    assert viewer.last("scene")["triangles"] == 1
    page.locator("#scene-name", has_text="triangle.ply").wait_for()
    viewer.wait_for_rest()
    page.locator("#files").set_input_files(wrong)
    viewer.wait(lambda: [one for one in viewer.messages if one["type"] == "error"], "an error")
    page.locator(".toast.error").wait_for()
    page.locator("#first-scene").click()
    viewer.wait(lambda: not viewer.last("scene")["own"], "the first scene")
    page.locator("#files").set_input_files(Path(__file__))
    viewer.toast("is not a model")


def test_a_phone_turns_the_scene_with_a_finger_and_has_the_controls_in_a_sheet(
    chromium,  # noqa: F811
    address,
):
    viewer = Viewer(chromium, address, **PHONE)
    page = viewer.page
    viewer.wait_for_rest()
    wide, high = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert wide == high == 390
    controls = page.locator("#controls")
    controls.wait_for(state="hidden")
    before = viewer.camera
    touch = page.context.new_cdp_session(page)
    x, y = viewer.place(0.5, 0.5)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": a, "y": b, "id": i} for i, (a, b) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", (x, y))
    for step in range(1, 6):
        fingers("touchMove", (x + 8 * step, y))
    fingers("touchEnd")
    viewer.wait(lambda: viewer.camera["eye"] != before["eye"], "a turn")
    turned = viewer.camera
    fingers("touchStart", (x - 30, y), (x + 30, y))
    for step in range(1, 6):
        fingers("touchMove", (x - 30 - 8 * step, y), (x + 30 + 8 * step, y))
    fingers("touchEnd")
    viewer.wait(lambda: not viewer.camera["moving"], "the camera at rest")
    apart = [np.subtract(one["eye"], one["look_at"]) for one in (turned, viewer.camera)]
    assert np.linalg.norm(apart[1]) < 0.8 * np.linalg.norm(apart[0])
    page.locator("#controls-open").tap()
    controls.wait_for()
    page.wait_for_timeout(400)
    for target in page.locator("button:visible, select:visible, input:visible").all():
        box = target.bounding_box()
        if "hidden" not in (target.get_attribute("class") or ""):
            assert min(box["height"], max(box["width"], 44)) >= 44, target.get_attribute("id")
    page.locator("#controls-close").tap()
    controls.wait_for(state="hidden")
    viewer.close()


def test_without_a_gpu_the_server_renders_for_this_browser(viewer):
    viewer.wait_for_rest()
    viewer.page.select_option("select[name=device]", "browser")
    viewer.toast("The server renders.")
    says = viewer.page.locator("#device-says").text_content()
    assert says.removesuffix(" The server renders.") in (
        "No GPU was found.",
        "This browser has no WebGPU.",
    )
    with viewer.changing_picture():
        viewer.page.locator("#picture").press("+")
    viewer.problems.remove("console: No available adapters.")  # as browsers say


def test_no_file_of_the_page_hides_another():
    rooms = [SHARED.parent / "page", SHARED, PAGE]
    names = [file.name for room in rooms for file in room.iterdir()]
    assert len(names) == len(set(names)) > 30


def test_the_legend_has_the_colors_of_heat_maps():
    colors = encode_srgb(color_ramp(11))
    wanted = ["#" + "".join(f"{channel:02x}" for channel in color) for color in colors]
    style = (PAGE / "components.css").read_text()
    ramp = style[style.index(".ramp {") :]
    ramp = ramp[: ramp.index(");")].split("to right,")[1]
    assert [color.strip() for color in ramp.split(",")] == wanted


def test_the_page_asks_for_its_own_files_only():
    folders = [PAGE, SHARED, SHARED.parent / "page"]
    paths = [
        path
        for folder in folders
        for path in folder.iterdir()
        if not path.name.startswith("exported.")
    ]
    names = {path.name for path in paths}
    assert names == set(read_page_files())
    for path in paths:
        text = path.read_text(encoding="utf-8")
        assert "http://" not in text.replace("http://www.w3.org/2000/svg", ""), path.name
        assert "https://" not in text, path.name
        for line in text.splitlines():
            if line.startswith("import ") or "} from " in line:
                assert line.split('"')[1].removeprefix("./") in names, f"{path.name}: {line}"
    index = (PAGE / "index.html").read_text(encoding="utf-8")
    assert "<style" not in index
    assert "style=" not in index
    assert " on" not in index.replace(" one", "").replace(" on ", "").replace(" only", "")
