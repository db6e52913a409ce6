"""The render service: messages and frames that a page receives."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import raystream as rs
from raystream.core.errors import RaystreamError
from raystream.viewer import RenderService, pick_and_screenshot
from raystream.viewer import tracers as tracers_module
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.progressive_images import SampledImage
from viewer.pages import TIMEOUT, Page, decode

CAMERA = {
    "eye": [278.0, 273.0, -800.0],
    "look_at": [278.0, 273.0, 280.0],
    "up": [0.0, 1.0, 0.0],
    "fov": 40.0,
}
OTHER = {**CAMERA, "eye": [278.0, 273.0, 100.0]}


@pytest.fixture(scope="module")
def service() -> Iterator[RenderService]:
    service = RenderService(rs.load("cornell"), "cornell", settings={"samples": 2})
    yield service
    service.close()


@pytest.fixture
def page(service: RenderService) -> Iterator[Page]:
    page = Page(service)
    yield page
    page.client.leave()


def test_a_page_is_told_what_there_is_and_then_shown_it(page: Page) -> None:
    frame = page.frame(done=True)
    kinds = [one["type"] for one in page.received if isinstance(one, dict)]
    assert kinds[:3] == ["hello", "scene", "settings"]
    assert page.message("scene")["triangles"] == 36
    assert page.message("structure")["statistics"]
    assert (frame.header["width"], frame.header["height"]) == (32, 24)
    assert frame.header["samples"] == frame.header["target_samples"] == 2
    assert decode(frame).shape == (24, 32, 3)
    devices = page.message("devices")["devices"]
    assert [one["name"] for one in devices] == ["cpu", "graphics", "cuda"]
    assert all(one["available"] == (one["reason"] is None) for one in devices)


def test_frames_follow_the_camera(page: Page) -> None:
    before = decode(page.frame(done=True))
    page.forget()
    page.take("camera", number=6, moving=True, **OTHER)
    assert page.frame(camera=6).header["moving"]
    page.take("camera", number=7, moving=False, **OTHER)
    frame = page.frame(done=True, camera=7)
    assert (decode(frame) != before).mean() > 0.2


def test_a_camera_that_is_said_to_move_but_does_not_comes_to_rest(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("camera", number=5, moving=True, **OTHER)
    page.frame(moving=True)
    page.frame(done=True, camera=5)


def test_structure_mode_and_look_can_be_changed(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("settings", structure="grid", mode="vis")
    page.message("settings", structure="grid", mode="vis")
    assert page.message("structure")["structure"] == "grid"
    before = decode(page.frame(done=True)).astype(int)
    page.forget()
    page.take("settings", exposure=4.0)
    after = decode(page.frame(done=True)).astype(int)
    assert after.sum() > 1.2 * before.sum()
    assert len(page.frames()) == 1  # the samples are the same


def test_a_heat_map_comes_with_its_scale(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("settings", structure="brute", heatmap="tests", maximum=50)
    frame = page.frame(done=True)
    assert frame.header["legend"]["maximum"] == 50.0
    assert frame.header["legend"]["mean"] == frame.header["counters"]["tests"] == 36.0
    page.take("screenshot", number=3)
    shot = page.frame(type="screenshot")
    assert shot.header["height"] == decode(shot).shape[0] > 24


def test_what_does_not_go_together_is_refused_and_nothing_changes(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("settings", structure="bvh", traversal="restart")
    told = page.message("settings")
    assert "traversal" in told["refused"]
    assert (told["structure"], told["traversal"]) == ("bvh", None)


def test_what_cannot_be_built_is_refused_and_nothing_changes(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.frame(done=True)
    page.forget()

    def no_tracer(*_: Any, **__: Any) -> None:
        raise RaystreamError("device 'cuda': there is none")

    monkeypatch.setattr(tracers_module, "Tracer", no_tracer)
    page.take("settings", device="cuda")
    told = page.wait(lambda one: "refused" in one if isinstance(one, dict) else False)
    assert told["refused"] == "device 'cuda': there is none"
    assert told["device"] == "cpu"
    page.take("camera", number=4, moving=False, **OTHER)
    page.frame(done=True, camera=4)


def test_the_last_picture_is_the_one_that_render_makes(page: Page) -> None:
    page.take("settings", mode="raycast", samples=3, exposure=1.5, tone="aces")
    page.take("screenshot", number=1)
    assert page.frame(type="screenshot").header["samples"] >= 1
    page.frame(done=True, target_samples=3)
    page.take("screenshot", number=2)
    shot = page.frame(type="screenshot", number=2)
    image = rs.render(rs.load("cornell"), "raycast", size=(32, 24), samples=3)
    assert shot.header["format"] == "image/png"
    assert np.array_equal(decode(shot), image.to_bytes(1.5, "aces"))


def test_a_screenshot_has_full_size_although_the_camera_moves(page: Page) -> None:
    page.frame(done=True)
    page.take("pause", paused=True)
    page.take("camera", number=9, moving=True, **OTHER)
    page.take("screenshot", number=5)
    shot = page.frame(type="screenshot", number=5)
    assert (shot.header["camera"], shot.header["width"]) == (9, 32)


def test_one_screenshot_is_made_at_a_time(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    page.frame(done=True)
    page.take("pause", paused=True)
    encode, go_on = pick_and_screenshot.encode_png, threading.Event()

    def wait_and_encode(*arguments: Any) -> bytes:
        assert go_on.wait(TIMEOUT)
        return encode(*arguments)

    monkeypatch.setattr(pick_and_screenshot, "encode_png", wait_and_encode)
    page.take("screenshot", number=1)
    page.take("screenshot", number=2)
    assert "the previous one" in page.message("error", about="screenshot")["message"]
    go_on.set()
    page.frame(type="screenshot", number=1)
    page.take("screenshot", number=3)
    page.frame(type="screenshot", number=3)


def test_a_pixel_is_picked_through_the_camera_last_sent(page: Page) -> None:
    page.frame(done=True)
    page.take("camera", number=3, moving=False, **OTHER)
    page.take("pick", number=8, x=0.46, y=0.5)
    told = page.message("hits", number=8)
    assert told["origin"] == OTHER["eye"]
    assert told["hits"][0]["mesh"] == "tall block"
    assert told["walk"]["structure"] == "bvh"


def test_no_more_than_two_frames_are_under_way(service: RenderService) -> None:
    page, other = Page(service, shows=False), Page(service)
    page.frame(number=1)
    for number in range(1, 20):
        camera = {**CAMERA, "eye": [278.0, 273.0 + number, -800.0]}
        page.take("camera", number=number, moving=True, **camera)
        other.forget()
        other.take("camera", number=number, moving=True, **camera)
        other.frame(camera=number)
    page.frame(number=2)
    assert [frame.header["number"] for frame in page.frames()] == [1, 2]
    page.take("shown", frame=9)
    assert "2 is the last one sent" in page.message("error", about="shown")["message"]
    page.shows = True
    page.take("shown", frame=2)
    page.frame(camera=19)
    page.client.leave()
    other.client.leave()


def test_a_paused_page_gets_nothing_until_it_goes_on(page: Page) -> None:
    page.frame(done=True)
    page.take("pause", paused=True)
    page.forget()
    page.take("camera", number=2, moving=False, **OTHER)
    page.take("pick", number=1, x=0.5, y=0.5)
    page.message("hits")
    assert page.frames() == []
    page.take("pause", paused=False)
    page.frame(done=True, camera=2)


def test_a_long_picture_does_not_keep_others_waiting(service: RenderService) -> None:
    slow, quick = Page(service, size=(640, 480)), Page(service)
    slow.take("settings", mode="path", samples=4096)
    slow.frame(target_samples=4096)
    for number in range(5):
        quick.forget()
        quick.take("camera", number=number, moving=False, **(OTHER if number % 2 else CAMERA))
        quick.frame(done=True, camera=number)
    assert not any(frame.header["done"] for frame in slow.frames()[-1:])
    slow.client.leave()
    quick.client.leave()


def test_what_cannot_be_divided_does_not_keep_others_waiting(
    service: RenderService, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace, began, go_on = SampledImage._trace, threading.Event(), threading.Event()

    def block(picture: SampledImage, *arguments: Any) -> None:
        if picture.width == 40:
            began.set()
            assert go_on.wait(TIMEOUT)
        trace(picture, *arguments)

    monkeypatch.setattr(SampledImage, "_trace", block)
    slow, other = Page(service, size=(40, 30)), Page(service)
    assert began.wait(TIMEOUT)
    other.frame(done=True)
    other.forget()
    other.take("camera", number=3, moving=False, **OTHER)
    other.frame(done=True, camera=3)
    assert slow.frames() == []
    other.client.leave()
    slow.client.leave()
    go_on.set()
    other = Page(service)
    other.frame(done=True)
    other.client.leave()


def test_nothing_is_sent_to_a_page_that_has_left(service: RenderService) -> None:
    page = Page(service)
    page.frame(done=True)
    page.client.leave()
    page.client.leave()
    page.forget()
    page.take("camera", number=8, moving=False, **CAMERA)
    other = Page(service)
    other.frame(done=True)
    other.client.leave()
    assert page.received == []


def test_a_page_that_cannot_be_reached_has_left(service: RenderService) -> None:
    def send(message: Any) -> None:
        raise ConnectionError

    client = service.join(send)
    assert client.has_left
    assert client not in service._worker.tasks


def test_an_error_in_a_picture_is_told_and_others_go_on(
    service: RenderService, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = SampledImage._trace

    def fail(picture: SampledImage, *arguments: Any) -> None:
        if picture.width == 40:
            raise MemoryError("too large")
        trace(picture, *arguments)

    monkeypatch.setattr(SampledImage, "_trace", fail)
    page, other = Page(service, size=(40, 30)), Page(service)
    assert page.message("error")["message"] == "out of memory: too large"
    page.take("screenshot", number=1)
    assert page.message("error", about="screenshot")
    other.frame(done=True)
    page.take("size", width=32, height=24)
    page.frame(done=True)
    page.client.leave()
    other.client.leave()


def test_who_leaves_breaks_off_what_is_built_for_them(
    service: RenderService, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, began, ended = Page(service), threading.Event(), threading.Event()
    page.frame(done=True)

    def build(*_: Any, progress: Any, **__: Any) -> None:
        began.set()
        try:
            while True:
                progress(1, 2)
                threading.Event().wait(0.001)
        finally:
            ended.set()

    monkeypatch.setattr(tracers_module, "Tracer", build)
    page.take("settings", structure="kdtree", traversal="short-stack")
    assert began.wait(TIMEOUT)
    assert page.message("progress", done=0.5)["what"] == "building kdtree"
    page.client.leave()
    assert ended.wait(TIMEOUT)


def test_jobs_that_wait_end_when_nobody_wants_them() -> None:
    jobs, go_on, done = Jobs(), threading.Event(), []
    running = [Job(lambda *_: None) for _ in range(4)]
    for job in running:
        jobs.start(job, lambda _: go_on.wait(TIMEOUT), done.append)
    waiting = [Job(lambda *_: None) for _ in range(20)]
    for job in waiting:
        jobs.start(job, done.append, done.append)
    for job in waiting:
        job.cancel()
    threads = [jobs._running.get(job) for job in waiting]
    for thread in threads:
        if thread is not None:
            thread.join(TIMEOUT)
    assert set(jobs._running) == set(running)
    go_on.set()
    jobs.close()
    assert jobs._running == {}
    assert done == []
    jobs.start(Job(lambda *_: None), done.append, done.append)
    assert jobs._running == {}


def test_a_model_of_ones_own_and_the_way_home(page: Page, tmp_path: Path) -> None:
    page.frame(done=True)
    path = tmp_path / "square.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n", encoding="utf-8")
    page.forget()
    page.client.open(path, "my square")
    told = page.message("scene")
    assert (told["name"], told["triangles"], told["own"]) == ("my square", 2, True)
    page.frame(done=True)
    page.forget()
    page.take("home")
    assert page.message("scene")["own"] is False
    page.frame(done=True)


def test_a_damaged_model_is_told_and_nothing_changes(page: Page, tmp_path: Path) -> None:
    page.frame(done=True)
    path = tmp_path / "broken.ply"
    path.write_bytes(b"ply\nnonsense\n")
    page.forget()
    page.client.open(path, "broken")
    assert "broken.ply" in page.message("error", about="open")["message"]
    page.take("camera", number=2, moving=False, **OTHER)
    page.frame(done=True, camera=2)


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (None, "type: expected one of"),
        ([], "type: expected one of"),
        ({}, "type: expected one of"),
        ({"type": "dance"}, "type: expected one of"),
        ({"type": ["camera"]}, "type: expected one of"),
        ({"type": "camera", "number": 1, "moving": False}, "eye: is missing"),
        ({"type": "camera", "number": 1, "moving": 1, **CAMERA}, "moving: expected true"),
        (
            {"type": "camera", "number": 1, "moving": False, **CAMERA, "eye": [1, 2]},
            "eye: expected three numbers",
        ),
        (
            {"type": "camera", "number": 1, "moving": False, **CAMERA, "fov": 180.0},
            "fov: expected degrees",
        ),
        (
            {"type": "camera", "number": 1, "moving": False, **CAMERA, "up": [0, 0, 1]},
            "up: must not be",
        ),
        ({"type": "size", "width": 15, "height": 20}, "width: expected an integer from 16"),
        ({"type": "size", "width": 4096, "height": 4096}, "size: expected at most"),
        ({"type": "shown", "frame": 0}, "frame: expected an integer"),
        ({"type": "screenshot"}, "number: is missing"),
        ({"type": "pause", "paused": "yes"}, "paused: expected true or false"),
        ({"type": "pick", "number": 1, "x": 2, "y": 0}, "x: expected a number from 0 to 1"),
    ],
)
def test_what_cannot_be_used_is_said(page: Page, message: Any, fault: str) -> None:
    page.client.handle(message)
    told = page.message("error")
    assert fault in told["message"]
    about = message.get("type") if isinstance(message, dict) else None
    assert told["about"] == str(about)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)
KINDS = ("camera", "size", "settings", "pick", "shown", "screenshot", "pause", "home")
FIELDS = ("number", "eye", "look_at", "up", "fov", "moving", "width", "height", "mode", "x", "y")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(KINDS), st.dictionaries(st.sampled_from(FIELDS), JSON, max_size=8))
def test_no_message_does_harm(page: Page, kind: str, fields: dict[str, Any]) -> None:
    """It is followed or refused, and the page is served as before."""
    page.forget()
    page.client.handle({"type": kind, **fields})
    page.client.handle({"type": "dance"})
    page.message("error", about="dance")
    told = [one["about"] for one in page.received if isinstance(one, dict) and "about" in one]
    assert told in (["dance"], [kind, "dance"])
    assert not page.client.has_left


def test_a_studio_begins_as_it_is_told() -> None:
    scene = rs.load("cornell")
    with pytest.raises(ValueError, match="mode: expected one of"):
        RenderService(scene, "cornell", settings={"mode": "?"})
    with pytest.raises(TypeError, match="expected a Scene or a Tracer, got str"):
        RenderService("cornell", "cornell")  # type: ignore[arg-type]
    tracer = rs.Tracer(scene, "grid", resolution=3)
    service = RenderService(tracer, "cornell", settings={"mode": "vis", "samples": 1})
    page = Page(service)
    page.frame(done=True)
    told = page.message("settings")
    assert (told["structure"], told["mode"], told["samples"]) == ("grid", "vis", 1)
    assert page.message("structure")["bytes"] == tracer.structure.report.byte_count
    service.close()
    service.close()
    assert page.message("closing")
    assert page.client.has_left
    with pytest.raises(RuntimeError, match="closed"):
        service.join(lambda _: None)
