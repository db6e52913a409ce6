"""Exported pages whose choices cannot be traced, whose GPU fails, or is lost."""

from __future__ import annotations

import pytest

import raystream as rs
from meshes import soup
from web.pages import Exported, browser  # noqa: F401  a fixture

SIZE = 64, 48


@pytest.fixture(scope="module")
def scene():
    return rs.Scene.from_arrays(*soup(40, seed=4))


@pytest.fixture(scope="module")
def path(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("pages") / "soup.html"
    rs.export_page(scene, path, structures=["bvh", "grid", "brute"], size=SIZE)
    return path


def test_passes_are_not_chosen_where_no_structure_has_them(browser, tmp_path, scene):  # noqa: F811
    path = tmp_path / "bvh.html"
    rs.export_page(scene, path, structures=["bvh"], size=SIZE)
    with Exported(browser, f"{path.as_uri()}#machine=passes", SIZE) as page:
        page.wait_for_samples(1)
        assert page.page.locator("#machine option[value=passes]").is_disabled()
        assert page.page.locator("#machine").is_hidden()
        page.run("page => page.choose('machine', 'passes')")
        assert page.run("page => [page.structure, page.machine]") == ["bvh", "compute"]
        assert page.message == ""
        assert page.page.locator("#picture").is_visible()


@pytest.fixture(scope="module")
def opened(browser, path):  # noqa: F811
    with Exported(browser, path, SIZE) as page:
        page.run("page => { page.scene.samples = 1; }")
        page.wait_for_samples(1)
        yield page


#: Renderers of one structure fail after some milliseconds, and another is chosen later.
FAILING = """async (page, [failing, after, chosen, later]) => {
    const own = page.rendererOf;
    const pause = time => new Promise(done => setTimeout(done, time));
    page.rendererOf = async function (structure, ...rest) {
        if (structure !== failing) return own.call(page, structure, ...rest);
        await pause(after);
        throw new Error("a late error");
    };
    page.change();
    await pause(later);
    if (chosen) page.choose("structure", chosen);
    await Promise.resolve(page.panel.work).then(() => page.running);
    await pause(700);
    delete page.rendererOf;
    return page.isStopped;
}"""


def begin(page, structure, machine="compute"):
    """An image of one sample by a structure, not pass by pass."""
    page.run(
        """(page, [structure, machine]) => {
            page.panel.isPaused = false;
            Object.assign(page, {structure, mode: "raycast", machine});
            page.change();
        }""",
        [structure, machine],
    )
    page.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")


@pytest.mark.parametrize(("after", "later"), [(300, 100), (0, 200)])
def test_an_error_does_not_stop_what_is_chosen_since(opened, after, later):
    """Neither one that comes late, nor one while the page waits whether the GPU was lost."""
    begin(opened, "bvh")
    assert not opened.run(FAILING, ["bvh", after, "grid", later])
    opened.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")
    assert opened.message == ""
    assert opened.page.locator("#picture").is_visible()


def test_an_error_stops_the_image_until_something_is_chosen(opened):
    begin(opened, "bvh")
    assert opened.run(FAILING, ["bvh", 0, None, 0])
    assert opened.message == "a late error"
    assert opened.problems.pop().startswith("Error: a late error")
    assert opened.page.locator("#preview").is_visible()
    begin(opened, "bvh")
    assert opened.message == ""
    assert opened.page.locator("#preview").is_hidden()


def test_an_error_of_a_step_does_not_stop_what_is_chosen_since(opened):
    begin(opened, "grid", "passes")
    opened.run("page => { page.panel.isPaused = true; page.change(); return page.panel.work; }")
    assert not opened.run(FAILING, ["grid", 300, "brute", 100])
    assert opened.message == ""
    assert opened.run("page => [page.isByStep, page.structure]") == [True, "brute"]
    last = opened.run("async p => (await p.rendererOf('brute', 'raycast', 'passes')).last")
    assert last == {"kernel": "eye rays", "rays": SIZE[0] * SIZE[1]}
    begin(opened, "bvh")


#: Open a GPU for the page's image while something else happens: why the new one ended, if it did,
#: whether opening failed, and whether the canvas and the image have the first one still.
OPENING = """async (page, [fails, closes]) => {
    const {gpu} = page;
    const [adapter, device] = [GPUAdapter.prototype, GPUDevice.prototype];
    const [request, make] = [adapter.requestDevice, device.createRenderPipelineAsync];
    let opened;
    adapter.requestDevice = async function (...options) {
        opened = await request.apply(this, options);
        return opened;
    };
    device.createRenderPipelineAsync = async function (...options) {
        const made = await make.apply(this, options);
        if (closes) page.isClosed = true;
        if (fails) throw new Error("no pipeline");
        return made;
    };
    const hasFailed = await page.open().then(() => false, () => true);
    Object.assign(adapter, {requestDevice: request});
    Object.assign(device, {createRenderPipelineAsync: make});
    page.isClosed = false;
    const pause = new Promise(done => setTimeout(() => done("open"), 500));
    const end = await Promise.race([opened.lost.then(({reason}) => reason), pause]);
    const {device: configured} = page.canvas.getContext("webgpu").getConfiguration();
    return [end, hasFailed, configured === gpu.device, page.gpu === gpu];
}"""


@pytest.mark.parametrize(("fails", "closes"), [(True, False), (False, True)])
def test_a_gpu_that_is_not_used_is_given_back(opened, fails, closes):
    """Where opening fails, or the image is closed meanwhile; the canvas keeps its GPU."""
    assert opened.run(OPENING, [fails, closes]) == ["destroyed", fails, True, True]
    begin(opened, "bvh")
    assert opened.message == ""


def test_a_gpu_that_is_opened_again_is_used(opened):
    assert opened.run(OPENING, [False, False]) == ["open", False, False, False]
    begin(opened, "bvh")


def test_boxes_of_steps_are_only_over_the_image(browser, path):  # noqa: F811
    """Not over the one that was rendered beforehand, also when the view changes there."""
    with Exported(browser, path, (240, 180)) as page:
        page.run("page => { page.scene.samples = 1; }")
        page.wait_for_samples(1)
        page.page.locator("#picture").click(position={"x": 120, "y": 90})
        page.wait("!document.getElementById('walk').hidden")
        boxes = page.page.locator("#walk-picture")
        assert boxes.is_visible()
        assert page.run(FAILING, ["bvh", 0, None, 0])
        page.problems.clear()
        assert boxes.is_hidden()
        assert page.page.locator("#preview").is_visible()
        page.run("page => page.walk.draw(page.camera, page.size)")
        assert boxes.is_hidden()
        begin(page, "bvh")
        assert boxes.is_visible()
        drawn = "document.getElementById('walk-picture').width"
        assert page.page.evaluate(drawn) == page.page.locator("#picture").evaluate(
            "one => one.width"
        )


STEP = "async page => { document.getElementById('step').click(); await page.panel.work; }"


def begin_by_steps(page, structure="grid"):
    """Begin an image pass by pass."""
    begin(page, structure, "passes")
    page.run(STEP)
    assert page.run("page => page.isByStep")


@pytest.mark.parametrize("button", ["run", "step"])
def test_passes_go_on_after_a_stop(opened, button):
    begin_by_steps(opened)
    opened.run(STEP)
    assert opened.run(FAILING, ["grid", 0, None, 0])
    assert opened.problems.pop().startswith("Error: a late error")
    assert opened.page.locator("#preview").is_visible()
    if button == "run":
        opened.page.evaluate("document.getElementById('run').click()")
        opened.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")
    else:
        opened.run(STEP)
        last = opened.run("async p => (await p.rendererOf('grid', 'raycast', 'passes')).last")
        assert last["kernel"] == "eye rays"
    assert opened.message == ""
    assert opened.page.locator("#preview").is_hidden()
    begin(opened, "bvh")


def test_steps_end_with_the_last_sample(opened):
    begin_by_steps(opened)
    for _ in range(200):
        if opened.run("page => page.sample"):
            break
        opened.run(STEP)
    passes = "async p => [...(await p.rendererOf('grid', 'raycast', 'passes')).passes]"
    before = opened.run(passes)
    opened.run(STEP)
    assert opened.run("page => page.sample") == 1
    assert opened.run(passes) == before
    begin(opened, "bvh")


@pytest.mark.parametrize("by_step", [False, True])
def test_compute_gives_the_textures_of_passes_back(opened, by_step):
    """Also while a step is under way; passes get others."""
    begin(opened, "grid", "passes")
    if by_step:
        begin_by_steps(opened)
    ended = opened.run(
        """async (page, isByStep) => {
            const {streams} = page.surfaces;
            let ended = 0;
            for (const one of [...Object.values(streams.streams), streams.stencil]) {
                const own = one.destroy;
                one.destroy = function () { ended += 1; own.call(one); };
            }
            if (isByStep) page.panel.press();
            await Promise.resolve();
            page.choose("machine", "compute");
            await page.panel.work;
            await page.running;
            await page.panel.work;
            return [ended, page.surfaces.streams, page.sample];
        }""",
        by_step,
    )
    assert ended == [11, None, 1]
    begin(opened, "grid", "passes")
    assert opened.run("page => page.errorCount") == 0
    assert opened.message == ""
    begin(opened, "bvh")


PICK = "page => page.pick(0.5, 0.5)"


def wait_until_it_says(page, text):
    said = "document.getElementById('message').textContent"
    page.wait(f"{said}.startsWith('{text}') && Boolean({said}) === {str(bool(text)).lower()}")


@pytest.mark.parametrize("what", ["pick", "counts"])
def test_errors_beside_the_image_are_said_until_the_next_success(opened, what):
    begin(opened, "bvh")

    def act():
        if what == "pick":
            opened.run(PICK)
        else:
            opened.page.evaluate("document.getElementById('compare').click()")

    # One of the page's own errors, which says what is wrong.
    most = "Object.defineProperty(page.gpu, 'mostBytes', {configurable: true, get: () => 32})"
    opened.run(f"page => {{ {most}; }}")
    act()
    wait_until_it_says(opened, "params would take ")
    assert not opened.problems
    opened.run("page => { delete page.gpu.mostBytes; }")
    act()
    wait_until_it_says(opened, "")
    # Another one is reported, too.
    opened.run("page => { page.queriesOf = () => { throw new Error('unexpected'); }; }")
    act()
    wait_until_it_says(opened, "unexpected")
    assert opened.problems.pop().startswith("Error: unexpected")
    opened.run("page => { delete page.queriesOf; }")
    act()
    wait_until_it_says(opened, "")
    # The image is not stopped by them.
    assert opened.page.locator("#picture").is_visible()
    for name in ("hits", "counts"):
        opened.page.evaluate(f"document.getElementById('{name}-close').click()")


def test_a_pick_while_the_gpu_is_lost_says_the_page_s_sentence(opened):
    """Then the page opens another, and says no more."""
    begin(opened, "bvh")
    said = opened.run(
        """async page => {
            const said = [];
            page.say = text => { said.push(text); delete page.say; page.say(text); };
            page.first = page.gpu;
            page.gpu.device.destroy();
            await page.pick(0.5, 0.5);
            return said;
        }"""
    )
    assert said == ["The GPU stopped; this page starts it again."]
    opened.wait("raystream.opened.then(p => p.gpu !== p.first && p.sample === 1 && !p.isRunning)")
    assert opened.message == ""
    assert not opened.problems
    opened.run(PICK)
    assert opened.page.locator("#hits-title").text_content() != ""
    opened.page.evaluate("document.getElementById('hits-close').click()")


def test_what_failed_with_a_lost_gpu_is_repeated_on_another(opened):
    begin(opened, "bvh")
    calls = opened.run(
        """async page => {
            let calls = 0;
            await page.attempt(async () => {
                calls += 1;
                if (calls > 1) return;
                const {gpu} = page;
                gpu.device.destroy();
                while (page.gpu === gpu) await new Promise(done => setTimeout(done, 20));
                throw new Error("the GPU was lost");
            });
            return calls;
        }"""
    )
    assert calls == 2
    assert not opened.problems
    opened.wait("raystream.opened.then(page => page.sample === 1 && !page.isRunning)")
    assert opened.message == ""


def test_failing_queries_keep_no_buffers(opened):
    """Neither of hits nor of steps, whichever buffer there is no room for."""
    begin(opened, "bvh")
    counts = opened.run(
        """async page => {
            const {gpu} = page;
            const own = gpu.buffer;
            const ray = Float64Array.from(page.rayThrough(0.5, 0.5));
            let [made, ended, failed, room] = [0, 0, 0, 0];
            gpu.buffer = function (...options) {
                if (made - ended >= room) throw new Error("no room");
                const one = own.apply(this, options);
                made += 1;
                one.destroy = () => { ended += 1; GPUBuffer.prototype.destroy.call(one); };
                return one;
            };
            for (room = 0; room < 8; room++) {
                await page.queriesOf("bvh").firstHit(ray).catch(() => { failed += 1; });
                await page.walkOf("bvh", [...ray]).catch(() => { failed += 1; });
            }
            gpu.buffer = own;
            return [made, ended, failed];
        }"""
    )
    made = sum(min(room, 6) + min(room, 4) for room in range(8))
    assert counts == [made, made, 6 + 4]
