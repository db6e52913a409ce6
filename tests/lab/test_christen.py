"""Christen's experiments: bounces match the renderer, and passes add up."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("raystream_lab")

import raystream as rs
from raystream_lab import Runner, Store
from raystream_lab.christen import image_times, kernel_calls, pixel_memory, scenes
from raystream_lab.frame_timing import render_context
from raystream_lab.published import published
from raystream_lab.recording_tracer import RecordingTracer


@pytest.fixture
def runner(tmp_path):
    store = Store(tmp_path / "measurements.json", {}, "test")
    return Runner(tmp_path, store, size=16, quick=True)


def test_scenes_have_as_many_triangles_as_his():
    theirs = published("christen", "table 6.1").values
    for letter, count in theirs.items():
        scene = scenes.christen_scene(letter)
        assert scene.triangle_count == count
        assert all(max(material.transmission) == 0.0 for material in scene.materials)


def test_the_teapot_or_what_stands_in_for_it(monkeypatch):
    scene, about = scenes.teapot_model()
    if "no model" not in about:
        assert scene.triangle_count == 61_256
        assert {material.reflection for material in scene.materials} == {(0.3, 0.3, 0.3)}

    real = scenes.load

    def refuse(name):
        if name == "teapot_bezier":
            raise rs.FileFormatError(name, "is not here")
        return real(name)

    monkeypatch.setattr(scenes, "load", refuse)
    scene, about = scenes.teapot_model()
    assert about == "no model of a teapot was found: `spheres` replaces it, without glass"
    assert scene.triangle_count == rs.load("spheres").triangle_count
    assert all(max(material.transmission) == 0.0 for material in scene.materials)
    table = image_times._scenes({"A": 36, scenes.TEAPOT: scene.triangle_count})
    assert table.records()[-1]["why they differ"] == about
    assert table.records()[-1]["published"] == 60_000


def test_grids_are_his():
    assert image_times.GRIDS[0] == 5
    assert image_times.GRIDS[-1] == 100
    assert image_times.LETTERS == ("A", "B", "C", scenes.TEAPOT)


def test_memory_of_a_pixel_is_that_of_the_loop(runner):
    scene = scenes.christen_scene("B")
    tracer = rs.Tracer(scene, "grid", machine="multipass", resolution=5)
    one = pixel_memory.loop_bytes(tracer, 1)
    assert one == pixel_memory.loop_bytes(tracer, 8)
    # A shadow ray of 60 bytes to each of the three lights, and another for a fourth.
    more = scene.replace(lights=[*scene.lights, scene.lights[0]])
    brighter = rs.Tracer(more, "grid", machine="multipass", resolution=5)
    assert pixel_memory.loop_bytes(brighter, 8) == one + 60
    assert pixel_memory.result_bits() == 32 * 6
    result = runner.run("christen-memory", pixel_memory.pixel_memory)
    assert [claim.verdict for claim in result.claims] == ["holds", "does not hold (0 of 1)"]


def test_a_matte_base_reflects_fewer_rays():
    counts = {
        name: [len(one.directions) for one in scenes.bounces_of(scene, 32, 3)]
        for name in ("A", scenes.MATTE_BASE)
        for scene in [scenes.christen_scene(name)]
    }
    assert counts["A"][0] == counts[scenes.MATTE_BASE][0]
    assert 0 < counts[scenes.MATTE_BASE][1] < counts["A"][1] / 2


def test_bounces_are_mirrored_rays():
    scene = scenes.christen_scene("A")
    first, second, third = scenes.bounces_of(scene, 16, 3)
    assert [one.iteration for one in (first, second, third)] == [1, 2, 3]
    _, directions = scene.camera_for(1.0).rays(16, 16)
    np.testing.assert_allclose(first.directions, directions.reshape(-1, 3), atol=1e-6)
    hits = rs.Tracer(scene).first_hit(first.origins, first.directions)
    # Every surface mirrors.
    mirrors = hits.is_hit
    assert len(second.directions) <= mirrors.sum()
    assert len(third.directions) <= len(second.directions)
    starts = hits.positions[mirrors]
    for origin in second.origins[::17]:
        assert np.linalg.norm(starts - origin, axis=1).min() < 1e-4  # metres
    assert first.light_ray_count > 0


def test_iterations_match_the_renderer():
    scene = scenes.christen_scene("B")
    tracer = rs.Tracer(scene, "grid", resolution=5)
    seconds, light = scenes.timed_iterations(render_context(tracer, (12, 12)), tracer, 12, 4)
    assert len(seconds) == 4
    assert seconds == sorted(seconds)
    options = {"max_bounces": 3, "min_weight": 0.0}
    image = rs.render(scene, "whitted", (12, 12), shadows=False, **options)
    assert light == pytest.approx(float(image.pixels.mean(dtype=np.float64)), rel=1e-6)


def test_times_are_without_shadow_rays():
    scene = scenes.christen_scene("B")
    for shadows in (False, True):
        tracer = RecordingTracer(scene, "grid", resolution=5)
        context = render_context(tracer, (12, 12))
        tracer.queries.clear()
        scenes.timed_iterations(context, tracer, 12, 3, shadows=shadows)
        assert ("any_hit" in {one.query for one in tracer.queries}) == shadows


def test_passes_run_on_all_that_rays_meet():
    scene = scenes.christen_scene("B")
    (bounce, *_) = scenes.bounces_of(scene, 16, 1)
    found = kernel_calls.passes_of(scene, bounce, 0.2, 5)
    counting = rs.Tracer(scene, "grid", resolution=5, counters=True)
    counting.first_hit(bounce.origins, bounce.directions)
    total = counting.counters.total
    kernels = found["kernels"]
    assert kernels["intersect"][1] == total["tests"]
    assert kernels["set up"][:2] == [1, found["rays"]]
    assert sum(count for count, _, _ in kernels.values()) == found["passes"] >= found["optimal"]
    for count, runs, masked in kernels.values():
        assert runs + masked == count * found["rays"]


def test_calls_have_rows_for_every_bounce(runner, monkeypatch):
    monkeypatch.setattr(kernel_calls, "LETTERS", (scenes.MATTE_BASE,))
    result = kernel_calls.kernel_calls(runner)
    (table, kernels, sweep) = result.tables
    rows = table.records()
    assert [row["iteration"] for row in rows] == list(range(1, len(rows) + 1))
    assert sum(row["of all rays"] for row in rows) == pytest.approx(1.0)
    assert sum(row["of all passes"] for row in rows) == pytest.approx(1.0)
    for row in rows:
        own = [one for one in kernels.records() if one["iteration"] == row["iteration"]]
        assert sum(one["passes"] for one in own) == row["passes"]
        assert sum(one["rejected, of all pixels"] for one in own) == row["rejected early"]
    assert len(sweep.columns) == 1 + len(kernel_calls._QUICK_THRESHOLDS)
    assert len(result.claims) == 4


def test_times_are_cumulative(runner, monkeypatch):
    monkeypatch.setattr(image_times, "LETTERS", ("A",))
    result = image_times.image_times(runner)
    table = result.tables[1].records()
    grids = [f"{one}³" for one in image_times._QUICK_GRIDS]
    for machine in ("branching", "multipass"):
        assert [row["grid"] for row in table if row["machine"] == machine] == grids
    for row in table:
        numbers = [row[str(k)] for k in range(1, image_times.ITERATIONS + 1)]
        assert numbers == sorted(numbers)
    assert [plot.name for plot in result.plots] == [
        "christen-grids-1",
        f"christen-grids-{image_times.ITERATIONS}",
        "christen-iterations",
    ]


def test_a_crowded_grid_is_left_out_with_its_reason(runner, monkeypatch):
    monkeypatch.setattr(image_times, "MAX_TESTS", 1)
    scene = scenes.christen_scene("A")
    value = runner.run("x", lambda runner: image_times._multipass(runner, scene, "A", 20))
    assert value["most_tests"] > 1
    assert "seconds" not in value
