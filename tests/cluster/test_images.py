"""Images and animations of a cluster equal those of one machine bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("distributed")

import raystream as rs
from conftest import assert_same_bits
from meshes import cube

SIZE = (32, 24)


def assert_same_image(found: rs.Image, expected: rs.Image) -> None:
    assert_same_bits(found.pixels, expected.pixels)
    assert found.layers.keys() == expected.layers.keys()
    for name, layer in expected.layers.items():
        assert_same_bits(found.layers[name], layer)
    assert found.figures == expected.figures


#: All in .ci/nightly.
FEW = ("raycast", "whitted", "path")
MODES = [pytest.param(m, marks=[pytest.mark.exhaustive] * (m not in FEW)) for m in rs.MODES]


@pytest.mark.parametrize("mode", MODES)
def test_every_mode(client, room, mode):
    asked = {"mode": mode, "size": SIZE, "seed": 5}
    for more in ({}, {"samples": 3, "layers": "all"}):
        found = rs.cluster.render(room, **asked, **more, client=client)
        assert_same_image(found, rs.render(room, **asked, **more))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["spheres", "boxes", "forest:2000", "cornell_mirrors"])
def test_scenes_with_textures_lights_and_cut_outs(client, name):
    scene = rs.load(name)
    asked = {"mode": "path", "size": SIZE, "samples": 2, "layers": ["albedo"]}
    found = rs.cluster.render(scene, **asked, client=client, structure="kdtree")
    assert_same_image(found, rs.render(scene, **asked))


def test_options_of_modes_samplers_cameras_and_tracers(client, room):
    camera = rs.Camera((278, 273, -700), (278, 273, 0), fov=30, aperture=5.0)
    asked = {"mode": "path", "size": (17, 9), "samples": 4, "sampler": "stratified"}
    asked |= {"camera": camera, "clamp": 2.0, "max_bounces": 2, "light_samples": False}
    local = rs.Tracer(room, "kdtree", traversal="restart")
    found = rs.cluster.render(local, **asked, client=client)
    assert_same_image(found, rs.render(local, **asked))


@pytest.mark.filterwarnings("ignore:the scene's own lights")
def test_workers_take_the_choice_of_lights(client):
    corners = [[0, 0, 0], [9, 0, 0], [0, 9, 0], [1, 1, 1], [2, 1, 1], [1, 2, 1]]
    mesh = rs.Mesh(corners, [[0, 1, 2], [3, 4, 5]], material_ids=[0, 1])
    weak = rs.Scene([mesh], materials=[rs.Material(), rs.Material(emission=(0.01, 0.01, 0.01))])
    means = []
    for lights in ("auto", "file"):
        asked = {"mode": "path", "size": SIZE, "lights": lights}
        found = rs.cluster.render(weak, **asked, client=client)
        assert_same_image(found, rs.render(weak, **asked))
        means.append(found.pixels.mean())
    assert means[0] > 0.3 > 0.01 > means[1]


def closed_room():
    """A room with a sun outside, so that what the camera sees is dark."""
    vertices, faces = cube()
    sun = rs.DirectionalLight((0.2, -1.0, 0.1), (3.0, 3.0, 3.0))
    camera = rs.Camera((-3.5, 0.0, 3.5), (1.0, -2.0, 0.0), fov=70)
    return rs.Scene([rs.Mesh(8.0 * vertices - 4.0, faces)], lights=[sun], camera=camera)


def far_lamp():
    """A long wall, and a lamp that lights its other end only."""
    wall = rs.Mesh([[0, 0, 0], [1000, 0, 0], [1000, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = rs.PointLight((998.0, 2.0, 0.5), (4000.0, 4000.0, 4000.0))
    return rs.Scene([wall], lights=[lamp], camera=rs.Camera((3, 2, 5), (3, 2, 0)))


@pytest.mark.parametrize("make", [closed_room, far_lamp])
@pytest.mark.parametrize("mode", ["whitted", "path"])
def test_a_view_in_the_dark_warns_and_resumes_as_it_does_here(
    client, tmp_path, monkeypatch, make, mode
):
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")
    scene, warning = make(), "do not reach what the camera sees: added"
    asked = {"mode": mode, "size": SIZE}
    with pytest.warns(rs.RaystreamWarning, match=warning):
        expected = rs.render(scene, samples=4, **asked)
    done = []
    for first, then in ((rs.cluster.render, rs.render), (rs.render, rs.cluster.render)):
        asked["checkpoint"] = tmp_path / f"{first.__module__}.npz"
        for ask, samples in ((first, 2), (then, 4)):
            done.clear()
            more = {"client": client} if ask is rs.cluster.render else {}
            with pytest.warns(rs.RaystreamWarning, match=warning) as seen:
                found = ask(
                    scene,
                    samples=samples,
                    progress=lambda now, _: done.append(now),
                    **more,
                    **asked,
                )
            assert seen[0].filename == __file__
        assert done[0] == 2 * SIZE[0] * SIZE[1]
        assert_same_image(found, expected)


def test_lights_of_the_file_are_not_added_to(client):
    found = rs.cluster.render(closed_room(), "path", SIZE, lights="file", client=client)
    assert_same_image(found, rs.render(closed_room(), "path", SIZE, lights="file"))
    assert found.pixels.max() == 0.0


@pytest.mark.parametrize("machine", ["branching", "multipass"])
def test_a_noise_limit_ends_with_the_same_sample(client, room, machine):
    asked = {"mode": "path", "size": SIZE, "samples": 999, "noise": 0.4, "machine": machine}
    expected = rs.render(room, **asked)
    assert 8 <= expected.figures["samples"] < 999
    found = rs.cluster.render(room, **asked, client=client)
    for image in (found, expected):
        image.figures.pop("passes", None)  # of this process
    assert_same_image(found, expected)


def test_a_time_limit_ends_after_whole_samples(client, room):
    asked = {"mode": "raycast", "size": SIZE}
    found = rs.cluster.render(room, **asked, samples=4096, time_limit=0.3, client=client)
    taken = found.figures["samples"]
    assert 1 <= taken < 4096
    assert (found.layers["samples"] == taken).all()


@pytest.mark.parametrize("mode", ["ao", "path"])  # without lights, and with those of the room
def test_a_picture_goes_on_from_a_checkpoint_with_or_without_a_cluster(
    client, room, tmp_path, monkeypatch, mode
):
    monkeypatch.setenv("RAYSTREAM_CHECKPOINT_SECONDS", "0")
    checkpoint = tmp_path / "samples.npz"
    asked = {"mode": mode, "size": SIZE, "checkpoint": checkpoint}

    def interrupt(done, total):
        if done >= 3 * SIZE[0] * SIZE[1]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.cluster.render(room, **asked, samples=9, client=client, progress=interrupt)
    assert checkpoint.exists()
    rs.render(room, **asked, samples=5)
    seen = []
    found = rs.cluster.render(
        room, **asked, samples=7, client=client, progress=lambda done, total: seen.append(done)
    )
    assert_same_image(found, rs.render(room, mode, SIZE, 7))
    assert seen[0] == 5 * SIZE[0] * SIZE[1]
    assert seen == sorted(seen)
    assert seen[-1] == 7 * SIZE[0] * SIZE[1]


def test_nothing_is_left_on_the_scheduler(client, room):
    rs.cluster.render(room, size=SIZE, client=client)
    held = client.run_on_scheduler(
        lambda dask_scheduler: [
            len(dask_scheduler.plugins["raystream-store"]._manifests),
            sum(key.startswith("raystream-") for key in dask_scheduler.tasks),
        ]
    )
    assert held[0] == 0


@pytest.mark.parametrize(
    ("options", "kind", "says"),
    [
        ({"mode": "photon"}, ValueError, "mode"),
        ({"size": (0, 4)}, ValueError, "size"),
        ({"samples": 0}, ValueError, "samples"),
        ({"noise": -1.0}, ValueError, "noise"),
        ({"sampler": "halton"}, ValueError, "halton"),
        ({"camera": "front"}, TypeError, "camera"),
        ({"layers": ["smell"]}, ValueError, "layers"),
        ({"mode": "path", "clamp": -1.0}, ValueError, "clamp"),
        ({"resolution": 3}, TypeError, "resolution"),
    ],
)
def test_bad_arguments_are_refused_as_they_are_here(client, room, options, kind, says):
    with pytest.raises(kind, match=says):
        rs.render(room, **{"size": SIZE, **options})
    with pytest.raises(kind, match=says):
        rs.cluster.render(room, **{"size": SIZE, **options}, client=client)


def test_a_device_that_workers_lack_is_their_error(client, room, monkeypatch):
    with pytest.raises((rs.RaystreamError, ImportError, ValueError), match="adapter"):
        rs.cluster.render(
            room, size=SIZE, device="graphics", adapter="none of these", client=client
        )


def moving_room(room: rs.Scene) -> rs.Scene:
    """A mesh goes up, and in the second half there is one less."""
    *rest, box = room.meshes
    looks = {"materials": room.materials, "camera": room.camera}

    def at(time):
        moved = box.moved(np.asarray(box.vertices) + [0.0, 20.0 * time, 0.0])
        return rs.Scene([*rest, moved] if time < 1.5 else [*rest[1:], moved], **looks)

    return rs.Scene(room.meshes, **looks, animation=rs.Animation(at, (0, 2), fps=4))


@pytest.mark.parametrize("structure", ["bvh", pytest.param("kdtree", marks=pytest.mark.exhaustive)])
def test_an_animation_in_which_meshes_move(client, room, structure):
    scene = moving_room(room)
    asked = {"mode": "raycast", "size": SIZE, "samples": 2, "structure": structure, "seed": 4}
    expected = list(rs.render_frames(scene, **asked, layers=["depth"]))
    seen = []
    animation = rs.cluster.render_frames(
        scene, **asked, layers=["depth"], client=client, progress=lambda *n: seen.append(n)
    )
    assert seen == []
    for (number, image), (same, wanted) in zip(animation, expected, strict=True):
        assert number == same
        assert_same_image(image, wanted)
    rays = 2 * SIZE[0] * SIZE[1]
    assert seen == [(k * rays, 8 * rays) for k in range(1, 9)]


def test_an_animation_in_which_the_camera_moves(client, room):
    track = rs.CameraTrack(room.camera, [[0, 278, 273, -800], [2, 278, 273, 0]])
    asked = {"size": SIZE, "camera": track, "frames": [5, 0, -1], "fps": 3}
    animation = rs.cluster.render_frames(room, "vis", **asked, client=client)
    for (number, image), (same, wanted) in zip(
        animation, rs.render_frames(room, "vis", **asked), strict=True
    ):
        assert number == same
        assert_same_image(image, wanted)


def test_an_animation_that_nobody_watches_to_its_end_leaves_nothing(client, room):
    animation = rs.cluster.render_frames(moving_room(room), size=SIZE, client=client)
    next(animation)
    animation.close()
    held = client.run_on_scheduler(
        lambda dask_scheduler: len(dask_scheduler.plugins["raystream-store"]._manifests)
    )
    assert held == 0
