"""Failures of a graphics device are one clear error, and the CPU keeps tracing."""

from __future__ import annotations

import dataclasses
import logging

import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import soup
from raystream.graphics import machines
from raystream.graphics.adapters import OpenDevice, open_device
from raystream.graphics.compute import ComputeBackend
from raystream.graphics.error_scope import guarded
from raystream.graphics.errors import GraphicsError
from raystream.structures import STRUCTURES, form_of, names_with


@pytest.fixture
def scene():
    return rs.Scene.from_arrays(*soup(60, 1))


@pytest.fixture
def rays(rng):
    origins = rng.normal(size=(200, 3)) * 2
    return {"origins": origins, "directions": 0.5 - origins}


QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")


def assert_cpu_works(scene, rays):
    assert rs.Tracer(scene, "brute").any_hit(**rays).any()


# Loss of the device.


@pytest.mark.parametrize("query", QUERIES)
def test_a_lost_device_is_said_in_every_query(fresh, scene, rays, query, capfd):
    tracer = rs.Tracer(scene, "brute", "graphics")
    expected = tracer.first_hit(**rays)
    fresh.device.destroy()
    capfd.readouterr()
    for _ in range(2):  # the first finds out
        with pytest.raises(
            GraphicsError, match=r"was lost .*; make a new tracer or new streams, or"
        ):
            getattr(tracer, query)(**rays)
    assert fresh.is_known_lost
    assert capfd.readouterr() == ("", "")
    assert_cpu_works(scene, rays)
    again = rs.Tracer(scene, "brute", "graphics")
    assert open_device() is not fresh
    assert_same_bits(again.first_hit(**rays).t, expected.t)


def test_a_loss_during_a_query_is_its_error(fresh, scene, rays, capfd):
    tracer = rs.Tracer(scene, "brute", "graphics", rays_at_once=50)
    with pytest.raises(GraphicsError, match="was lost"):
        tracer.first_hit(**rays, progress=lambda *_: fresh.device.destroy())
    assert capfd.readouterr() == ("", "")


def test_a_new_tracer_after_a_loss_that_nobody_noticed(fresh, scene, rays):
    fresh.device.destroy()
    assert rs.Tracer(scene, "brute", "graphics").any_hit(**rays).any()
    assert open_device() is open_device() is not fresh


# Errors that wgpu reports between calls.


def test_what_wgpu_would_print_is_an_error(opened, caplog):
    import wgpu.backends.wgpu_native as native

    with (
        pytest.raises(GraphicsError, match=r"device 'graphics': .*: out of something"),
        guarded(opened),
    ):
        native._api.error_handler.log_error("out of something")
    assert not caplog.records
    with guarded(opened):
        logging.getLogger("wgpu").error("of no query")  # records of other code are left alone
    assert [record.getMessage() for record in caplog.records] == ["of no query"]
    native._api.error_handler.log_error("no query is to blame")
    assert caplog.records[-1].getMessage() == "no query is to blame"


def test_what_wgpu_raises_is_an_error_of_the_query(fresh, scene, rays):
    tracer = rs.Tracer(scene, "brute", "graphics")
    tracer._backend._dispatcher.arrays[0].handle.destroy()
    with pytest.raises(GraphicsError, match=r"(?s)device 'graphics': .*destroyed"):
        tracer.any_hit(**rays)
    assert not fresh.is_lost
    assert rs.Tracer(scene, "brute", "graphics").any_hit(**rays).any()


def test_other_errors_stay_what_they_are(opened, scene, rays):
    tracer = rs.Tracer(scene, "brute", "graphics", rays_at_once=50)

    def stop(done, total):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        tracer.first_hit(**rays, progress=stop)
    assert tracer.any_hit(**rays).any()


# Scenes that are too large.


def smaller(opened: OpenDevice, **limits: int) -> OpenDevice:
    """The same device, as if it had these limits."""
    other = OpenDevice(opened.adapter, opened.device)
    other.limits |= {name.replace("_", "-"): most for name, most in limits.items()}
    return other


@pytest.mark.parametrize("limit", ["max_buffer_size", "max_storage_buffer_binding_size"])
def test_too_large_a_scene_is_refused(opened, scene, rays, monkeypatch, limit):
    triangle_bytes = 60 * 36
    monkeypatch.setattr(
        machines, "open_device", lambda _: smaller(opened, **{limit: triangle_bytes - 1})
    )
    refused = r"brute, array 1 would take 2,160 bytes, but .* allows 2,159 .* use device='cpu'"
    with pytest.raises(GraphicsError, match=refused):
        rs.Tracer(scene, "brute", "graphics")
    monkeypatch.setattr(
        machines, "open_device", lambda _: smaller(opened, **{limit: triangle_bytes})
    )
    assert rs.Tracer(scene, "brute", "graphics", rays_at_once=50).any_hit(**rays).any()
    assert_cpu_works(scene, rays)


def test_more_rays_than_a_buffer_holds_are_refused(opened, scene, rays):
    structure = rs.Tracer(scene, "brute").structure
    machine = ComputeBackend(structure, smaller(opened, max_buffer_size=4000))
    tracer = rs.Tracer(scene, "brute", "graphics")
    tracer._backend = machine
    with pytest.raises(GraphicsError, match=r"rays would take 6,400 bytes"):
        tracer.first_hit(**rays)


def test_no_memory_is_an_error(fresh, scene, monkeypatch):
    import wgpu

    def fail(self, **_):
        raise wgpu.GPUOutOfMemoryError("Not enough memory left.")

    made = type(fresh.device).create_buffer
    monkeypatch.setattr(type(fresh.device), "create_buffer", fail)
    monkeypatch.setattr(OpenDevice, "is_lost", False)
    with pytest.raises(GraphicsError, match=r"has no memory for brute, array 0, 240 bytes"):
        rs.Tracer(scene, "brute", "graphics")
    monkeypatch.setattr(type(fresh.device), "create_buffer", made)
    rs.Tracer(scene, "brute", "graphics")


# Endless loops.


@pytest.mark.parametrize("structure", names_with("graphics"))
@pytest.mark.parametrize("query", QUERIES)
def test_a_search_without_an_end_is_stopped(opened, scene, rays, monkeypatch, structure, query):
    """Every loop spends the budget: the smallest one ends each search at once."""
    form, forms = form_of(structure, "graphics"), STRUCTURES[structure].forms
    monkeypatch.setitem(forms, "graphics", lambda built: dataclasses.replace(form(built), budget=2))
    tracer = rs.Tracer(scene, structure, "graphics")
    with pytest.raises(GraphicsError, match="took more than 2 steps and tests"):
        getattr(tracer, query)(**rays)
    monkeypatch.setitem(forms, "graphics", form)
    assert rs.Tracer(scene, structure, "graphics").any_hit(**rays).any()
    assert_cpu_works(scene, rays)
