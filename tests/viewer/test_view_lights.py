"""The viewer's choices of lights, which it keeps for each scene."""

from __future__ import annotations

import gc
import threading
import warnings
from dataclasses import replace

import numpy as np
import pytest

import raystream as rs
from dark_views import DARK_VIEWS
from raystream.rendering.lighting import MEASURED
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.view_light import USUAL_SIZE, decide, kept_choice, usual_context
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


@pytest.mark.parametrize("name", DARK_VIEWS)
@pytest.mark.parametrize("mode", ["whitted", pytest.param("path", marks=pytest.mark.ci)])
def test_lights_are_those_that_an_image_has_by_default(name, mode):
    scene = DARK_VIEWS[name]()
    settings = replace(SETTINGS, mode=mode)
    cache = TracerCache(scene, None)
    one = cache._prepare(settings, Job(lambda *_: None))
    context = replace(one.context, options=settings.mode_options)
    found = ViewLights().lit(one, mode, context, scene.camera)
    renderer = RENDERERS[mode]
    samples = Sampler.of("sobol", 0, renderer.default_samples)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.RaystreamWarning)
        usual = decide(renderer, one.tracer, None, USUAL_SIZE, samples, dict(settings.mode_options))
    assert found.chosen_lights == kept_choice(usual)
    shown = renderer.trace(usual_context(renderer, found, scene.camera), range(500, 502), 0)
    np.testing.assert_array_equal(shown, renderer.trace(usual, range(500, 502), 0))
    assert shown.any()


def test_another_device_keeps_the_lights_of_the_first_view():
    """The camera has moved to the lamp until then."""
    scene, lights = wall(998.0), ViewLights()
    first, passes = (
        TracerCache(scene, None)._prepare(replace(SETTINGS, **key), Job(lambda *_: None))
        for key in ({}, {"structure": "grid", "machine": "multipass"})
    )
    assert first.key != passes.key
    near = rs.Camera((998, 2, 5), (998, 2, 0))
    found = [
        lights.lit(one, "whitted", replace(one.context, options=SETTINGS.mode_options), camera)
        for one, camera in ((first, scene.camera), (passes, near))
    ]
    assert [one.chosen_lights for one in found] == ["added"] * 2


@pytest.mark.ci
def test_choices_of_scenes_that_are_closed_are_forgotten():
    lights = ViewLights()
    one = prepared(wall(3.0))
    chosen(lights, one)
    assert len(lights._choices) == 1
    del one
    gc.collect()
    assert not lights._choices
