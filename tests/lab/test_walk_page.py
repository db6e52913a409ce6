"""The page: self-contained, with all walks, and safe against any name."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from extras import need

need("raystream_lab")

from raystream.kernels.tally import COLUMNS
from raystream_lab.walk_page import Outline, page, prisms, teaching_scene, write_page
from raystream_lab.walk_page.heat_maps import fan_cost, place_cost
from raystream_lab.walk_page.panels import make_panels
from raystream_lab.walk_page.teaching_rays import NamedRay, teaching_rays

#: Names that would end the element, begin a comment in it, or be markup if they were not text.
EVIL = "</script><script>alert(1)</script><!-- & <b> \u2028 'quoted' \"twice\""


class Elements(HTMLParser):
    """Elements and the text in them, as a browser would see them."""

    def __init__(self, text):
        super().__init__()
        self.found, self.texts, self.links = [], {}, []
        self._open = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.found.append(tag)
        self.links += [value for name, value in attributes if name in ("src", "href")]
        self._open = given.get("id", tag)

    def handle_endtag(self, tag):  # noqa: ARG002
        self._open = None

    def handle_data(self, data):
        if self._open:
            self.texts[self._open] = self.texts.get(self._open, "") + data


@pytest.fixture(scope="module")
def text():
    return page()


@pytest.fixture(scope="module")
def content(text):
    return json.loads(Elements(text).texts["content"])


def test_a_page_is_one_small_file(text):
    elements = Elements(text)
    assert len(text.encode()) < 1_000_000
    assert elements.links == []
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|import\(", text)
    addresses = set(re.findall(r"https?://[^\s\"'<]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name, not a place
    assert elements.found.count("script") == 2
    assert "<!-- style -->" not in text
    assert "<!-- script -->" not in text


def test_every_control_has_a_name(text):
    """Elements that scripts look up exist, and buttons have labels."""
    ids = set(re.findall(r'\bid="([^"]+)"', text))
    assert set(re.findall(r'byId\("([^"]+)"\)', text)) <= ids
    for button in re.findall(r"<button[^>]*>.*?</button>", text, re.DOTALL):
        label = re.search(r'aria-label="[^"]+"', button)
        assert label or re.search(r">[^<]*[A-Za-z]{3}", button), button


def test_content_is_the_walks(content):
    assert [panel["key"] for panel in content["panels"]] == [
        "grid", "kdtree-stack", "kdtree-restart", "kdtree-backtrack", "graph",
    ]  # fmt: skip
    assert [ray["name"] for ray in content["rays"]] == [ray.name for ray in teaching_rays()]
    plan = teaching_scene()
    panels = {panel.key: panel for panel in make_panels(plan)}
    for ray in content["rays"]:
        for key, steps in ray["walks"].items():
            tracer = panels[key].tracer
            hit = tracer.first_hit(*plan.ray(ray["origin"], ray["direction"]))
            sums = dict.fromkeys(COLUMNS, 0)
            for step in steps:
                for column, n in step["c"]:
                    sums[content["columns"][column]] += n
            counters = tracer.counters
            assert sums == {name: getattr(counters, name) for name in COLUMNS}
            assert steps[-1].get("p", -1) == hit.prim_id
            assert steps[-1].get("t", np.inf) == pytest.approx(float(hit.t), abs=1e-4)


def test_every_number_is_of_something(content):
    """Boxes, walls, strings and states that steps name are there."""
    drawings = content["drawings"]
    wall_count, string_count = len(content["plan"]["walls"]), len(content["strings"])
    for ray in content["rays"]:
        for key, steps in ray["walks"].items():
            drawing = drawings[drawings[key].get("same", key)]
            for step in steps:
                spots = [step[name] for name in ("a", "b") if name in step] + step.get("q", [])
                assert all(0 <= number < len(drawing["boxes"]) for number, _, _ in spots)
                assert all(0 <= prim_id < 2 * wall_count for prim_id in step.get("x", []))
                assert max(step["k"], step["w"], step["r"]) < string_count
                assert step["s"] < len(content["states"])
    for one in drawings.values():
        for row in one.get("links", []):
            assert all(0 <= number < len(one["boxes"]) for number in row)


def test_every_step_is_said_and_cited(content):
    strings = content["strings"]
    papers = {"grid": "Purcell 2002", "kdtree": "Foley 2005", "graph": "Rayforce 2013"}
    for ray in content["rays"]:
        for key, steps in ray["walks"].items():
            for step in steps:
                said, cited = strings[step["w"]], strings[step["r"]]
                assert said.endswith(".")
                assert "None" not in said
                assert "inf" not in said.split()
                paper = papers[key.split("-")[0]]
                if strings[step["k"]] == "shade":
                    paper = "Purcell 2002"
                assert cited.startswith(paper)
                assert "section" in cited
    continued = {
        key: {strings[s["r"]] for r in content["rays"] for s in r["walks"][key]
              if strings[s["k"]] == "continue"}
        for key in ("kdtree-stack", "kdtree-restart", "kdtree-backtrack")
    }  # fmt: skip
    sections = [re.search(r"section (\S+)", one.pop()).group(1) for one in continued.values()]
    assert sections == ["2.1", "2.2", "2.3"]


def test_the_crowded_cell_is_the_grids_trouble(content):
    """The scene's first ray has the counts that it is meant to show."""
    walks = content["rays"][0]["walks"]
    tested = {key: sum(len(step.get("x", [])) for step in steps) for key, steps in walks.items()}
    assert tested["grid"] > 3 * max(tested["kdtree-stack"], tested["graph"])


def test_names_stay_text():
    square = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]])
    plan = prisms([Outline(EVIL, square)])
    text = page(plan, [NamedRay(EVIL, EVIL, (1.0, 1.0), (1.0, 0.5))])
    elements = Elements(text)
    assert elements.found.count("script") == 2
    assert "b" in elements.found  # the template's own: not the names'
    assert elements.found.count("b") == 1
    content = json.loads(elements.texts["content"])
    assert content["plan"]["names"] == [EVIL]
    assert content["rays"][0]["name"] == content["rays"][0]["note"] == EVIL
    script = elements.texts["script"]
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", script)


def test_a_page_of_no_rays_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        page(rays=[])
    with pytest.raises(ValueError, match="is invalid"):
        page(rays=[NamedRay("nowhere", "", (1.0, 1.0), (0.0, 0.0))])


def test_a_page_is_written_as_a_whole(tmp_path, text):
    path = tmp_path / "walk.html"
    path.write_text("old")
    write_page(path)
    assert path.read_text(encoding="utf-8") == text
    assert [one.name for one in tmp_path.iterdir()] == ["walk.html"]


def test_heat_maps_are_the_tracers_counts(content):
    plan = teaching_scene()
    tracer = make_panels(plan)[0].tracer
    origin = (9.3, 6.4)
    cost = fan_cost(tracer, plan, origin, 8)
    hits = tracer.first_hit(*plan.ray(origin, [0.0, -1.0]))
    assert cost.t[6] == pytest.approx(float(hits.t), rel=1e-6)
    heat = content["heat"]["fan"]
    assert heat["tests"]["grid"][::45] == fan_cost(tracer, plan, origin, 4).tests.tolist()
    assert heat["steps"]["kdtree-restart"] != heat["steps"]["kdtree-stack"]
    small = place_cost(tracer, plan, (3, 4), 6)
    assert small.steps.shape == (3, 4)
    # Row 0 is the lowest y: the teapot's quarter costs the most tests.
    row, column = np.unravel_index(np.argmax(small.tests), (3, 4))
    low, high = plan.walls.min(axis=(0, 1)), plan.walls.max(axis=(0, 1))
    place = low + (np.array([column, row]) + 0.5) * (high - low) / (4, 3)
    assert place[0] > 8.0
    assert place[1] < 8.0
