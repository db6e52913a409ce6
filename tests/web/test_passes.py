"""Exported pages by passes: as Python's multipass machine on graphics devices."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import raystream as rs
from conftest import skip_without_adapter
from meshes import icosphere
from web.pages import Exported, browser  # noqa: F401  a fixture

STRUCTURES = ("bvh", "grid", "kdtree", "brute")
WITH_PASSES = STRUCTURES[1:]
SIZE = 64, 48

#: As the page has it: a kd-tree whose traversal needs no stack.
OPTIONS = {"kdtree": {"traversal": "restart"}}

#: Modes and structures of everyday tests of images.
EVERYDAY = {("shadow", "kdtree")}
MODES = ("raycast", "shadow", "whitted", "ao", "path")
CASES = [
    pytest.param(
        mode, structure, marks=[pytest.mark.exhaustive] * ((mode, structure) not in EVERYDAY)
    )
    for mode in MODES
    for structure in WITH_PASSES
]


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture(scope="module")
def path(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("pages") / "cornell.html"
    rs.export_page(scene, path, structures=STRUCTURES, size=SIZE)
    return path


@pytest.fixture(scope="module")
def opened(browser, path):  # noqa: F811
    with Exported(browser, path, SIZE) as page:
        page.wait_for_samples(1)
        yield page


def finish(page, samples, **choices):
    """Choose, and wait until an image has a number of samples."""
    page.run(
        """(page, [samples, choices]) => {
            page.scene.samples = samples;
            page.panel.isPaused = false;
            Object.assign(page, choices);
            page.change();
        }""",
        [samples, choices],
    )
    page.wait("raystream.opened.then(page => !page.isRunning)")
    assert page.run("page => page.sample") == samples


def counts(page):
    """Passes of each kernel, and rays of the last sample, of the chosen renderer."""
    return page.run(
        """async page => {
            const one = await page.rendererOf(page.structure, page.mode, page.machine);
            return [Object.fromEntries(one.passes ?? []), one.clock.rays];
        }"""
    )


def traced(scene, structure, mode, samples):
    """Python's image of the page's view, by its multipass machine."""
    skip_without_adapter()
    options = OPTIONS.get(structure, {})
    tracer = rs.Tracer(scene, structure, machine="multipass", device="graphics", **options)
    camera = scene.camera_for(SIZE[0] / SIZE[1])
    return rs.render(tracer, mode, SIZE, samples=samples, camera=camera)


@pytest.mark.parametrize(("mode", "structure"), CASES)
def test_passes_and_images_are_python_s(opened, scene, mode, structure):
    finish(opened, 2, mode=mode, structure=structure, machine="passes")
    passes, rays = counts(opened)
    light = opened.light()
    finish(opened, 2, machine="compute")
    np.testing.assert_array_equal(light, opened.light())  # the rays are the other machine's
    assert rays == counts(opened)[1] >= SIZE[0] * SIZE[1]
    image = traced(scene, structure, mode, 2)
    known = image.figures["passes"]
    assert {name: count for name, count in passes.items() if count} == known
    assert np.isclose(light, image.pixels, rtol=2e-3, atol=2e-3).all(axis=2).mean() > 0.97
    assert light.std() > 0.05


def found_by_passes(page):
    """The rays and hits of the last sample: local origins and directions, then t and prim_id."""
    words = page.run(
        """async page => {
            const {streams} = await page.rendererOf(page.structure, page.mode, "passes");
            const read = async name => Array.from(await streams.read(name));
            return [await read("origins"), await read("directions"), await read("found"),
                await read("state")];
        }"""
    )
    origins, directions, found = (np.array(one, np.float32).reshape(-1, 4) for one in words[:3])
    state = np.array(words[3], np.uint32).reshape(-1, 4)
    assert (origins[:, 3] <= directions[:, 3]).all()
    return origins[:, :3], directions[:, :3], found[:, 0], state[:, 2].view(np.int32)


@pytest.mark.parametrize(
    "structure", ["grid", "kdtree", pytest.param("brute", marks=pytest.mark.exhaustive)]
)
def test_passes_and_hits_are_python_s(opened, scene, structure):
    skip_without_adapter()
    finish(opened, 2, mode="raycast", structure=structure, machine="passes")
    passes, rays = counts(opened)
    known = traced(scene, structure, "raycast", 2).figures["passes"]
    assert {name: count for name, count in passes.items() if count} == known
    assert rays == SIZE[0] * SIZE[1]
    origins, directions, t, prim_id = found_by_passes(opened)
    frame = scene.triangles
    scale = float(frame.scale)
    options = OPTIONS.get(structure, {})
    tracer = rs.Tracer(scene, structure, machine="multipass", device="graphics", **options)
    hits = tracer.first_hit(frame.center + origins / scale, directions)
    np.testing.assert_array_equal(prim_id, hits.prim_id)
    np.testing.assert_allclose(t[hits.is_hit] / scale, hits.t[hits.is_hit], rtol=1e-5)
    assert hits.is_hit.mean() > 0.3
    # And the CPU's, by another structure.
    known = rs.Tracer(scene, "bvh").first_hit(frame.center + origins / scale, directions)
    np.testing.assert_array_equal(prim_id, known.prim_id)


def step(page):
    """Press the button, and wait for the pass."""
    page.page.evaluate("document.getElementById('step').click()")
    page.run("async page => { await page.panel.work; }")


def waiting(page):
    """Rays in each state, and the kernel of the last pass with the rays that it ran on."""
    return page.run(
        """async page => {
            const one = await page.rendererOf(page.structure, page.mode, "passes");
            const named = Object.entries(one.states);
            return [Object.fromEntries(named.map(([name, k]) => [name, one.waiting[k]])), one.last];
        }"""
    )


def test_pass_by_pass(opened):
    """Each step is a pass on the rays that waited for it, and the image is the same in the end."""
    finish(opened, 1, mode="raycast", structure="kdtree", machine="passes")
    light = opened.light()
    known, _ = counts(opened)
    pixels, ran = SIZE[0] * SIZE[1], Counter()
    states = {
        one["name"]: one["state"]
        for one in opened.run("p => p.scene.structures.kdtree.passes.kernels")
    }
    names = opened.run("page => page.scene.schedule.states")
    waits_for = {
        kernel: next(n for n, k in names.items() if k == state) for kernel, state in states.items()
    }
    before, done = None, 0
    while sum(ran.values()) < sum(known.values()):
        step(opened)
        now, last = waiting(opened)
        done += last["rays"] if last["kernel"] == "shade" else 0  # no ray is spawned
        assert sum(now.values()) + done == pixels
        assert opened.page.locator("#passes-rows tr:last-child td").last.inner_text() == f"{done:,}"
        ran[last["kernel"]] += 1
        if before is None:
            assert (last, now["starting"]) == ({"kernel": "eye rays", "rays": pixels}, pixels)
        else:
            assert last["rays"] == before[waits_for.get(last["kernel"], "shading")] > 0
        before = now
        shown = opened.page.locator("#passes-rows tr.last th").all_inner_texts()
        assert shown == [last["kernel"]]
        text = opened.page.locator("#passes-last").text_content()
        assert text == f"Last pass: {last['kernel']}, on {last['rays']:,} of {pixels:,} pixels"
    assert ran == Counter(known)
    assert opened.run("page => page.sample") == 1
    np.testing.assert_array_equal(opened.light(), light)


def test_states_are_colors_until_the_image_goes_on(opened):
    finish(opened, 1, mode="raycast", structure="grid", machine="passes")
    for _ in range(4):
        step(opened)
    now, _ = waiting(opened)
    pixels = opened.run(
        """async page => {
            const {streams} = await page.rendererOf("grid", "raycast", "passes");
            const {width, height} = page.canvas;
            const copy = new OffscreenCanvas(width, height).getContext("2d");
            page.panel.image.show(streams);
            copy.drawImage(page.canvas, 0, 0); // before it is presented
            return Array.from(copy.getImageData(0, 0, width, height).data);
        }"""
    )
    colors = np.array(pixels).reshape(-1, 4)[:, :3]
    seen = {
        "traversing": (0x00, 0x72, 0xB2),
        "intersecting": (0xE6, 0x9F, 0x00),
        "shading": (0x00, 0x9E, 0x73),
    }
    for name, color in seen.items():
        assert (np.abs(colors - np.array(color)).max(axis=1) <= 1).sum() == now[name], name
    assert sum(now[name] > 0 for name in seen) >= 2
    opened.page.evaluate("document.getElementById('run').click()")
    opened.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")
    assert waiting(opened)[0]["shading"] == 0


def choose(page, name, value):
    """Choose by a control, and wait for the image."""
    page.page.evaluate(
        """([name, value]) => {
            const control = document.getElementById(name);
            control.value = value;
            control.dispatchEvent(new Event("change"));
        }""",
        [name, value],
    )
    page.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")


def test_a_view_begins_again_with_eye_rays(opened):
    finish(opened, 1, mode="raycast", structure="grid", machine="passes")
    step(opened)
    step(opened)
    opened.page.locator("#picture").focus()
    opened.page.keyboard.press("ArrowLeft")
    opened.wait("raystream.opened.then(async p => (await p.panel.work, p.begun === p.changes))")
    assert waiting(opened)[1]["kernel"] == "eye rays"
    opened.run("page => { page.view = page.home; page.panel.resume(); }")
    opened.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")


@pytest.mark.exhaustive
def test_a_lost_gpu_begins_the_passes_again(browser, path):  # noqa: F811
    address = f"{path.as_uri()}#structure=grid&mode=heatmap+tests&machine=passes"
    with Exported(browser, address, SIZE) as page:
        page.wait_for_samples(1)
        chosen = page.run("page => [page.structure, page.mode, page.machine]")
        assert chosen == ["grid", "raycast", "passes"]
        finish(page, 1)
        step(page)
        step(page)
        page.run("page => { page.first = page.gpu; page.gpu.device.destroy(); }")
        page.wait("raystream.opened.then(p => p.gpu !== p.first && p.begun === p.changes)")
        page.run("page => page.panel.work")
        assert waiting(page)[1]["kernel"] == "eye rays"
        assert page.page.locator("#picture").is_visible()


def test_passes_only_run_where_they_can(opened):
    finish(opened, 1, mode="raycast", structure="bvh", machine="compute")
    choose(opened, "machine", "passes")
    assert opened.run("page => [page.structure, page.machine]") == ["grid", "passes"]
    assert opened.page.locator("#structure").input_value() == "grid"
    choose(opened, "structure", "bvh")
    assert opened.run("page => [page.structure, page.machine]") == ["bvh", "compute"]
    assert opened.page.locator("#machine").input_value() == "compute"
    assert opened.page.locator("#passes").is_hidden()
    choose(opened, "mode", "heatmap tests")
    choose(opened, "machine", "passes")
    assert opened.run("page => [page.mode, page.structure]") == ["raycast", "grid"]
    assert opened.page.locator("#legend").is_hidden()
    choose(opened, "mode", "heatmap tests")
    assert opened.run("page => [page.structure, page.machine]") == ["grid", "compute"]
    assert opened.page.locator("#legend").is_visible()


def test_a_gpu_that_writes_less_is_told_why(browser, path):  # noqa: F811
    before = """Object.defineProperty(GPUSupportedLimits.prototype,
        "maxColorAttachmentBytesPerSample", {get: () => 64});"""
    with Exported(browser, f"{path.as_uri()}#machine=passes", SIZE, before) as page:
        page.wait_for_samples(1)
        assert page.run("page => page.machine") == "compute"
        option = page.page.locator("#machine option[value=passes]")
        assert option.is_disabled()
        title = page.page.locator("#machine").get_attribute("title")
        assert title.startswith("Passes write 7 textures at once")
        assert title.endswith("this GPU can write 4.")


@pytest.mark.parametrize("has_times", [True, pytest.param(False, marks=pytest.mark.exhaustive)])
def test_rays_per_second_name_their_clock(browser, path, has_times):  # noqa: F811
    before = "" if has_times else "GPUSupportedFeatures.prototype.has = () => false;"
    with Exported(browser, path, SIZE, before) as page:
        page.wait_for_samples(1)
        finish(page, 2)
        offered = page.run(
            """async () => {
                const adapter = await navigator.gpu.requestAdapter();
                return adapter.features.has("timestamp-query");
            }"""
        )
        assert has_times or not offered
        text = page.page.locator("#figures").text_content()
        assert f"rays/s ({'GPU' if offered else 'page'}'s clock)" in text
        rays, seconds = page.run(
            """async page => {
                const {clock} = await page.rendererOf(page.structure, page.mode, "compute");
                return [clock.rays, clock.seconds];
            }"""
        )
        assert rays == SIZE[0] * SIZE[1]
        assert 0 < seconds < 10


@pytest.mark.exhaustive
def test_glass_takes_more_room(browser, tmp_path):  # noqa: F811
    glass = rs.Material(diffuse=(0.1,) * 3, transmission=(0.9,) * 3, ior=1.5)
    scene = rs.Scene.from_arrays(*icosphere(1)).replace(materials=[glass])
    rs.export_page(scene, tmp_path / "page.html", structures=["kdtree"], size=SIZE)
    with Exported(browser, tmp_path / "page.html", SIZE) as page:
        page.wait_for_samples(1)
        finish(page, 2, mode="whitted", machine="passes")
        passes, _ = counts(page)
        room = page.run("async p => (await p.rendererOf('kdtree', 'whitted', 'passes')).room")
    assert room > 2
    known = traced(scene, "kdtree", "whitted", 2).figures["passes"]
    assert {name: count for name, count in passes.items() if count} == known
