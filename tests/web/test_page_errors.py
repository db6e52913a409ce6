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
