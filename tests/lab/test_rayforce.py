"""The poster's experiments: properties of scenes, and tables that agree with queries."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from raystream_lab import Runner, Store
from raystream_lab.frame_timing import affordable_size, frame_seconds, render_context
from raystream_lab.rayforce import graph_statistics, hidden_triangles, layers, render_modes, scenes
from raystream_lab.rayforce.start_walks import secondary_rays, start_walks
from raystream_lab.recording_tracer import RecordingTracer
from raystream_lab.results import Result
from raystream_lab.views import view


@pytest.fixture
def runner(tmp_path):
    store = Store(tmp_path / "measurements.json", {}, "test")
    return Runner(tmp_path, store, size=16, quick=True)


def rows_of(result, name):
    (table,) = (one for one in result.tables if one.name == name)
    return table.records()


def test_every_ray_meets_every_layer_once():
    scene = layers.layered_scene(5)
    origins, directions = scene.camera_for(1.0).rays(32, 32)
    found = rs.Tracer(scene, "brute").multi_hit(origins, directions)
    assert (np.diff(found.ray_splits) == 5).all()
    sheet = found.prim_id.reshape(-1, 5) // (2 * layers.CELLS**2)
    np.testing.assert_array_equal(sheet, np.tile(np.arange(5), (1024, 1)))


@pytest.mark.parametrize("place", hidden_triangles.PLACES)
def test_added_triangles_are_hidden(place):
    bare, more = (hidden_triangles.scene_with_hidden(place, factor) for factor in (0, 3))
    added = 3 * rs.load(hidden_triangles.VISIBLE).triangle_count
    assert more.triangle_count == bare.triangle_count + added
    rays = bare.camera_for(1.0).rays(24, 24)
    one, other = (rs.Tracer(scene).first_hit(*rays) for scene in (bare, more))
    np.testing.assert_array_equal(one.prim_id, other.prim_id)
    assert one.is_hit.all()
    # Without the wall, rays would hit objects behind it.
    centres = more.meshes[-1].vertices.reshape(-1, 3, 3).mean(axis=1)
    eye = np.asarray(more.camera.eye)
    blocked = rs.Tracer(bare).any_hit(eye, centres - eye, t_max=1.0)
    assert blocked.mean() > 0.9 if place == hidden_triangles.PLACES[0] else True


def test_a_place_must_be_known():
    with pytest.raises(ValueError, match=r"place: expected one of behind a wall, beside the view"):
        hidden_triangles.scene_with_hidden("below", 1)


def test_hidden_counts_are_those_of_a_query(runner, monkeypatch):
    monkeypatch.setattr(hidden_triangles, "STRUCTURES", ("graph", "bvh"))
    result = hidden_triangles.hidden_triangles(runner)
    rows = rows_of(result, "rayforce-hidden")
    assert len(rows) == len(hidden_triangles.PLACES) * 3 * 2
    assert all(row["pixels that changed"] == 0 for row in rows)
    scene = hidden_triangles.scene_with_hidden(hidden_triangles.PLACES[1], 8)
    tracer = rs.Tracer(scene, "graph", counters=True)
    tracer.first_hit(*scene.camera_for(1.0).rays(16, 16))
    total = tracer.counters.total
    (row,) = (
        row
        for row in rows
        if (row["more triangles"], row["times"], row["structure"])
        == (hidden_triangles.PLACES[1], 8, "graph")
    )
    assert row["steps"] == (total["steps"] + total["link_nodes"]) / 256
    assert row["tests"] == total["tests"] / 256
    assert row["triangles"] == scene.triangle_count
    assert len(result.images) == 2
    # The claim begins with no hidden triangles at all.
    (claim,) = result.claims
    assert "with 0 hidden triangles, up to 8 times" in claim.text
    for place in hidden_triangles.PLACES:
        each = {
            row["times"]: row["steps"]
            for row in rows
            if (row["more triangles"], row["structure"]) == (place, "graph")
        }
        ratios = each[1] / each[0], each[8] / each[0]
        assert f"steps, {place}: {min(ratios):.2f} to {max(ratios):.2f}" in claim.evidence


def test_modes_count_the_rays_of_the_poster(runner, monkeypatch):
    monkeypatch.setattr(render_modes, "scenes", lambda runner, _: [runner.view("cornell")])
    monkeypatch.setattr(render_modes, "STRUCTURES", ("graph", "bvh"))  # all would compile for long
    result = render_modes.render_modes(runner)
    for mode in render_modes.MODES:
        rows = rows_of(result, f"rayforce-{mode}")
        assert [row["structure"] for row in rows] == ["graph", "bvh"]
        assert rows[0]["time / graph's"] == 1.0
        per_pixel = {row["rays per pixel"] for row in rows}
        if mode in ("vis", "xray"):
            assert per_pixel == {1.0}
        if mode == "ao":
            assert all(1.0 < rays <= 33.0 for rays in per_pixel)
    (claim,) = result.claims
    rates = [row["frames/s"] for mode in render_modes.MODES for row in first_rows(result, mode)]
    held = sum(rate >= render_modes.INTERACTIVE for rate in rates)
    assert len(rates) == 4
    assert claim.verdict == {0: "does not hold (0 of 4)", 4: "holds"}.get(
        held, f"holds in {held} of 4"
    )
    assert all(image.path.exists() for image in result.images)


def first_rows(result, mode):
    return [row for row in rows_of(result, f"rayforce-{mode}") if row["structure"] == "graph"]


def test_ambient_occlusion_traces_32_rays_per_hit():
    scene = rs.load("cornell")
    tracer = RecordingTracer(scene)
    frame_seconds(render_context(tracer, (16, 12)), tracer, "ao", (16, 12))
    counts = {
        query: sum(one.ray_count for one in tracer.queries if one.query == query)
        for query in ("first_hit", "any_hit", "multi_hit")
    }
    hits = rs.Tracer(scene).first_hit(*scene.camera_for(16 / 12).rays(16, 12))
    assert counts == {
        "first_hit": 16 * 12,
        "any_hit": 32 * int(hits.is_hit.sum()),
        "multi_hit": 0,
    }


def test_kajiya_traces_the_rays_of_the_poster():
    """Visibility and two interreflection rays, first hits; a shadow ray from each of the hits."""
    scene = rs.load("cornell")
    tracer = RecordingTracer(scene)
    frame_seconds(render_context(tracer, (16, 12)), tracer, "kajiya", (16, 12))
    first, shadows = (
        [one.ray_count for one in tracer.queries if one.query == query]
        for query in ("first_hit", "any_hit")
    )
    band_count = len(first) // 3
    assert len(first) == 3 * band_count, "1 + 2 per band"
    assert len(shadows) <= 3 * band_count
    assert 2 * 16 * 12 < sum(first) <= 3 * 16 * 12
    assert 0 < sum(shadows) <= sum(first)


def test_images_get_smaller_only_as_far_as_needed():
    assert affordable_size(1e-6, (1024, 768), 1.0, (256, 192)) == (1024, 768)
    assert affordable_size(3e-6, (1024, 768), 1.0, (256, 192)) == (512, 384)
    assert affordable_size(1.0, (1024, 768), 1.0, (256, 192)) == (256, 192)


def test_the_graph_is_described(runner, monkeypatch):
    monkeypatch.setattr(graph_statistics, "scenes", lambda runner, _: [runner.view("spheres")])
    result = graph_statistics.graph_statistics(runner)
    tracer = rs.Tracer(rs.load("spheres"), "graph")
    (row,) = rows_of(result, "rayforce-graph")
    assert row["sectors"] == tracer.structure.quality()["sectors"]
    memory = rows_of(result, "rayforce-structures")[0]
    assert memory["bytes per triangle"] == tracer.structure.report.byte_count / row["triangles"]
    sizes = {
        row["structure"]: row["bytes per triangle"]
        for row in rows_of(result, "rayforce-structures")
    }
    claim, displaced = result.claims
    held = sum(sizes["graph"] <= sizes[name] for name in ("bvh", "kdtree", "grid"))
    assert claim.verdict == (f"holds in {held} of 3" if held else "does not hold (0 of 3)")
    eye, *_ = rows_of(result, "rayforce-walks")
    assert eye["rays"] == "from the eye"
    assert eye["sectors passed, mean"] <= eye["most"]
    # All rays from one place begin in one sector, and walk as far.
    assert eye["sectors passed, mean"] == eye["most"]
    leaving = rows_of(result, "rayforce-displacement")
    assert [row["rays"] for row in leaving] == ["ao", "first bounce", "second bounce"]
    assert all(0.0 <= row["saved, of all"] < 1.0 for row in leaving)
    assert displaced.verdict == "holds"


def test_displacement_beats_bins(runner):
    view = runner.view("spheres")
    tracer = rs.Tracer(view.scene, "graph")
    rays = list(secondary_rays(tracer, view, 24))
    assert [one.kind for one in rays] == ["ao", "first bounce", "second bounce"]
    assert len(rays[0].origins) == 32 * len(rays[1].origins)
    for one in rays:
        assert (one.sectors >= 0).all()
        walks = start_walks(tracer.structure, one)
        assert walks.displaced <= 0.05
        assert walks.bins > walks.displaced
        assert walks.in_turn <= walks.bins + 0.2
    lost = rays[1]._replace(sectors=np.full(len(rays[1].origins), -1, np.int32))
    walks = start_walks(tracer.structure, lost)
    assert walks.displaced == walks.bins


def test_rays_from_surfaces_leave_them():
    chosen = view("spheres")
    sets = graph_statistics.ray_sets(chosen, 16)
    assert list(sets) == list(graph_statistics.RAYS)
    origins, directions = sets["from surfaces"]
    eyes, toward = sets["from the eye"]
    hits = rs.Tracer(chosen.scene).first_hit(eyes, toward)
    seen = hits[hits.is_hit]
    assert len(origins) == hits.is_hit.sum()
    sides = np.sign((seen.normals * directions).sum(axis=1))
    arriving = np.sign((seen.normals * toward[hits.is_hit]).sum(axis=1))
    np.testing.assert_array_equal(sides, -arriving)


def test_scenes_are_timed_opaque_and_lit():
    glass = rs.Material("glass", opacity=0.1, diffuse=(0.5, 0.4, 0.3))
    corners = [[-1, -1, 0], [1, -1, 0], [0, 1, 0]]
    scene = rs.Scene([rs.Mesh(corners, [[0, 1, 2]])], materials=[glass])
    timed = scenes.prepared(scene)
    assert [one.opacity for one in timed.materials] == [1.0]
    assert timed.materials[0].diffuse == glass.diffuse
    (light,) = timed.lights
    camera = scene.camera_for(1.0)
    assert camera.look_at == timed.camera_for(1.0).look_at
    right, up, _ = camera.basis()
    away = np.asarray(light.position) - camera.eye
    np.testing.assert_allclose(away @ right, away @ up, rtol=1e-6)
    assert away @ right > 0.0
    assert scenes.prepared(timed).lights == timed.lights


def test_substitutes_need_no_samples(runner):
    result = Result()
    assert [one.name for one in scenes.scenes(runner, result)] == list(scenes.STAND_INS)


def test_all_structures_find_all_layers(runner):
    rows = rows_of(layers.layers(runner), "rayforce-layer-counts")
    assert {row["structure"] for row in rows} == set(scenes.STRUCTURES)
    for row in rows:
        assert row["hits"] == row["layers"]
        assert row["tests, all hits"] >= row["hits"]
        assert row["steps, all hits"] >= row["steps, first hit"]
