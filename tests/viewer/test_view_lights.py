"""The viewer's choices of lights, which it keeps for each scene."""

from __future__ import annotations

import gc
import threading
import warnings
from dataclasses import replace

import pytest

import raystream as rs
from raystream.rendering.lighting import MEASURED
from raystream.viewer import view_lights
from raystream.viewer.jobs import Job
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import TracerCache
from raystream.viewer.view_lights import ViewLights

SETTINGS = Settings(mode="whitted")


def wall(lamp_at):
    """A long wall, and a lamp at some place along it."""
    mesh = rs.Mesh([[0, 0, 0], [1000, 0, 0], [1000, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]])
    lamp = rs.PointLight((lamp_at, 2.0, 0.5), (4000.0, 4000.0, 4000.0))
    return rs.Scene([mesh], lights=[lamp], camera=rs.Camera((3, 2, 5), (3, 2, 0)))


def prepared(scene):
    cache = TracerCache(scene, None)
    return cache._prepare(SETTINGS, Job(lambda *_: None))


def chosen(lights, one):
    context = replace(one.context, options=SETTINGS.mode_options)
    return lights.lit(one, SETTINGS.mode, context, one.tracer.scene.camera).chosen_lights


@pytest.fixture(scope="module")
def scenes():
    """One with light where the camera is, and one without."""
    return prepared(wall(3.0)), prepared(wall(998.0))


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_scene_does_not_inherit_the_lights_of_another(scenes, order):
    lights, found = ViewLights(), {}
    assert scenes[0].key == scenes[1].key
    for index in (*order, *order):  # the second time as remembered
        found.setdefault(index, []).append(chosen(lights, scenes[index]))
    assert found == {0: [MEASURED] * 2, 1: ["added"] * 2}


def test_a_choice_is_made_once_without_warnings(scenes, monkeypatch):
    lights, asked = ViewLights(), []
    choose = view_lights.well_lit

    def counted(*arguments):
        asked.append(arguments)
        return choose(*arguments)

    monkeypatch.setattr(view_lights, "well_lit", counted)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        threads = [
            threading.Thread(target=lambda: found.append(chosen(lights, scenes[1])))
            for _ in range(4)
        ]
        for one in threads:
            one.start()
        for one in threads:
            one.join()
    assert found == ["added"] * 4
    assert len(asked) == 1


@pytest.mark.ci
def test_choices_of_scenes_that_are_closed_are_forgotten():
    lights = ViewLights()
    one = prepared(wall(3.0))
    chosen(lights, one)
    assert len(lights._choices) == 1
    del one
    gc.collect()
    assert not lights._choices
