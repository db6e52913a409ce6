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
