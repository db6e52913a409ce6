"""The steps of a picked ray through a structure are those of `stepper.walk`."""

from __future__ import annotations

import base64
import io
import itertools

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from meshes import soup
from raystream.graphics.structures import shader_structure_of
from raystream.stepper import walk
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.kdtree.foley_layout import LEAF_BIT
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.options import TRAVERSALS
from raystream.web.structure_names import structure_names
from web.pages import Exported, browser  # noqa: F401  a fixture

STRUCTURES = [
    rs.Bvh(),
    rs.Brute(),
    *(rs.KdTree(traversal=one) for one in TRAVERSALS),
    rs.KdTree(traversal="backtrack", layout="foley"),
    rs.Grid(resolution=6),
    rs.Grid(resolution=3, levels=2),
    rs.Graph(),
]
NAMES = structure_names(STRUCTURES)

#: Those of everyday tests of walks.
EVERYDAY = {"bvh", "kdtree:traversal=restart", "grid:resolution=[3,3,3],levels=2"}

#: Kinds of a structure's visits, and those of some options.
KINDS = {
    "bvh": {"node", "leaf"},
    "kdtree": {"split", "leaf"},
    "grid": {"cell"},
    "graph": {"sector"},
}
MORE = {
    "kdtree:traversal=backtrack": {"up"},
    "kdtree:traversal=backtrack,layout=foley": {"up"},
    "grid:resolution=[3,3,3],levels=2": {"fine cell"},
}

#: Kernels of Python's machine that visit something, with the kinds of the page's visits.
VISITS = {"traverse": None, "down": "split", "leaf": "leaf", "up": "up"}


@pytest.fixture(scope="module")
def scene():
    return rs.Scene.from_arrays(*soup(300, seed=4))


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory, scene):  # noqa: F811
    path = tmp_path_factory.mktemp("pages") / "soup.html"
    rs.export_page(scene, path, structures=STRUCTURES, size=(16, 12))
    with Exported(browser, path, (480, 360)) as page:
        page.run("page => { page.scene.samples = 1; }")
        page.wait_for_samples(1)
        yield page


def rays_of(scene, count=40):
    rng = np.random.default_rng(7)
    low, high = scene.bounds
    origins = rng.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low), (count, 3))
    toward = rng.uniform(low, high, (count, 3))
    return np.column_stack([origins, toward - origins])


def visits_of(tracer, ray):
    """What Python's walk visits: kind, number, box, triangles tested, and the nearest hit then."""
    found = []
    for step in walk(tracer, ray[:3], ray[3:]).steps:
        if step.kernel in VISITS and step.at is not None:
            kind = VISITS[step.kernel] or step.at.kind
            found.append([kind, step.at.number, step.at.low, step.at.high, 0, -1, np.inf])
        elif step.counts.get("restarts"):
            found.append(["restart", step.to.number, step.to.low, step.to.high, 0, -1, np.inf])
        if found:
            found[-1][4] += len(step.tested)
            found[-1][5:] = step.prim_id, step.t
    return found


def numbers_in(tracer):
    """From a page's number, which is that of the shaders' arrays, to Python's."""
    structure = tracer.structure
    if structure.name == "grid":
        return lambda kind, number: number + (kind == "fine cell") * structure.lattice.cell_count
    if structure.name == "bvh":
        return lambda kind, number: number + (kind == "leaf") * len(structure.tree.nodes)
    if structure.name == "graph":
        return lambda _, number: number // SECTOR_ROWS
    if structure.options.layout == "compact":
        return lambda _, number: number
    is_leaf = structure.tree.nodes[:, 1] & 3 == LEAF_AXIS
    rows = {False: np.flatnonzero(~is_leaf), True: np.flatnonzero(is_leaf)}
    return lambda _, number: rows[bool(number >> LEAF_BIT)][number & ((1 << LEAF_BIT) - 1)]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.exhaustive] * (name not in EVERYDAY))
        for name in NAMES
        if name != "brute"
    ],
)
def test_walks_are_python_s(opened, scene, name):
    tracer = rs.Tracer(scene, STRUCTURES[NAMES.index(name)])
    number_of = numbers_in(tracer)
    rays = rays_of(scene)
    walks = opened.run(
        "(page, [name, rays]) => Promise.all(rays.map(ray => page.walkOf(name, ray)))",
        [name, rays.tolist()],
    )
    met = set()
    for ray, (found, count) in zip(rays, walks, strict=True):
        known = visits_of(tracer, ray)
        assert count == len(known)
        kinds = [one["kind"] for one in found]
        assert [kind.removeprefix("fine ") for kind in kinds] == [one[0] for one in known]
        numbers = [number_of(one["kind"], one["number"]) for one in found]
        assert numbers == [one[1] for one in known]
        assert [one["tests"] for one in found] == [one[4] for one in known]
        assert [one["primId"] for one in found] == [one[5] for one in known]
        distances = [one["distance"] for one in found]
        lengths = np.array([one[6] for one in known]) * np.linalg.norm(ray[3:])
        np.testing.assert_allclose(distances, lengths, rtol=1e-5)
        for one, (_, _, low, high, *_) in zip(found, known, strict=True):
            np.testing.assert_allclose([one["low"], one["high"]], [low, high], rtol=1e-5, atol=1e-5)
        met |= set(kinds)
    assert met - {"restart"} == KINDS[name.partition(":")[0]] | MORE.get(name, set())
    assert "restart" in met or name != "kdtree:traversal=restart"
    assert sum(count for _, count in walks) > 2 * len(rays)


def test_a_picked_ray_is_stepped_through(opened, scene):
    page = opened.page
    page.locator("#picture").click(position={"x": 240, "y": 180})
    opened.wait("!document.getElementById('walk').hidden")
    ray = np.array(opened.run("page => page.picked"))
    known = visits_of(rs.Tracer(scene), ray)
    rows = page.locator("#walk-list li").all_inner_texts()
    assert len(rows) == len(known)
    assert page.locator("#walk-title").inner_text() == f"{len(known)} steps"
    drawn = "() => { const c = document.getElementById('walk-picture'); return c.toDataURL(); }"
    pictures = set()
    for k, row in enumerate(rows):
        assert page.locator("#walk-text").inner_text() == f"{k + 1} of {len(rows)}: {row}"
        assert page.locator("#walk-list [aria-current]").inner_text() == row
        pictures.add(page.evaluate(drawn))
        assert page.locator("#walk-back").is_disabled() == (k == 0)
        assert page.locator("#walk-forward").is_disabled() == (k == len(rows) - 1)
        if k < len(rows) - 1:
            page.locator("#walk-forward").click()
    assert len(pictures) > len(rows) // 2
    page.locator("#walk-back").click()
    assert page.locator("#walk-text").inner_text().startswith(f"{len(rows) - 1} of")
    tested = [one for one in known if one[0] == "leaf"]
    assert f"{tested[0][4]} triangle" in next(row for row in rows if row.startswith("leaf"))
    # Another structure shows the same ray's steps there; brute force has none.
    page.select_option("#structure", "kdtree:traversal=restart")
    opened.wait("document.getElementById('hits-title').textContent.includes('restart')")
    other = rs.Tracer(scene, "kdtree", traversal="restart")
    assert page.locator("#walk-list li").count() == len(visits_of(other, ray))
    page.select_option("#structure", "brute")
    opened.wait("document.getElementById('walk').hidden")
    page.locator("#hits-close").click()
    assert opened.run("page => page.picked") is None


def test_boxes_are_drawn_where_they_are(opened, scene):
    """The root's box has the corners of the scene's, seen by the page's camera."""
    opened.page.select_option("#structure", "bvh")
    opened.page.locator("#picture").click(position={"x": 200, "y": 100})
    opened.wait("!document.getElementById('walk').hidden")
    drawn = opened.page.evaluate("document.getElementById('walk-picture').toDataURL()")
    drawn = base64.b64decode(drawn.split(",")[1])
    alpha = np.asarray(Image.open(io.BytesIO(drawn)).convert("RGBA"))[..., 3]
    camera, (width, height) = opened.run("page => [page.camera, page.size]")
    assert alpha.shape == (height, width)
    eye, up = np.array(camera["eye"]), np.array(camera["up"])
    forward = np.array(camera["look_at"]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    scale = height / 2 / np.tan(np.radians(camera["fov"]) / 2)
    for corner in itertools.product(*np.array(scene.bounds).T):
        toward = np.array(corner) - eye
        x = width / 2 + scale * (toward @ right) / (toward @ forward)
        y = height / 2 - scale * (toward @ np.cross(right, forward)) / (toward @ forward)
        assert alpha[int(y) - 1 : int(y) + 3, int(x) - 1 : int(x) + 3].any()
    assert 0 < np.count_nonzero(alpha) < alpha.size // 10
    opened.page.locator("#hits-close").click()
    assert opened.page.evaluate("document.getElementById('walk-picture').width") == 1
    places = [opened.page.locator(one).bounding_box() for one in ("#picture", "#walk-picture")]
    assert places[0] == places[1] == {"x": 0, "y": 0, "width": width, "height": height}


def test_shaders_of_queries_record_nothing():
    """Only the page's walk has a buffer for visits."""
    for options in STRUCTURES:
        if options.name != "brute":
            structure = shader_structure_of(rs.Tracer(rs.load("cornell"), options).structure)
            source = structure.source("compute.wgsl")
            assert source.count("fn visited(kind: u32, number: u32) {}") == 1
            assert "visits: array" not in source
