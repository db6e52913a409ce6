"""Settings: valid values, and valid combinations."""

from __future__ import annotations

import pytest

import raystream as rs
from extras import need
from raystream.rendering.render import RENDERERS
from raystream.tracer.devices import device_of
from raystream.viewer.messages import MessageError
from raystream.viewer.settings import MACHINES, Settings, traversals_of


def test_the_names_are_those_of_the_library():
    assert MACHINES["cpu"] == device_of("cpu").machines.names
    scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    for traversal in traversals_of("kdtree"):
        rs.Tracer(scene, "kdtree", traversal=traversal)
    with pytest.raises(ValueError, match="traversal") as caught:
        rs.Tracer(scene, "kdtree", traversal="?")
    assert all(repr(traversal) in str(caught.value) for traversal in traversals_of("kdtree"))


@pytest.mark.parametrize(("device", "package"), [("graphics", "wgpu"), ("cuda", "numba_cuda")])
def test_so_are_the_machines_of_other_devices(device, package):
    need(package)
    assert MACHINES[device] == device_of(device).machines.names


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"mode": "rasterise"}, "mode: expected one of 'raycast'"),
        ({"mode": None}, "mode: expected one of"),
        ({"structure": 3}, "structure: expected one of"),
        ({"structure": ["bvh"]}, "structure: expected one of"),
        ({"traversal": "restart"}, "traversal: bvh has no traversal option"),
        ({"structure": "kdtree", "traversal": "sideways"}, "traversal: expected one of"),
        ({"machine": "compute"}, "machine: device cpu supports branching, multipass"),
        ({"scheduler": "naive"}, "scheduler: only with machine multipass"),
        ({"device": "abacus"}, "device: expected one of"),
        ({"max_bounces": -1}, "max_bounces: expected an integer from 0"),
        ({"max_bounces": 2.5}, "max_bounces: expected an integer"),
        ({"max_bounces": True}, "max_bounces: expected an integer"),
        ({"exposure": 0}, "exposure: expected a number above 0"),
        ({"exposure": float("nan")}, "exposure: expected a number"),
        ({"exposure": 10**400}, "exposure: expected a number"),
        ({"exposure": None}, "exposure: expected a number"),
        ({"tone": "sepia"}, "tone: expected one of"),
        ({"heatmap": "smiles"}, "heatmap: expected one of"),
        ({"maximum": -3}, "maximum: expected a number above 0"),
        ({"samples": 0}, "samples: expected an integer from 1"),
        ({"samples": 10**9}, "samples: expected an integer"),
        ({"colour": "red"}, "'colour': is not a setting"),
    ],
)
def test_what_cannot_be_is_said(change, fault):
    with pytest.raises(MessageError, match="^" + fault):
        Settings().changed(change)


def test_what_depends_on_another_goes_back_to_the_usual():
    settings = Settings().changed({"structure": "kdtree", "traversal": "restart"})
    settings = settings.changed({"machine": "multipass", "scheduler": "naive"})
    assert settings.tracer_key[:5] == ("kdtree", "restart", "cpu", "multipass", "naive")
    other = settings.changed({"structure": "grid"})
    assert other.tracer_key[:5] == ("grid", None, "cpu", "multipass", "naive")
    assert settings.changed({"machine": "branching"}).scheduler is None
    assert settings.changed({"device": "graphics"}).tracer_key.machine == "compute"
    assert settings.changed({"structure": "kdtree"}).traversal == "restart"  # as it was
    assert settings.changed({"traversal": None}).tracer_key.traversal == "stack"


def test_a_message_says_what_is_in_effect_and_what_is_possible():
    message = Settings().changed({"mode": "path", "structure": "kdtree"}).message()
    assert message["traversal"] == "stack"
    assert message["machine"] == "branching"
    assert message["scheduler"] is None
    assert message["max_bounces"] == RENDERERS["path"].options["max_bounces"]
    assert message["samples"] == 64
    assert message["possible"]["traversal"] == list(traversals_of("kdtree"))
    assert message["possible"]["scheduler"] == []
    multipass = Settings().changed({"machine": "multipass"}).message()
    assert multipass["scheduler"] == "threshold"
    assert not multipass["possible"]["max_bounces"]
    assert multipass["max_bounces"] is None


@pytest.mark.parametrize("mode", RENDERERS)
def test_bounces_are_for_the_modes_that_have_them(mode):
    usual = RENDERERS[mode].options
    settings = Settings().changed({"mode": mode, "max_bounces": 2})
    if "max_bounces" in usual:
        assert settings.message()["max_bounces"] == 2
        assert settings.mode_options == RENDERERS[mode].check({**usual, "max_bounces": 2})
        assert settings.mode_options != Settings(mode=mode).mode_options
    else:
        assert settings.message()["max_bounces"] is None
        assert settings.mode_options == RENDERERS[mode].check(usual)


def test_a_heat_map_needs_a_tracer_that_counts():
    settings = Settings().changed({"heatmap": "tests"})
    assert settings.tracer_key.options["counters"] is True
    assert "counters" not in Settings().tracer_key.options
    assert settings.target_samples == 1
