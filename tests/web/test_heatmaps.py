"""Heat maps of pages are Python's: counts, colours and the top of the scale."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

import raystream as rs
from meshes import soup
from raystream.rendering.color import encode_srgb
from raystream.rendering.false_colors import color_ramp
from raystream.rendering.heatmap import HEATMAPS
from raystream.web.heatmaps import counts_of, ramp_words
from web.pages import Exported, browser  # noqa: F401  a fixture

STRUCTURES = {
    "kdtree": rs.KdTree(traversal="backtrack"),
    "bvh": rs.Bvh(),
    "grid": rs.Grid(resolution=6),
    "graph": rs.Graph(),
}


@pytest.fixture(scope="module")
def scene():
    return rs.Scene.from_arrays(*soup(300, seed=4))


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory, scene):  # noqa: F811
    path = tmp_path_factory.mktemp("pages") / "soup.html"
    rs.export_page(scene, path, structures=list(STRUCTURES.values()), size=(16, 12))
    with Exported(browser, path, (240, 180)) as page:
        page.run("page => { page.scene.samples = 2; }")
        yield page


def heatmap_of(page, scene, what, structure):
    """Choose a heat map; returns Python's of the same view and samples."""
    page.page.select_option("#mode", f"heatmap {what}")
    page.page.select_option("#structure", structure)
    page.wait(
        f"raystream.opened.then(p => p.mode === 'heatmap {what}' && p.structure === '{structure}'"
        " && p.sample === 2 && !p.isRunning)"
    )
    size = tuple(page.run("page => page.size"))
    camera = scene.camera_for(size[0] / size[1])
    options = STRUCTURES[structure]
    return rs.heatmap(scene, what, size, samples=2, structure=options, camera=camera)


@pytest.mark.parametrize(
    ("what", "structure"),
    [
        *(("steps", "kdtree"), ("tests", "bvh")),
        *(
            pytest.param(what, structure, marks=pytest.mark.exhaustive)
            for what, structure in (("cells", "bvh"), ("cells", "grid"), ("tests", "graph"))
        ),
    ],
)
def test_counts_are_python_s(opened, scene, what, structure):
    heat = heatmap_of(opened, scene, what, structure)
    counts = opened.run(f"page => page.scene.structures.{structure}.counts.{what}")
    found = opened.light()[..., counts["channel"]]
    same = found == heat.counts
    assert same.mean() > 0.995
    assert found.mean() == pytest.approx(heat.counts.mean(), rel=1e-3)
    assert found.std() > 0.3
    assert heat.title.startswith(counts["title"])
    title = opened.page.locator("#legend-title").inner_text()
    assert title == f"{counts['title']} per ray"
    top = float(opened.page.locator("#legend-top").inner_text())
    assert top == pytest.approx(found.max(), abs=0.051)


def test_colours_are_python_s(opened, scene):
    heat = heatmap_of(opened, scene, "tests", "bvh")
    cover = "for (const id of ['controls', 'readout']) document.getElementById(id).style.visibility"
    opened.page.evaluate(f"() => {{ {cover} = 'hidden'; }}")
    shot = opened.page.locator("#picture").screenshot()
    opened.page.evaluate(f"() => {{ {cover} = ''; }}")
    pixels = np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)
    known = heat.image.to_bytes()[: pixels.shape[0]].astype(int)
    close = (np.abs(pixels - known) <= 1).all(axis=2)
    assert close.mean() > 0.99
    assert pixels.std() > 20


def test_the_legend_belongs_to_heat_maps(opened):
    opened.page.select_option("#mode", "raycast")
    opened.wait("raystream.opened.then(p => p.mode === 'raycast' && p.sample >= 1)")
    assert opened.page.locator("#legend").is_hidden()


def test_the_modes_are_python_s(opened):
    choices = opened.page.locator("#mode option").evaluate_all("all => all.map(one => one.value)")
    assert [one for one in choices if " " in one] == [f"heatmap {what}" for what in HEATMAPS]


def test_cells_are_those_that_the_structure_counts():
    channels = {one.name: counts_of(one.name)["cells"]["channel"] for one in STRUCTURES.values()}
    assert channels == {"kdtree": 1, "bvh": 1, "grid": 0, "graph": 0}


def test_the_ramp_is_python_s():
    words = ramp_words()
    bytes_ = words.view(np.uint8).reshape(-1, 4)
    np.testing.assert_array_equal(bytes_[:, :3], encode_srgb(color_ramp()))
    assert (bytes_[:, 3] == 255).all()
