"""Live pages in the documentation: made from what is there, small, and loaded on request."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from documentation.commands import REPOSITORY
from extras import need
from raystream.scene.samples import SAMPLES
from viewer.browser import PATIENCE
from web.pages import browser  # noqa: F401  a fixture

EXTENSIONS = REPOSITORY / "docs" / "_ext"

CONF = f"""
import sys
sys.path.insert(0, {str(EXTENSIONS)!r})
extensions = ["live_page"]
html_theme = "basic"
html_static_path = [{str(REPOSITORY / "docs" / "_static")!r}]
html_css_files = ["site.css"]
"""

INDEX = """
Title
=====

.. live-page:: cornell
   :structure: grid
   :mode: raycast

   A caption of *the box*.
"""


@pytest.fixture(scope="module")
def live_page():
    need("sphinx")
    sys.path.insert(0, str(EXTENSIONS))
    try:
        import live_page
    finally:
        sys.path.remove(str(EXTENSIONS))
    return live_page


def test_pages_are_exported_once_for_each_state(live_page, tmp_path, monkeypatch):
    first = live_page.make_page("cornell", tmp_path)
    written = first.page.stat().st_mtime_ns
    assert 100_000 < first.page.stat().st_size < live_page.MOST_BYTES
    assert live_page.make_page("cornell", tmp_path) == first
    assert first.page.stat().st_mtime_ns == written
    monkeypatch.setattr(live_page, "_sources", lambda: "other sources")
    other = live_page.make_page("cornell", tmp_path)
    assert other.page != first.page
    assert sorted(tmp_path.iterdir()) == sorted([other.page, other.image])
    monkeypatch.setattr(live_page, "MOST_BYTES", 100_000)
    with pytest.raises(ValueError, match="more than 100,000"):
        live_page.make_page("cornell", tmp_path)


def test_without_a_model_another_scene_takes_its_place(live_page, tmp_path, monkeypatch):
    """Nothing is downloaded."""
    models = {name for name, one in live_page.PAGES.items() if one.scene in SAMPLES}
    assert models
    for folder in (None, str(tmp_path)):
        monkeypatch.delenv("RAYSTREAM_SCENES", raising=False)
        if folder:
            monkeypatch.setenv("RAYSTREAM_SCENES", folder)
        for name in models:
            instead = live_page.PAGES[live_page.PAGES[name].instead]
            assert not live_page.is_there(live_page.PAGES[name].scene)
            assert live_page.is_there(instead.scene)
            assert set(live_page.PAGES[name].structures) <= set(instead.structures)
    small = live_page.PAGES["bunny"]._replace(instead="cornell")
    monkeypatch.setitem(live_page.PAGES, "bunny", small)
    assert live_page.make_page("bunny", tmp_path).name == "cornell"


@pytest.mark.documentation
def test_all_pages_are_small(live_page, tmp_path):
    """Those of models, too, where they are there."""
    for name in live_page.PAGES:
        made = live_page.make_page(name, tmp_path)
        assert made.page.stat().st_size < 5_000_000, name


def build(source, target, builder="html"):
    """Build a page with a live page."""
    source.mkdir(exist_ok=True)
    (source / "conf.py").write_text(CONF)
    if not (source / "index.rst").exists():
        (source / "index.rst").write_text(INDEX)
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", "-b", builder]
    return subprocess.run(
        [*command, str(source), str(target)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )


@pytest.fixture(scope="module")
def site(live_page, tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    result = build(folder / "source", folder / "html")
    assert result.returncode == 0, result.stderr
    return folder


def test_nothing_is_loaded_before_a_click(browser, site):  # noqa: F811
    asked = []

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            asked.append(self.path.split("?")[0])

    handler = partial(Handler, directory=site / "html")
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            address = f"http://127.0.0.1:{server.server_port}/index.html"
            assert_loaded_on_request(browser, address, asked)
        finally:
            server.shutdown()
            thread.join()


def assert_loaded_on_request(browser, address, asked):  # noqa: F811
    context = browser.new_context(viewport={"width": 400, "height": 400})
    page = context.new_page()
    problems, requests = [], []
    page.on("request", lambda one: requests.append(one.url))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(address)
    page.wait_for_load_state("networkidle")
    assert [one for one in asked if "live/" in one] == ["/live/cornell.png"]
    assert page.locator("iframe").count() == 0
    page.locator("a.live-open").click()
    frame = page.locator("iframe").element_handle().content_frame()
    frame.wait_for_selector("#picture:not([hidden])", timeout=1000 * PATIENCE)
    found = frame.evaluate("raystream.opened.then(p => [p.structure, p.mode, p.errorCount])")
    assert found == ["grid", "raycast", 0]
    assert page.evaluate("document.activeElement.tagName") == "IFRAME"
    assert page.locator("iframe").get_attribute("title")
    assert asked.count("/live/cornell.html") == 1
    assert {one.partition("/live")[0] for one in requests if "live/" in one} == {
        address.rpartition("/")[0]
    }
    assert not problems
    context.close()


@pytest.mark.documentation
def test_a_second_build_exports_nothing(site):
    page = site / "html" / "live" / "cornell.html"
    kept = next((site / "html" / ".doctrees" / "live").glob("*.html"))
    page.unlink()
    written = kept.stat().st_mtime_ns
    assert build(site / "source", site / "html").returncode == 0
    assert page.is_file()
    assert kept.stat().st_mtime_ns == written


@pytest.mark.documentation
def test_other_builders_have_the_caption(site):
    result = build(site / "source", site / "text", "text")
    assert result.returncode == 0, result.stderr
    assert "A caption of *the box*." in (site / "text" / "index.txt").read_text()
    assert not (site / "text" / "live").exists()


def test_bad_input_is_named(live_page, tmp_path):
    cornell = ".. live-page:: cornell\n"
    wrong = (
        ".. live-page:: teapots",
        f"{cornell}   :structure: octree",
        f"{cornell}   :mode: witted",
    )
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "index.rst").write_text("\n\n".join(("Title\n=====", *wrong)))
    result = build(tmp_path / "source", tmp_path / "html")
    assert result.returncode
    assert "expected one of bunny, cornell" in result.stderr
    assert "cornell has no structure 'octree'" in result.stderr
    assert "expected a mode of raycast, shadow, whitted, ao, path, got 'witted'" in result.stderr


@pytest.mark.documentation
def test_the_site_s_pages(live_page):
    """Of the site that .ci/run built: small, and each image leads to one."""
    if "RAYSTREAM_SITE" not in os.environ:
        pytest.skip("RAYSTREAM_SITE names no built site")
    folder = Path(os.environ["RAYSTREAM_SITE"])
    pages = list((folder / "live").glob("*.html"))
    assert len(pages) >= 4
    assert all(one.stat().st_size < live_page.MOST_BYTES for one in pages)
    shown = 0
    for name in ("live.html", *(f"papers/{one.name}" for one in folder.glob("papers/*20*.html"))):
        for link in re.findall(r'class="live-open" href="([^"#]+)', (folder / name).read_text()):
            assert (folder / name).parent.joinpath(link).is_file()
            shown += 1
    assert shown == 7
