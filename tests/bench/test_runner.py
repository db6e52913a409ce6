"""The runner, with raystream and contenders made for it."""

from __future__ import annotations

import json

import numpy as np
import pytest

import raystream as rs
from raystream.bench import contenders
from raystream.bench.contenders import Entry, Peer
from raystream.bench.contenders.base import FirstHits, UnavailableError
from raystream.bench.contenders.own import Raystream
from raystream.bench.report import make_notes, make_tables, write_result
from raystream.bench.runner import Bench, Plan, geometry_of
from raystream.jit.threads import set_thread_count

pytestmark = pytest.mark.usefixtures("few_objects")

CALLS: list[str] = []


class Nearsighted(Raystream):
    """Cannot find all hits, and none beyond a distance."""

    modes = ("near", "far")
    queries = frozenset(("first", "any"))
    notes = "does not see far"

    def __init__(self, threads, options):  # noqa: ARG002
        super().__init__(threads, {})

    def first_hit(self, rays, mode):
        CALLS.append(mode)
        hits = super().first_hit(rays, mode)
        return hits if mode == "far" else FirstHits(np.full_like(hits.t, np.inf), hits.prim_id)


class Broken(Nearsighted):
    modes = ("",)

    def build(self, geometry):
        if len(geometry.faces) == 12:
            raise RuntimeError("no\nboxes")
        super().build(geometry)


class Missing(Nearsighted):
    def __init__(self, threads, options):  # noqa: ARG002
        raise UnavailableError("not today")


@pytest.fixture(autouse=True)
def peers(monkeypatch):
    made = {
        kind.__name__.lower(): Peer(f"bench_peers:{kind.__name__}", (), "pay for it")
        for kind in (Nearsighted, Broken, Missing)
    }
    module = type("Module", (), {k.__name__: k for k in (Nearsighted, Broken, Missing)})
    monkeypatch.setattr(contenders, "PEERS", made)
    find = contenders.importlib.import_module
    monkeypatch.setattr(
        contenders.importlib,
        "import_module",
        lambda name, *more: module if name == "bench_peers" else find(name, *more),
    )
    CALLS.clear()
    yield
    set_thread_count(None)


@pytest.fixture
def box():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return rs.Scene.from_arrays(corners, faces)


def run(scene, *names, sets=("primary", "ao", "multi"), **more):
    own = [Entry("raystream", "raystream", {})]
    entries = [*own, *(Entry(name, name, {}) for name in names)]
    plan = Plan(entries, sets, (8, 6), repeats=3, with_memory=False, **more)
    bench = Bench(plan)
    bench.open()
    bench.run("box", scene)
    return bench.result


def test_everybody_takes_part_in_every_round(box):
    result = run(box, "nearsighted")
    (scene,) = result.scenes
    assert scene.triangle_count == 12
    primary, _, multi = scene.sets
    assert {mode: len(times) for mode, times in primary.seconds["nearsighted"].items()} == {
        "near": 3,
        "far": 3,
    }
    assert CALLS[:2] == ["near", "far"]  # the warm-up
    assert len(primary.seconds["raystream"][""]) == 3
    assert primary.ray_count == 48
    assert primary.hit_count > 0
    # The worse of its modes counts for agreement.
    assert primary.agreement["nearsighted"] == (primary.hit_count / 48, 0)
    assert multi.failures == {"nearsighted": "does not support this query"}
    assert multi.hit_count == 2 * primary.hit_count  # in and out of the box
    assert primary.best_peer(result.peers) == "nearsighted"
    assert primary.ratio("raystream", "nearsighted") > 0


def test_absent_and_failing_contenders_are_reported(box):
    result = run(box, "broken", "missing")
    assert result.absent == {"missing": "not today (pay for it)"}
    assert result.scenes[0].failures == {"broken": "RuntimeError: no boxes"}
    assert result.labels == ["raystream", "broken"]
    notes = "\n".join(make_notes(result))
    assert "missing is absent: not today (pay for it)" in notes
    assert "box: broken: RuntimeError: no boxes" in notes


def test_variants_are_contenders(box):
    entries = [Entry("raystream", "raystream", {}), Entry("b", "raystream", {"max_leaf_size": 1})]
    bench = Bench(Plan(entries, ["primary"], (8, 6), repeats=1, with_memory=False))
    bench.open()
    bench.run("box", box)
    (scene,) = bench.result.scenes
    assert bench.result.own == ["raystream", "b"]
    assert scene.sets[0].agreement["b"].differing == 0.0


def test_wrong_options_are_refused(box):
    entries = [Entry("raystream", "raystream", {"speed": "high"})]
    with pytest.raises(TypeError, match="speed"):
        Bench(Plan(entries)).open()
    with pytest.raises(ValueError, match="raystream first"):
        Bench(Plan([Entry("warp", "warp", {})]))


def test_tables_and_json(box, tmp_path):
    result = run(box, "nearsighted")
    speeds, builds = make_tables(result)
    assert speeds.columns[:4] == ["rays", "count", "raystream", "nearsighted"]
    assert [row[0] for row in speeds.rows] == ["primary", "ao", "multi"]
    assert all(len(row) == len(speeds.columns) for row in speeds.rows)
    assert "! nearsighted" in speeds.rows[0][-1]
    assert speeds.rows[2][3] == "–"
    assert builds.rows[0][1] == "build, s"
    assert any("does not see far" in note for note in make_notes(result))
    for suffix in (".md", ".rst", ".json"):
        write_result(tmp_path / f"bench{suffix}", result)
    assert "| primary | 48 |" in (tmp_path / "bench.md").read_text()
    assert "   * - primary\n     - 48\n" in (tmp_path / "bench.rst").read_text()
    figures = json.loads((tmp_path / "bench.json").read_text())
    primary = figures["scenes"][0]["sets"][0]
    assert primary["agreement"]["nearsighted"]["flagged"] is True
    assert primary["best_peer"] == "nearsighted"
    assert set(primary["seconds"]["nearsighted"]) == {"near", "far"}


def test_what_is_measured_before_an_interrupt_stays(box, monkeypatch, tmp_path):
    count = iter(range(100))

    def first_hit(self, rays, mode):
        if next(count) == 3:
            raise KeyboardInterrupt
        return Raystream.first_hit(self, rays, mode)

    monkeypatch.setattr(Nearsighted, "first_hit", first_hit)
    entries = [Entry("raystream", "raystream", {}), Entry("nearsighted", "nearsighted", {})]
    bench = Bench(Plan(entries, ["primary"], (8, 6), repeats=3, with_memory=False))
    bench.open()
    with pytest.raises(KeyboardInterrupt):
        bench.run("box", box)
    assert make_tables(bench.result)
    write_result(tmp_path / "bench.json", bench.result)


def test_meshes_are_put_together_in_order():
    one = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    two = rs.Mesh([[0, 0, 5], [1, 0, 5], [0, 1, 5], [9, 9, 9]], [[0, 1, 2], [2, 1, 3]])
    geometry = geometry_of(rs.Scene([one, two]))
    assert geometry.vertices.shape == (7, 3)
    assert geometry.faces.tolist() == [[0, 1, 2], [3, 4, 5], [5, 4, 6]]
    assert (geometry.vertices.dtype, geometry.faces.dtype) == (np.float32, np.int32)
    with pytest.raises(ValueError, match="no triangles"):
        geometry_of(rs.Scene([]))
