"""Renderers as one loop on the multipass machine: the images of their stages, bit for bit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits, tier
from raystream.machines import MultipassBackend
from raystream.machines.ray_streams import RayStreams
from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS
from raystream.rendering import ray_loops
from raystream.structures import names_with

SIZE = (24, 18)

MODES = {
    "raycast": {},
    "vis": {},
    "shadow": {},
    "whitted": {"max_bounces": 5},
    "whitted, no shadows": {"shadows": False},
    "arnold": {"preset": "arnold"},
    "path": {"max_bounces": 4},
    "kajiya": {},
    "ao": {"rays": 6},
}

STRUCTURES = [*names_with("multipass")]
TRAVERSALS = {"kdtree": ["stack", "restart", "backtrack", "short-stack"]}

#: All modes on one structure and scheduler, and each structure and scheduler in one mode; two modes
#: in a default run.
WAYS = list(itertools.product(STRUCTURES, SCHEDULERS))
CASES = [
    pytest.param(
        mode,
        *way,
        marks=tier(
            is_everyday=way == ("grid", "threshold") and mode in ("raycast", "whitted"),
            is_ci=way == ("grid", "threshold") or WAYS.index(way) % len(MODES) == place,
        ),
        id=f"{mode}-{way[0]}-{way[1]}",
    )
    for place, mode in enumerate(MODES)
    for way in WAYS
]


@pytest.fixture(scope="module")
def scene():
    """Mirrors, glass, and points of light."""
    return rs.load("spheres")


def looped(scene, structure="grid", scheduler="threshold", **options):
    return rs.Tracer(scene, structure, machine="multipass", scheduler=scheduler, **options)


def render(scene, mode, **options):
    return rs.render(scene, mode, size=SIZE, samples=2, seed=3, **options)


def assert_one_loop(image, sample_count=2):
    """Not the queries of the stages."""
    assert image.figures["passes"]["eye rays"] >= sample_count
    assert image.figures["passes"]["shade"] >= sample_count


@pytest.mark.parametrize(("mode", "structure", "scheduler"), CASES)
def test_images_have_the_bits_of_the_stages(scene, mode, structure, scheduler):
    options, mode = MODES[mode], {"arnold": "path"}.get(mode, mode.partition(",")[0])
    if "preset" in options:
        scene = rs.load("cornell")  # with a lamp that rays hit
    expected = render(scene, mode, **options)
    image = render(looped(scene, structure, scheduler), mode, **options)
    assert_one_loop(image)
    assert_same_bits(image.pixels, expected.pixels)
    assert image.pixels.any()


def test_modes_without_a_loop_are_rendered_by_queries():
    scene = rs.load("three_boxes")
    machines = {}, {"machine": "multipass"}
    images = [rs.render(rs.Tracer(scene, "grid", **one), "xray", (12, 9)) for one in machines]
    np.testing.assert_array_equal(images[0].pixels, images[1].pixels)
    assert images[0].pixels.any()


def test_a_ray_caster_shades_once(scene):
    """As in the loop of Purcell 2002, section 3.2: its passes are those of the query."""
    tracer = rs.Tracer(scene, "grid", machine="multipass", counters=True)
    tracer.first_hit(*scene.camera_for(SIZE[0] / SIZE[1]).rays(*SIZE))
    passes = {name: tracer.counters.passes.of(name) for name in ("traverse", "intersect", "shade")}
    found = rs.render(looped(scene), "raycast", size=SIZE).figures["passes"]
    assert found == {"eye rays": 1, "set up": 1, **passes}
    assert passes["shade"] == 1
    compact = rs.render(looped(scene, compaction=True), "raycast", size=SIZE).figures["passes"]
    assert compact["shade"] > 1, "rays that have ended are shaded before they are dropped"


@pytest.mark.ci
@pytest.mark.parametrize("traversal", TRAVERSALS["kdtree"])
def test_each_kd_traversal(scene, traversal):
    tracer = looped(scene, "kdtree", traversal=traversal)
    image = render(tracer, "whitted")
    assert_one_loop(image)
    assert_same_bits(image.pixels, render(scene, "whitted").pixels)


@pytest.mark.ci
@pytest.mark.parametrize("compaction", [False, True])
@pytest.mark.parametrize("steps", [1, 4])
def test_unrolling_and_compaction(scene, steps, compaction):
    tracer = looped(scene, traversal_steps=steps, intersections=steps, compaction=compaction)
    assert_same_bits(render(tracer, "whitted").pixels, render(scene, "whitted").pixels)


@pytest.mark.ci
def test_rays_of_several_bounces_are_in_one_loop(scene, monkeypatch):
    """New rays go back to set-up while others are still traced."""
    bounces = []
    plain = RayStreams.run

    def run(self, kernel, counters):
        count = plain(self, kernel, counters)
        is_active = ~np.isin(self.streams["state"].array, [RayState.DONE, RayState.NO_ROOM])
        bounces.append(set(self.streams["pixel"].array["bounce"][is_active]))
        return count

    monkeypatch.setattr(RayStreams, "run", run)
    render(looped(scene, "bvh", "most-work"), "path", max_bounces=4, lights="file")
    assert max(map(len, bounces)) > 1


@pytest.mark.ci
def test_memory_does_not_grow_with_mirrors(monkeypatch):
    """Christen 2005, section 5.2.1: it is the same for any number of bounces."""
    rooms = []
    plain = ray_loops._Columns.empty.__func__
    monkeypatch.setattr(
        ray_loops._Columns,
        "empty",
        classmethod(lambda cls, *sizes: rooms.append(sizes) or plain(cls, *sizes)),
    )
    scene = rs.load("cornell_mirrors")
    for bounces in (1, 50):
        image = render(looped(scene), "whitted", max_bounces=bounces, min_weight=0.0)
        expected = render(scene, "whitted", max_bounces=bounces, min_weight=0.0)
        assert_same_bits(image.pixels, expected.pixels)
    assert {room for _, room, _ in rooms} == {1}


@pytest.mark.ci
def test_glass_takes_more_room_in_parts(scene, monkeypatch):
    expected = render(scene, "whitted", min_weight=0.0)
    parts = []
    begin, grown = MultipassBackend.run_loop, ray_loops._Columns.grown

    def run_loop(self, *arguments):
        monkeypatch.setattr(ray_loops, "MAX_BYTES", 1 << 12)  # after the size of bands was chosen
        begin(self, *arguments)

    def note(self, numbers, room, shadows):
        parts.append((id(self), room))
        return grown(self, numbers, room, shadows)

    monkeypatch.setattr(MultipassBackend, "run_loop", run_loop)
    monkeypatch.setattr(ray_loops._Columns, "grown", note)
    image = render(looped(scene), "whitted", min_weight=0.0)
    assert len(parts) > len(set(parts)), "several parts of one band"
    assert max(room for _, room in parts) >= 4
    assert_same_bits(image.pixels, expected.pixels)


@pytest.mark.ci
def test_bands_fit_in_memory(scene, monkeypatch):
    monkeypatch.setattr(ray_loops, "MAX_BYTES", 1 << 17)
    image = render(looped(scene), "whitted")
    assert image.figures["passes"]["eye rays"] > 2
    assert_same_bits(image.pixels, render(scene, "whitted").pixels)


def test_progress_within_a_sample_can_end_it(scene):
    shown = []

    def progress(done, total):
        shown.append(done / total)
        if 0.0 < done < total:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        rs.render(looped(scene), "whitted", SIZE, progress=progress)
    assert 0.0 < shown[-1] < 1.0


@pytest.mark.ci
@pytest.mark.parametrize("what", ["layers", "camera", "opacity", "counters"])
def test_what_is_no_loop_is_rendered_by_queries(scene, what):
    options = {}
    if what == "layers":
        options["layers"] = ["depth"]
    elif what == "camera":
        options["camera"] = rs.Camera(
            (0.0, 1.0, 0.0), (0.0, 1.0, -1.0), projection="equirectangular"
        )
    elif what == "opacity":
        scene = sheet()
    tracer = looped(scene, counters=what == "counters")
    image = render(tracer, "shadow", **options)
    assert "passes" not in image.figures
    assert_same_bits(image.pixels, render(scene, "shadow", **options).pixels)


def sheet():
    """A square, half transparent."""
    material = rs.Material(name="sheet", diffuse=(0.8, 0.2, 0.2), opacity=0.5)
    vertices = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    mesh = rs.Mesh(np.array(vertices, np.float32), np.array([[0, 1, 2], [0, 2, 3]]))
    return rs.Scene([mesh], materials=[material])


def test_a_scheduler_of_ones_own(scene):
    class Last:
        """The last kernel for which rays wait."""

        def choose(self, queues):
            assert queues.spawns
            return max(k for k, count in enumerate(queues.waiting) if count)

    image = render(looped(scene, "kdtree", Last()), "shadow", lights="file")
    assert_same_bits(image.pixels, render(scene, "shadow").pixels)


def test_a_tracer_that_overrides_queries_is_asked(scene):
    class Own(rs.Tracer):
        def first_hit(self, *rays, **options):
            return super().first_hit(*rays, **options)

    tracer = Own(scene, "grid", machine="multipass")
    assert tracer.loop_machine is None
    assert isinstance(looped(scene).loop_machine, MultipassBackend)
