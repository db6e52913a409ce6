"""The studio: what a page is told and shown."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import raystream as rs
from raystream.viewer import Studio
from viewer.pages import Page, decode

CAMERA = {
    "eye": [278.0, 273.0, -800.0],
    "look_at": [278.0, 273.0, 280.0],
    "up": [0.0, 1.0, 0.0],
    "fov": 40.0,
}


@pytest.fixture(scope="module")
def studio() -> Iterator[Studio]:
    studio = Studio(rs.load("cornell"), "cornell", settings={"samples": 2})
    yield studio
    studio.close()


@pytest.fixture
def page(studio: Studio) -> Iterator[Page]:
    page = Page(studio)
    yield page
    page.visitor.leave()


def test_a_page_is_told_what_there_is_and_then_shown_it(page: Page) -> None:
    frame = page.frame(done=True)
    kinds = [one["type"] for one in page.received if isinstance(one, dict)]
    assert kinds[:3] == ["hello", "scene", "settings"]
    assert page.message("scene")["triangles"] == 36
    assert (frame.header["width"], frame.header["height"]) == (32, 24)
    assert frame.header["samples"] == frame.header["target_samples"] == 2
    assert decode(frame).shape == (24, 32, 3)


def test_frames_follow_the_camera(page: Page) -> None:
    before = decode(page.frame(done=True))
    page.forget()
    page.take("camera", number=7, moving=False, **{**CAMERA, "eye": [278.0, 273.0, 100.0]})
    frame = page.frame(done=True, camera=7)
    assert (decode(frame) != before).mean() > 0.2


def test_structure_and_mode_can_be_changed(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("settings", structure="grid", mode="vis")
    page.message("settings", structure="grid", mode="vis")
    assert page.message("structure")["structure"] == "grid"
    page.frame(done=True)


def test_what_does_not_go_together_is_refused_and_nothing_changes(page: Page) -> None:
    page.frame(done=True)
    page.forget()
    page.take("settings", structure="bvh", traversal="restart")
    told = page.message("settings")
    assert "traversal" in told["refused"]
    assert (told["structure"], told["traversal"]) == ("bvh", None)


def test_nothing_is_sent_to_a_page_that_has_left(studio: Studio) -> None:
    page = Page(studio)
    page.frame(done=True)
    page.visitor.leave()
    page.visitor.leave()
    page.forget()
    page.take("camera", number=8, moving=False, **CAMERA)
    other = Page(studio)
    other.frame(done=True)
    other.visitor.leave()
    assert page.received == []
