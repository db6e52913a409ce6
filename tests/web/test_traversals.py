"""Several traversals of one kd-tree in one page, and counts per ray side by side."""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
import pytest

import raystream as rs
from meshes import soup
from raystream.kernels.tally import COLUMNS
from raystream.structures.kdtree.options import TRAVERSALS
from raystream.web.structure_names import structure_names
from web.pages import Exported, browser  # noqa: F401  a fixture

STRUCTURES = [rs.KdTree(traversal=one) for one in TRAVERSALS] + [
    rs.KdTree(traversal="backtrack", layout="foley"),
    rs.Bvh(),
    rs.Grid(resolution=8),
    rs.Graph(),
]
NAMES = [
    "kdtree",
    *(f"kdtree:traversal={one}" for one in TRAVERSALS[1:]),
    "kdtree:traversal=backtrack,layout=foley",
    "bvh",
    "grid",
    "graph",
]

#: Those of everyday tests of counts.
EVERYDAY = {"kdtree:traversal=restart", "kdtree:traversal=backtrack", "grid"}


@pytest.fixture(scope="module")
def scene():
    """A tree of some depth, so that restarts and link nodes are met."""
    return rs.Scene.from_arrays(*soup(300, seed=4))


@pytest.fixture(scope="module")
def path(tmp_path_factory, scene):
    path = tmp_path_factory.mktemp("pages") / "soup.html"
    rs.export_page(scene, path, structures=STRUCTURES, size=(48, 36))
    return path


@pytest.fixture(scope="module")
def opened(browser, path):  # noqa: F811
    with Exported(browser, path, (480, 360)) as page:
        page.run("page => { page.scene.samples = 1; }")
        page.wait_for_samples(1)
        yield page


def rays_of(page):
    rays = page.run(
        """page => { const rays = []; for (let y = 0.5; y < 36; y++) for (let x = 0.5; x < 48; x++)
        rays.push(...page.rayThrough(x / 48, y / 36)); return rays; }"""
    )
    return np.array(rays).reshape(-1, 6)


def test_names_say_what_differs():
    assert structure_names(STRUCTURES) == NAMES


def test_equal_arrays_are_kept_once(path):
    text = path.read_text()
    start = text.index(">", text.index('id="data"')) + 1
    whole = zlib.decompress(base64.b64decode(text[start : text.index("</script>", start)]), -15)
    manifest = json.loads(whole[8 : 8 + int.from_bytes(whole[4:8], "little")])
    arrays = {name: one["arrays"] for name, one in manifest["structures"].items()}
    assert list(arrays) == NAMES
    tree = arrays["kdtree"]
    assert tree == ["kdtree array 0", "kdtree array 1"]
    assert arrays["kdtree:traversal=restart"] == tree
    assert arrays["kdtree:traversal=short-stack"] == tree
    assert arrays["kdtree:traversal=backtrack"] == [*tree, "kdtree:traversal=backtrack array 2"]
    assert set(manifest["arrays"]) >= {name for names in arrays.values() for name in names}


def test_structures_share_buffers(opened):
    same = opened.run(
        """(page, [one, two]) => page.onGpu(one).resources.map(
        (buffer, k) => buffer === page.onGpu(two).resources[k])""",
        ["kdtree", "kdtree:traversal=restart"],
    )
    assert same == [True, True]


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.exhaustive] * (one not in EVERYDAY)) for one in NAMES],
)
def test_counts_are_the_cpu_s(opened, scene, name):
    rays = rays_of(opened)
    found = opened.run(
        "async (page, [name, rays]) => Array.from(await page.queriesOf(name).counts(Float64Array"
        ".from(rays)))",
        [name, rays.reshape(-1).tolist()],
    )
    counts = np.array(found).reshape(-1, len(COLUMNS))
    tracer = rs.Tracer(scene, STRUCTURES[NAMES.index(name)], counters=True)
    tracer.first_hit(rays[:, :3], rays[:, 3:])
    known = np.stack([getattr(tracer.counters, column) for column in COLUMNS], axis=1)
    same = (counts == known).all(axis=1)
    assert same.mean() > 0.99
    assert counts.sum(axis=0) == pytest.approx(known.sum(axis=0), rel=0.005)
    assert (counts[:, 0] > 0).mean() > 0.3


def test_the_table_compares_structures(opened, scene):
    opened.page.locator("#compare").click()
    opened.wait(
        "!['compare', 'counts'].some(one => document.getElementById(one).disabled"
        " || document.getElementById(one).hidden)"
    )
    rows = [row.split("\t") for row in opened.page.locator("#counts-table tr").all_inner_texts()]
    assert rows[0] == [
        *("Structure", "Steps down", "Steps up", "Leaves", "Tests", "Restarts", "Link nodes")
    ]
    assert [row[0] for row in rows[1:]] == NAMES
    table = {row[0]: [float(part) for part in row[1:]] for row in rows[1:]}
    stack, restart, backtrack, short = (table[name] for name in NAMES[:4])
    # All visit the same leaves; without a stack, more nodes (Foley 2005).
    assert stack[2:4] == restart[2:4] == backtrack[2:4] == short[2:4]
    assert stack[0] < short[0] + 1e-9 <= restart[0] + 1e-9
    assert restart[0] > stack[0]
    assert backtrack[1] > 0 == stack[1] == restart[1]
    assert restart[4] > 0 == stack[4]
    opened.page.locator("#counts-close").click()
    assert opened.page.locator("#counts").is_hidden()
