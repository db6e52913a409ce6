"""``raystream export``."""

from __future__ import annotations

import re

import pytest

import raystream as rs
from raystream.cli.export import STRUCTURES
from raystream.structures import names_with


def test_a_page_is_written(run, tmp_path):
    page = tmp_path / "page.html"
    said = run("export", "cornell", "-o", page, "--structure", "grid", "--size", "32x24")
    assert f"{len(page.read_bytes()):,} bytes" in said.out
    figures = run("export", "cornell", "-o", page, "--size", "32x24", "--json").figures
    assert figures["bytes"] == len(page.read_bytes())
    assert figures["triangles"] == 36
    assert re.search(r"<title>cornell", page.read_text())


def test_structures_have_options(run, tmp_path):
    page = tmp_path / "page.html"
    structures = ("kdtree", "kdtree:traversal=restart,max_leaf_size=2", "grid:resolution=[2,3,4]")
    chosen = [part for one in structures for part in ("--structure", one)]
    run("export", "cornell", "-o", page, *chosen, "--size", "32x24")
    before = page.read_bytes()
    resolution = (2, 3, 4)
    options = [rs.KdTree(), rs.KdTree(traversal="restart", max_leaf_size=2)]
    options.append(rs.Grid(resolution=resolution))
    rs.export_page(rs.load("cornell"), page, structures=options, size=(32, 24))
    assert page.read_bytes() == before


def test_a_folder_is_written(run, tmp_path):
    figures = run(
        "export", "cornell", "-o", tmp_path / "page", "--split", "--size", "32x24", "--json"
    ).figures
    files = {one.name: one.stat().st_size for one in (tmp_path / "page").iterdir()}
    assert set(files) == {"index.html", "page.js", "page.css", "preview.png", "data.bin"}
    assert figures["bytes"] == sum(files.values())


def test_known_structures():
    assert set(STRUCTURES) == set(names_with("graphics"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["cornell", "-o", "{}/page.png"], "html"),
        (["cornell", "-o", "{}/no/page.html"], "does not exist"),
        (["cornell", "-o", "{}/no/page", "--split"], "does not exist"),
        (["cornell", "-o", "{}/page.html", "--split"], "without .html"),
        (["cornell", "-o", __file__, "--split"], "is a file"),
        (["cornell", "-o", "{}/page.html", "--structure", "octree"], "octree"),
        (["cornell", "-o", "{}/page.html", "--structure", "kdtree:traversal=ropes"], "ropes"),
        (["cornell", "-o", "{}/page.html", "--structure", "bvh:traversal=stack"], "traversal"),
        (["cornell", "-o", "{}/page.html", "--structure", "kdtree:"], "KEY=VALUE"),
        (["robots", "-o", "{}/page.html", "--projection", "orthographic"], "'orthographic'"),
        (["nothing", "-o", "{}/page.html"], "nothing"),
    ],
)
def test_bad_input_is_named(run, tmp_path, arguments, message):
    complaint = run("export", *(one.format(tmp_path) for one in arguments)).complaint
    assert message in complaint
    assert not list(tmp_path.iterdir())


def test_scenes_without_shaders_are_named(tmp_path):
    ball = rs.Scene.combine([rs.load("cornell"), rs.Scene.spheres([[0, 0, 0]], 1.0)])
    box = rs.Scene.instances([rs.load("cornell")], [[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]])
    sheet = rs.Scene(rs.load("cornell").meshes, materials=[rs.Material(roughness=0.5)] * 4)
    for scene, what in ((ball, "spheres"), (box, "instances"), (sheet, "roughness")):
        with pytest.raises(rs.RaystreamError, match=what):
            rs.export_page(scene, tmp_path / "page.html", size=(8, 8))
    with pytest.raises(ValueError, match="structures"):
        rs.export_page(rs.load("cornell"), tmp_path / "page.html", structures=[])
    with pytest.raises(TypeError, match=r"structures: expected a list, such as \['bvh'\]"):
        rs.export_page(rs.load("cornell"), tmp_path / "page.html", structures="bvh")
    with pytest.raises(ValueError, match="'bvh' twice"):
        rs.export_page(rs.load("cornell"), tmp_path / "page.html", structures=["bvh", "bvh"])
    with pytest.raises(ValueError, match="a tracer has its own"):
        rs.export_page(rs.Tracer(rs.load("cornell")), tmp_path / "page.html", structures=["bvh"])
    assert not list(tmp_path.iterdir())
