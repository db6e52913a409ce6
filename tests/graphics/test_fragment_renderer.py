"""Renderers as fragment programs in one loop: the images and passes of the CPU's loop."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import raystream as rs
from dark_views import DARK_VIEWS
from graphics.fragment_counts import counted_fragments, counts_of
from raystream.graphics import backend
from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.backend import MultipassBackend
from raystream.graphics.rendering import path_rows
from raystream.machines.ray_streams import RayStreams
from raystream.machines.schedulers import SCHEDULERS, Threshold
from raystream.structures import names_with

pytestmark = pytest.mark.usefixtures("opened")

#: A pixel differs if a channel does by more than this, relative to brightness above 1: shading is
#: float32 here and mostly float64 on the CPU, and highlights magnify its rounding.
DIFFERENCE = 5e-4

#: The share of pixels that may differ: in a mirror or glass, a ray that hits another triangle.
DIFFERING = 1e-3

MODES = {
    "raycast": {},
    "vis": {},
    "shadow": {},
    "whitted": {"max_bounces": 5},
    "whitted, no shadows": {"shadows": False, "max_bounces": 2},
    "arnold": {"preset": "arnold"},
    "path": {"max_bounces": 4},
    "kajiya": {},
    "ao": {"rays": 4},
}

#: Christen's scenes, then others; with structures whose passes on them are few.
SCENES = {
    "three_boxes": "grid",
    "cubes": "grid",
    "spheres": "grid",
    "cornell": "kdtree",
    "bunny": "grid",
    "robots": "kdtree",
}
SAMPLES = ("bunny",)
CHRISTEN = ("three_boxes", "cubes", "spheres")
TRAVERSALS = {"kdtree": {"traversal": "restart"}}

IN_CI = {
    ("three_boxes", "raycast"),
    ("cubes", "shadow"),
    ("three_boxes", "whitted"),
    ("cornell", "arnold"),
    ("cornell", "path"),
}

CASES = [
    pytest.param(
        name,
        mode,
        marks=[pytest.mark.exhaustive] * ((name, mode) not in IN_CI),
        id=f"{name}-{mode}",
    )
    for name in SCENES
    for mode in MODES
]


def tracer_of(scene, structure="grid", device="graphics", **options):
    own = {**TRAVERSALS.get(structure, {}), **options}
    return rs.Tracer(scene, structure, device, machine="multipass", **own)


def pictures(scene, mode, size=(40, 32), structure="grid", **options):
    """The image of the graphics device's loop, and the CPU's."""
    name = {"arnold": "path"}.get(mode, mode.partition(",")[0])
    own = {**MODES.get(mode, {}), **options}
    ours, theirs = (
        rs.render(tracer_of(scene, structure, device), name, size, **own)
        for device in ("graphics", "cpu")
    )
    assert_one_loop(ours)
    return ours, theirs


def assert_one_loop(image):
    """Not the queries of the stages."""
    assert image.figures["passes"]["eye rays"] >= 1


def assert_alike(ours, theirs, differing=DIFFERING):
    difference = np.abs(ours.pixels - theirs.pixels) / np.maximum(theirs.pixels, 1.0)
    count = np.count_nonzero((difference > DIFFERENCE).any(axis=2))
    assert count <= differing * difference[..., 0].size, difference.max()


@pytest.fixture
def runs(monkeypatch):
    """On how many rays each kernel ran, in all passes of loops, by device."""
    counts = {"graphics": Counter(), "cpu": Counter()}
    batches, run = MultipassBackend._loop_batches, RayStreams.run

    def counted_batches(self, work, kernels, streams):
        for batch in batches(self, work, kernels, streams):
            for number, count in batch.passes:
                counts["graphics"][kernels[number].name] += count
            yield batch

    def counted_run(self, kernel, counters):
        count = run(self, kernel, counters)
        name = self._steps.kernels[kernel].name
        if name != "eye rays":  # before the batches
            counts["cpu"][name] += count
        return count

    monkeypatch.setattr(MultipassBackend, "_loop_batches", counted_batches)
    monkeypatch.setattr(RayStreams, "run", counted_run)
    return counts


@pytest.mark.filterwarnings("ignore:light_samples=False")  # black, but its passes count
@pytest.mark.parametrize(("name", "mode"), CASES)
def test_images_and_passes_are_the_cpu_s(name, mode, runs):
    if name in SAMPLES and "RAYSTREAM_SCENES" not in os.environ:
        pytest.skip("needs public models: set RAYSTREAM_SCENES to their folder")
    scene = rs.load(name)
    is_ci = (name, mode) in IN_CI
    size = (40, 32) if is_ci else (96, 96)
    ours, theirs = pictures(scene, mode, size, SCENES[name])
    assert_alike(ours, theirs)
    # No path hits a point of light.
    assert theirs.pixels.any() != (mode == "arnold" and name in ("cubes", "spheres"))
    passes, expected = ours.figures["passes"], theirs.figures["passes"]
    assert set(passes) == set(expected)
    if mode in ("raycast", "vis") and name in CHRISTEN:
        assert passes == expected
    # Each ray takes the CPU's steps, but for a few that rounding sends elsewhere.
    assert runs["graphics"] == pytest.approx(runs["cpu"], rel=1e-3)
    # Sooner or later one of them decides whether enough rays wait for an intersection, and from
    # there on the passes are others: their number is chaotic. Moving the eye by 3e-8 of its
    # distance changes it on the CPU, too: in robots, whose rays take most steps, by up to 3 %
    # (whitted) and 7 % (ao: 6,790 to 7,275 passes, while the sum of `runs` changes by 0.003 %).
    share = 0.08 if mode in ("whitted", "ao") and name == "robots" else 0.01
    assert sum(passes.values()) == pytest.approx(sum(expected.values()), rel=share)


@pytest.mark.parametrize("structure", names_with("graphics multipass"))
def test_each_structure(structure):
    scene = rs.load("three_boxes")
    ours, theirs = pictures(scene, "whitted", (16, 12), structure)
    assert_alike(ours, theirs)
    assert ours.figures["passes"] == theirs.figures["passes"]


def test_kd_backtrack():
    options = {"traversal": "backtrack"}
    scene = rs.load("three_boxes")
    ours, theirs = (
        rs.render(tracer_of(scene, "kdtree", device, **options), "shadow", (24, 16))
        for device in ("graphics", "cpu")
    )
    assert ours.figures["passes"] == theirs.figures["passes"]
    assert ours.figures["passes"]["up"] > 0
    assert_alike(ours, theirs)


@pytest.mark.parametrize("loop", ["device", "queries"])
@pytest.mark.parametrize("scheduler", SCHEDULERS)
def test_every_scheduler_makes_the_cpu_s_passes(scheduler, loop):
    scene = rs.load("three_boxes")
    options = {"scheduler": scheduler, "traversal_steps": 2, "intersections": 3}
    ours = rs.render(tracer_of(scene, loop=loop, **options), "whitted", (24, 16), max_bounces=3)
    theirs = rs.render(
        tracer_of(scene, device="cpu", **options), "whitted", (24, 16), max_bounces=3
    )
    assert ours.figures["passes"] == theirs.figures["passes"]
    assert_alike(ours, theirs)


def test_a_scheduler_of_ones_own_sees_that_shading_spawns():
    seen = []

    class Own(Threshold):
        def choose(self, queues):
            seen.append(queues.spawns)
            return super().choose(queues)

    scene = rs.load("three_boxes")
    tracer = tracer_of(scene, loop="queries", scheduler=Own())
    image = rs.render(tracer, "shadow", (16, 12), lights="file")
    assert_one_loop(image)
    assert set(seen) == {True}


@pytest.mark.parametrize("loop", ["device", "queries"])
def test_nothing_but_counts_is_read_before_the_last_pass(opened, loop, monkeypatch):
    """Ray states, hits and light stay on the device until the image is done."""
    calls, depth = [], []
    queue = type(opened.device.queue)
    for name in ("submit", "read_buffer", "read_texture"):
        plain = getattr(queue, name)

        def note(self, *arguments, _name=name, _plain=plain, **options):
            depth.append(None)  # reading submits a copy
            try:
                found = _plain(self, *arguments, **options)
            finally:
                depth.pop()
            if not depth:
                calls.append((_name, len(found) if _name == "read_buffer" else 0))
            return found

        monkeypatch.setattr(queue, name, note)
    scene = rs.load("spheres")
    tracer = tracer_of(scene, loop=loop)
    calls.clear()
    image = rs.render(tracer, "whitted", (32, 24), max_bounces=2, lights="file")
    assert_one_loop(image)
    names = [name for name, _ in calls]
    first = names.index("read_texture")
    # Then the light of each pixel, and whether a search has not ended.
    assert names[first:] == ["read_texture"] * 2
    passes = sum(image.figures["passes"].values())
    sizes = [size for name, size in calls if name == "read_buffer"]
    if loop == "queries":
        # A word of 8 bytes for each state to which a kernel may move rays.
        assert len(sizes) >= passes
        assert max(sizes) <= 8 * 8
    else:
        # The device counts and chooses: the host reads, every 8 to 64 passes, which ran.
        assert passes / 64 <= len(sizes) <= passes / 16 + 8
        assert max(sizes) < 4 * 32 * 24


def test_early_rejection_saves_work(opened, monkeypatch):
    """Fragments of rejected pixels are not run: as many run as pixels wait for a kernel."""
    if not opened.has_early_test:
        pytest.skip("the adapter moves the stencil test behind programs that write a counter")
    size = (64, 48)
    pixels = size[0] * size[1]
    shading = 3  # the last kernel of a grid: only those of the traversal count
    near = rs.Camera((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), fov=60.0)
    far = rs.Camera((0.0, 0.0, 30.0), (0.0, 0.0, 0.0), fov=60.0)
    wall = rs.Mesh([[-9, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]], [[0, 1, 2], [0, 2, 3]])
    shares = {}
    for name, camera in (("none rejected", near), ("many rejected", far)):
        scene = rs.Scene([wall], camera=camera, lights=[rs.PointLight((0.0, 0.0, 1.0), (9.0,) * 3)])
        active = []
        for is_early in (True, False):
            with counted_fragments(opened, monkeypatch, is_early=is_early) as counts:
                batches = MultipassBackend._loop_batches

                def noted(self, *arguments, _batches=batches, _active=active):
                    for batch in _batches(self, *arguments):
                        _active.append(batch.passes)
                        yield batch

                with monkeypatch.context() as patch:
                    patch.setattr(MultipassBackend, "_loop_batches", noted)
                    active.clear()
                    rs.render(tracer_of(scene), "shadow", size)
                passes = [one for batch in active for one in batch if one[0] != shading]
                drawn = int(counts_of(counts).sum())
            if is_early:
                assert drawn == sum(count for _, count in passes)
                shares[name] = drawn / (len(passes) * pixels)
            else:
                assert drawn >= len(passes) * pixels, "without the test before it"
    assert shares["many rejected"] < 0.5 * shares["none rejected"]


def test_glass_takes_more_room(monkeypatch):
    grown = []
    plain = path_rows.PathRows.grow
    monkeypatch.setattr(
        path_rows.PathRows, "grow", lambda self, encoder: grown.append(plain(self, encoder))
    )
    scene = rs.load("spheres")
    ours, theirs = pictures(scene, "whitted", (48, 36), max_bounces=4, min_weight=0.0)
    assert grown
    assert_alike(ours, theirs)
    assert sum(ours.figures["passes"].values()) == pytest.approx(
        sum(theirs.figures["passes"].values()), rel=0.01
    )


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize("name", DARK_VIEWS)
def test_dark_views_get_the_cpu_s_lights_by_default(name):
    """Those of one program on the CPU, too, which makes no passes."""
    scene = DARK_VIEWS[name]()
    ours, theirs = pictures(scene, "shadow", (24, 18))
    assert_alike(ours, theirs)
    assert_alike(ours, rs.render(scene, "shadow", (24, 18)))
    assert np.median(theirs.pixels) > 0.01


@pytest.mark.exhaustive
@pytest.mark.filterwarnings("ignore::raystream.core.errors.RaystreamWarning")
@pytest.mark.parametrize("name", ["sibenik", "conference"])
@pytest.mark.parametrize("machine", ["compute", "branching", "multipass"])
def test_dark_models_do_too(name, machine):
    """Rooms without lights, whose images were black on this device."""
    if "RAYSTREAM_SCENES" not in os.environ:
        pytest.skip("needs public models: set RAYSTREAM_SCENES to their folder")
    tracing = TRAVERSALS["kdtree"] if machine == "multipass" else {}
    scene = rs.load(name)
    ours, theirs = (
        rs.render(rs.Tracer(scene, "kdtree", **own), "path", (64, 48), 1, max_bounces=2).pixels
        for own in ({"device": "graphics", "machine": machine, **tracing}, {})
    )
    assert theirs.mean() > 0.05
    assert ours.mean() == pytest.approx(theirs.mean(), rel=1e-3)


def test_too_many_paths_behind_glass_are_an_error(monkeypatch):
    monkeypatch.setattr(path_rows, "_MOST_ROOM", 2)
    with pytest.raises(GraphicsError, match="more than 2 paths at once behind glass; use"):
        rs.render(tracer_of(rs.load("spheres")), "whitted", (48, 36), max_bounces=4, min_weight=0.0)


@pytest.mark.parametrize("sampler", ["sobol", "random"])
def test_samples_are_the_cpu_s(sampler):
    """The numbers of pixels, lenses and paths have the same bits."""
    scene = rs.load("cornell")
    camera = scene.camera_for(1.0)
    lens = replace(camera, aperture=0.05, focus=3.0)
    ours, theirs = pictures(
        scene, "path", (24, 24), samples=4, seed=7, sampler=sampler, camera=lens, max_bounces=5
    )
    assert_alike(ours, theirs, 0.01)


def test_a_camera_far_outside():
    """Its rays start at the scene's box, as on the CPU."""
    scene = rs.load("three_boxes")
    camera = rs.Camera((4000.0, 3000.0, 9000.0), (0.0, 0.0, 0.0), fov=0.05)
    ours, theirs = pictures(scene, "shadow", (48, 32), camera=camera)
    assert_alike(ours, theirs)
    assert len(np.unique(theirs.pixels.reshape(-1, 3), axis=0)) > 100
    away = rs.Camera((4000.0, 3000.0, 9000.0), (8000.0, 6000.0, 18000.0))
    ours, theirs = pictures(scene, "raycast", (8, 8), camera=away)
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)


LIGHTS = {
    "point": rs.PointLight((1.0, 2.0, 1.0), (5.0, 4.0, 3.0)),
    "steady": rs.PointLight((1.0, 2.0, 1.0), (0.5, 0.4, 0.3), falloff="none"),
    "sun": rs.DirectionalLight((-1.0, -3.0, -0.5), (2.0, 2.0, 1.0)),
    "sky": rs.EnvironmentLight((0.2, 0.3, 0.4)),
}


@pytest.mark.parametrize("mode", ["whitted", "path"])
def test_lights_colours_normals_and_far_frames_are_those_of_the_cpu(mode):
    """Several lights of each kind, glossy and coloured, far from the origin and small."""
    away = np.array([4000.0, -70.0, 900.0])
    base = [[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]]
    floor = rs.Mesh(
        base + away, [[0, 2, 1], [0, 3, 2]], colors=np.eye(4, 3), material_ids=np.zeros(2, int)
    )
    tilted = np.array([[-1.0, 1, 0.2], [1, 1, 0.2], [0, 1, -1]]) / np.sqrt([[2.04], [2.04], [2]])
    roof = rs.Mesh(
        np.array([[-1, 1, 0], [1, 1, 0], [0, 1.5, -1]]) * 0.5 + away,
        [[0, 1, 2]],
        normals=tilted,
        material_ids=np.ones(1, int),
    )
    lamp = rs.Mesh(
        np.array([[-0.2, 3, 0], [0.2, 3, 0], [0.0, 3, 0.3]]) + away,
        [[0, 1, 2]],
        material_ids=np.full(1, 2),
    )
    glossy = rs.Material(diffuse=(0.5,) * 3, specular=(0.3,) * 3, shininess=20.0)
    mirror = rs.Material(diffuse=(0.3,) * 3, specular=(0.4,) * 3, reflection=(0.6,) * 3)
    glow = rs.Material(diffuse=(0.0,) * 3, emission=(5.0, 4.0, 3.0))

    def moved(light):
        if isinstance(light, rs.PointLight):
            return rs.PointLight(away + light.position, light.intensity, light.falloff)
        return light

    scene = rs.Scene(
        [floor, roof, lamp],
        materials=[glossy, mirror, glow],
        lights=list(map(moved, LIGHTS.values())),
        camera=rs.Camera(tuple(away + [0.5, 2.0, 4.0]), tuple(away)),
        background=(0.1, 0.2, 0.3),
    )
    ours, theirs = pictures(scene, mode, (40, 32), "brute", max_bounces=3)
    assert_alike(ours, theirs, 0.005)
    assert len(np.unique(theirs.pixels.reshape(-1, 3), axis=0)) > 100


@pytest.mark.exhaustive
@pytest.mark.parametrize("transform", [None, (0.9, -1.2, 0.25, 1.1, 0.5, -0.75)])
@pytest.mark.parametrize(
    "wrap", ["repeat", "clamp", ("mirror", "clamp"), ("repeat", "mirror"), ("clamp", "repeat")]
)
def test_diffuse_textures_are_looked_up_alike(rng, wrap, transform):
    """Coordinates from -1 to 3 over a few texels, and a mesh without any."""
    bitmap = rng.integers(0, 256, (3, 5, 3)).astype(np.uint8)
    corners = np.array([[-1.0, -1, -2], [1, -1, -2], [1, 1, -2], [-1, 1, -2]])
    texcoords = [[-1.0, -1], [3, -1], [3, 2.5], [-1, 2.5]]
    textured = rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]], texcoords=texcoords)
    plain = rs.Mesh(corners * 0.3 + [0, 0, -0.4], [[0, 1, 2], [0, 2, 3]])
    material = rs.Material(
        diffuse=(0.9, 0.8, 0.7),
        textures={"diffuse": rs.Texture(bitmap, wrap=wrap, transform=transform)},
    )
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=60.0)
    scene = rs.Scene([textured, plain], materials=[material], camera=camera)
    ours, theirs = pictures(scene, "raycast", structure="brute")
    assert_alike(ours, theirs)
    assert len(np.unique(theirs.pixels.reshape(-1, 3), axis=0)) > 100


def test_two_mirrors_that_face_each_other_add_up_to_a_geometric_series():
    """The eye between two walls of r = 1/2 that glow: 1 + 1/2 + 1/4 + ... of that."""
    glowing = rs.Material(diffuse=(0.0,) * 3, reflection=(0.5,) * 3, emission=(1.0, 2.0, 4.0))
    corners = np.array([[-9.0, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1]])
    ahead = rs.Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    behind = rs.Mesh(corners * [1, 1, -1], [[0, 2, 1], [0, 3, 2]])
    camera = rs.Camera((0, 0, 0), (0, 0, -1), fov=4.0)
    tracer = tracer_of(rs.Scene([ahead, behind], materials=[glowing], camera=camera), "brute")
    for bounces in (0, 1, 5):
        image = rs.render(tracer, "whitted", (8, 8), max_bounces=bounces, min_weight=0.0)
        expected = np.array([1.0, 2.0, 4.0]) * (2.0 - 0.5**bounces)
        np.testing.assert_allclose(image.pixels, np.broadcast_to(expected, (8, 8, 3)), rtol=1e-5)
    ends = rs.render(tracer, "whitted", (8, 8), max_bounces=9, min_weight=0.3)
    np.testing.assert_allclose(ends.pixels[4, 4], [1.5, 3.0, 6.0], rtol=1e-5)


@pytest.mark.exhaustive
def test_absorbing_glass():
    glass = rs.Material(
        diffuse=(0.1,) * 3, transmission=(0.9,) * 3, ior=1.5, absorption=(0.2, 1.0, 3.0)
    )
    scene = rs.load("spheres")
    ball = rs.Scene(
        scene.meshes,
        materials=[glass] * len(scene.materials),
        lights=scene.lights,
        camera=scene.camera_for(1.0),
        background=(0.5, 0.7, 0.9),
    )
    for mode in ("whitted", "path"):
        ours, theirs = pictures(ball, mode, (24, 24), max_bounces=3)
        assert_alike(ours, theirs, 0.01)


SHEET = {
    "opaque": rs.Material(opacity=0.5),
    "rough": rs.Material(roughness=0.5),
    "bump": rs.Material(textures={"bump": rs.Texture(np.zeros((1, 1, 3), np.uint8))}),
}


@pytest.mark.parametrize(
    "what", [*SHEET, "spot", "camera", "sampler", "mode", "targets", "constants"]
)
def test_what_the_programs_do_not_support_is_rendered_by_queries(opened, what, monkeypatch):
    mesh = rs.Mesh([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], texcoords=np.eye(3, 2))
    scene = rs.Scene(
        [mesh],
        materials=[SHEET.get(what, rs.Material())],
        lights=[rs.SpotLight((0, 0, 3), (0, 0, -1), outer_angle=9)] if what == "spot" else [],
        camera=rs.Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0)),
    )
    options, machine, mode = {}, {}, "shadow"
    if what == "camera":
        options["camera"] = rs.Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), projection="orthographic")
    elif what == "sampler":
        options = {"sampler": "stratified", "samples": 2}
    elif what == "mode":
        mode = "xray"
    elif what == "targets":
        monkeypatch.setitem(opened.limits, "max-color-attachment-bytes-per-sample", 64)
    elif what == "constants":
        machine["loop"] = "queries"  # a triangle in the constants of each draw
    ours = rs.render(tracer_of(scene, "brute", **machine), mode, (16, 16), **options)
    theirs = rs.render(tracer_of(scene, "brute", "cpu"), mode, (16, 16), **options)
    assert "passes" not in ours.figures
    assert_alike(ours, theirs)


def test_a_search_that_does_not_end_is_an_error_and_no_hang(monkeypatch):
    plain = backend.shader_structure_of
    monkeypatch.setattr(backend, "shader_structure_of", lambda one: replace(plain(one), budget=3))
    with pytest.raises(GraphicsError, match="took more than 3 steps and tests"):
        rs.render(tracer_of(rs.load("cornell"), "brute"), "raycast", (16, 16))


def test_too_many_passes_are_an_error():
    with pytest.raises(GraphicsError, match=r"rays are still active after .* max_passes is 20"):
        rs.render(tracer_of(rs.load("cubes"), max_passes=20), "shadow", (16, 16))


def test_progress_within_a_sample_can_end_it():
    shown = []

    def progress(done, total):
        shown.append(done / total)
        if 0.0 < done < total:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        rs.render(tracer_of(rs.load("three_boxes")), "whitted", (24, 16), progress=progress)
    assert 0.0 < shown[-1] < 1.0


def test_bands_are_joined():
    scene = rs.load("three_boxes")
    whole = rs.render(tracer_of(scene), "shadow", (24, 16))
    parts = rs.render(tracer_of(scene, rays_at_once=100), "shadow", (24, 16))
    np.testing.assert_array_equal(parts.pixels, whole.pixels)
    assert parts.figures["passes"]["eye rays"] > 1
