"""Notebook representations of tracers and scenes."""

from __future__ import annotations

from html.parser import HTMLParser

import numpy as np
import pytest

import raystream as rs
from raystream.notebook import html_table, in_bytes


class Reader(HTMLParser):
    """Rows of the one table; fails on tags that are not closed as they were opened."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.title = ""
        self.feed(text)
        self.close()
        assert not self.open
        self.rows = dict(zip(self.cells[::2], self.cells[1::2], strict=True))

    def handle_starttag(self, tag, _):
        self.open.append(tag)
        if tag in ("th", "td"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        if self.open[-1] == "caption":
            self.title += text
        else:
            self.cells[-1] += text


def test_text_is_escaped():
    table = Reader(html_table("<b>&", [("<i>", '"<script>alert(1)</script>')]))
    assert table.title == "<b>&"
    assert table.rows == {"<i>": '"<script>alert(1)</script>'}


def test_colours_are_the_pages():
    text = html_table("title", [("name", "value")])
    assert "color:inherit" in text
    assert "#" not in text
    assert "background" not in text


@pytest.mark.parametrize(
    ("count", "shown"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (999.7, "1 kB"),
        (1_234_567, "1.23 MB"),
        (5e15, "5,000 TB"),
    ],
)
def test_bytes_for_people(count, shown):
    assert in_bytes(count) == shown


@pytest.mark.parametrize("structure", ["bvh", "kdtree", "graph", "grid", "brute"])
def test_tracer_shows_its_structure(structure):
    tracer = rs.Tracer(rs.load("cornell"), structure)
    rows = Reader(tracer._repr_html_()).rows
    assert (rows["triangles"], rows["structure"]) == ("36", structure)
    assert (rows["machine"], rows["device"]) == ("branching", "cpu")
    assert rows["build"].endswith(" s")
    assert rows["memory"] == in_bytes(tracer.structure.report.byte_count)
    for name, value in tracer.structure.quality().items():
        assert rows[name] == f"{value:,.6g}"


def test_options_and_what_cannot_be_hit_are_shown():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0]])
    scene = rs.Scene.from_arrays(vertices, [[0, 1, 2], [0, 0, 1], [0, 1, 3]])
    tracer = rs.Tracer(
        scene, "kdtree", traversal="restart", machine="multipass", scheduler="double"
    )
    rows = Reader(tracer._repr_html_()).rows
    assert rows["triangles"] == "3 (1 degenerate, 1 not finite)"
    assert rows["  traversal"] == "restart"
    assert (rows["machine"], rows["  scheduler"]) == ("multipass", "double")


def test_saved_structure_shows_itself(tmp_path):
    rs.Tracer(rs.load("cornell")).save(tmp_path / "saved.npz")
    rows = Reader(rs.Tracer.load(tmp_path / "saved.npz")._repr_html_()).rows
    assert (rows["triangles"], rows["structure"]) == ("36", "bvh")


def test_scene_shows_what_is_in_it():
    table = Reader(rs.load("cornell")._repr_html_())
    assert table.title == "Scene cornell"
    assert (table.rows["triangles"], table.rows["meshes"]) == ("36", "8")
    assert table.rows["lights"] == "1 area"
    assert table.rows["high corner"] == "556 548.8 559.2"


def test_scene_of_nothing_and_of_a_wicked_name():
    table = Reader(rs.Scene(name="<script>")._repr_html_())
    assert table.title == "Scene <script>"
    assert (table.rows["triangles"], table.rows["lights"]) == ("0", "none")
