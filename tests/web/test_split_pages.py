"""Pages in a folder, of a server; and what an address chooses."""

from __future__ import annotations

import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

import raystream as rs
from web.page_answers import assert_same_hits, rays_of
from web.pages import Exported, browser  # noqa: F401  a fixture

FILES = {"index.html", "page.css", "page.js", "preview.png", "data.bin"}
SIZE = (64, 48)


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


@pytest.fixture
def folder(scene, tmp_path):
    folder = tmp_path / "cornell"
    count = rs.export_page(scene, folder, structures=["bvh", "grid"], size=SIZE, split=True)
    assert {one.name for one in folder.iterdir()} == FILES
    assert count == sum(one.stat().st_size for one in folder.iterdir())
    return folder


@pytest.fixture
def server(folder):
    """A server of static files; gives its address and the paths that it was asked for."""
    asked = []

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            asked.append(self.path)

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/", asked
        server.shutdown()
        thread.join()


def test_a_server_s_page_traces_and_asks_no_other(browser, scene, folder, server):  # noqa: F811
    address, asked = server
    with Exported(browser, f"{address}#structure=grid&mode=shadow&other=1", SIZE) as page:
        page.wait_for_samples(1)
        assert page.run("page => [page.structure, page.mode]") == ["grid", "shadow"]
        assert page.page.locator("#structure").input_value() == "grid"
        assert_same_hits(page, scene, "grid", rays_of(scene, 200))
        assert page.page.evaluate("document.getElementById('preview').naturalWidth") == SIZE[0]
        policy = page.page.locator("meta[http-equiv]").get_attribute("content")
        style = "getComputedStyle(document.getElementById('stage')).overflow"
        assert page.page.evaluate(style) == "hidden"
    paths = [one.split("?")[0].lstrip("/") or "index.html" for one in asked]
    assert sorted(paths) == sorted(FILES)
    assert {one for one in page.requests if not one.startswith(address)} <= {"data:,"}
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    assert "*" not in policy
    assert "http" not in policy


def test_from_disk_the_page_says_what_to_do(browser, folder):  # noqa: F811
    with Exported(browser, folder / "index.html", SIZE) as page:
        page.wait("!document.getElementById('message').hidden")
        assert "web server only" in page.message
        assert "http.server" in page.message
        assert page.page.locator("#preview").is_visible()
        assert page.page.locator("#controls").is_hidden()
        page.problems.clear()  # the browser's, that it does not fetch from disk


def test_a_missing_file_is_named(browser, folder, server):  # noqa: F811
    (folder / "data.bin").unlink()
    with Exported(browser, server[0], SIZE) as page:
        page.wait("!document.getElementById('message').hidden")
        assert "no data.bin (404)" in page.message
        page.problems.clear()  # the browser's, of the status


def test_a_cut_off_file_is_named(browser, folder, server):  # noqa: F811
    content = (folder / "data.bin").read_bytes()
    (folder / "data.bin").write_bytes(content[: len(content) // 2])
    with Exported(browser, server[0], SIZE) as page:
        page.wait("!document.getElementById('message').hidden")
        assert "incomplete or damaged" in page.message


def test_addresses_change_with_the_content(scene, folder):
    """Browsers may keep files of a page that is replaced."""
    before = (folder / "index.html").read_text()
    rs.export_page(scene, folder, structures=["grid"], size=SIZE, split=True)
    after = (folder / "index.html").read_text()
    for name in FILES - {"index.html"}:
        addresses = [text[text.index(f"{name}?") :].split('"')[0] for text in (before, after)]
        assert (addresses[0] == addresses[1]) == (name != "data.bin")


def test_folders_take_less(scene, folder, tmp_path):
    whole = rs.export_page(scene, tmp_path / "whole.html", structures=["bvh", "grid"], size=SIZE)
    assert sum(one.stat().st_size for one in folder.iterdir()) < whole


def test_files_are_no_folders(scene, tmp_path):
    (tmp_path / "page").write_text("a file")
    with pytest.raises(OSError, match="is a file, not a folder"):
        rs.export_page(scene, tmp_path / "page", size=(8, 8), split=True)
    with pytest.raises(OSError, match="missing"):
        rs.export_page(scene, tmp_path / "missing" / "page", size=(8, 8), split=True)
    with pytest.raises(ValueError, match="split: expected True or False, got 1"):
        rs.export_page(scene, tmp_path / "page", size=(8, 8), split=1)
