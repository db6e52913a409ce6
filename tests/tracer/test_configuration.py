"""Names with options, and typed options: the same tracer."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import raystream as rs
from extras import need
from raystream.core.choices import DeviceOptions
from raystream.tracer.configuration import configure
from raystream.tracer.devices import DEVICES, register_device

SCENE = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
RAY = [0.25, 0.25, 1.0], [0.0, 0.0, -1.0]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("named", "typed"),
    [
        ({"structure": "bvh"}, {"structure": rs.Bvh()}),
        (
            {"structure": "bvh", "quality": "fast", "kernel": "packet"},
            {"structure": rs.Bvh(quality="fast", kernel="packet")},
        ),
        ({"structure": "grid", "resolution": 3}, {"structure": rs.Grid(resolution=(3, 3, 3))}),
        (
            {
                "structure": "kdtree",
                "traversal": "restart",
                "machine": "multipass",
                "scheduler": "double",
                "traversal_steps": 3,
            },
            {
                "structure": rs.KdTree(traversal="restart"),
                "device": rs.Cpu(),
                "machine": rs.Multipass(scheduler="double", traversal_steps=3),
            },
        ),
        (
            {"structure": "graph", "machine": "branching"},
            {"structure": rs.Graph(), "machine": rs.Branching()},
        ),
    ],
)
def test_both_make_the_same_tracer(named, typed):
    one, other = rs.Tracer(SCENE, **named), rs.Tracer(SCENE, **typed)
    assert repr(one) == repr(other)
    assert one.structure.options == other.structure.options
    assert one.machine_options == other.machine_options
    assert one.first_hit(*RAY).t == other.first_hit(*RAY).t == 1.0


def test_both_may_be_mixed():
    tracer = rs.Tracer(SCENE, rs.Grid(), machine="multipass", scheduler="naive")
    assert tracer.machine_options == {"scheduler": "naive"}
    tracer = rs.Tracer(SCENE, "grid", machine=rs.Multipass(scheduler="naive"), resolution=2)
    assert tracer.structure.options == rs.Grid(resolution=2)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"structure": rs.Bvh(), "quality": "fast"}, TypeError, "'quality' as an argument of Bvh"),
        (
            {"machine": rs.Multipass(), "scheduler": "naive"},
            TypeError,
            "multipass: give 'scheduler' as an argument of Multipass",
        ),
        ({"machine": rs.Compute()}, ValueError, "machine: expected one of 'branching'"),
        ({"machine": rs.Multipass(), "resolution": 3}, TypeError, "bvh: has no option"),
        ({"structure": rs.Cpu()}, ValueError, "structure: expected one of 'bvh'"),
        ({"structure": SCENE}, ValueError, "structure: expected one of 'bvh'"),
    ],
)
def test_what_does_not_fit_together_is_said(given, error, words):
    with pytest.raises(error, match=words):
        rs.Tracer(SCENE, **given)


@pytest.mark.ci
def test_a_tracer_of_a_built_structure_takes_machines():
    structure = rs.Tracer(SCENE, "grid").structure
    tracer = rs.Tracer.of_structure(structure, device=rs.Cpu(), machine=rs.Multipass())
    assert (tracer.machine, tracer.first_hit(*RAY).t) == ("multipass", 1.0)
    with pytest.raises(TypeError, match="branching: has no option 'resolution'"):
        rs.Tracer.of_structure(structure, resolution=3)


@pytest.mark.ci
def test_pictures_and_heat_maps_take_them():
    arguments = {"size": (8, 6), "structure": rs.Grid(resolution=2), "device": rs.Cpu()}
    named = {"size": (8, 6), "structure": "grid", "resolution": 2}
    scene = rs.load("cornell")
    assert (rs.render(scene, **arguments).pixels == rs.render(scene, **named).pixels).all()
    assert (rs.heatmap(scene, **arguments).counts == rs.heatmap(scene, **named).counts).all()
    with pytest.raises(ValueError, match="not allowed with a Tracer"):
        rs.render(rs.Tracer(scene), **arguments)


def test_a_device_may_have_options_of_its_own(monkeypatch):
    @dataclass(frozen=True, kw_only=True)
    class Slow(DeviceOptions):
        name = "slow"
        patience: int = 1

    asked = []

    def build(structure, triangles, *, progress=None, device=None):
        asked.append((structure, device))
        return DEVICES["cpu"].build(structure, triangles, progress=progress)

    monkeypatch.setattr("raystream.tracer.devices.DEVICES", dict(DEVICES))
    register_device("slow", build, options=Slow)
    rs.Tracer(SCENE, rs.Grid(), Slow(patience=3))
    rs.Tracer(SCENE, "grid", "slow", patience=3)
    assert asked == [(rs.Grid(), Slow(patience=3))] * 2


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"machine": "multipass"}, ValueError, "'multipass', which runs on device='cpu' and"),
        ({"machine": rs.Multipass()}, ValueError, "'multipass', which runs on device='cpu' and"),
        ({"machine": "compute"}, ValueError, "'branching' on device 'cuda', got 'compute'$"),
        ({"scheduler": "naive"}, TypeError, "option of machine='multipass', on device='cpu' and"),
    ],
)
@pytest.mark.parametrize("device", ["cuda", rs.Cuda()])
def test_cuda_has_no_passes(device, given, error, words):
    """Said before a GPU is looked for."""
    with pytest.raises(error, match=words):
        rs.Tracer(SCENE, device=device, **given)


def test_options_of_graphics_are_those_of_its_machines():
    need("wgpu")
    from raystream.graphics.machines import OPTIONS
    from raystream.graphics.multipass import LOOPS

    assert rs.Graphics.choices("loop") == LOOPS
    assert set().union(*OPTIONS.values()) == {
        *rs.Graphics.names(),
        *rs.Multipass.names(),
    } - {"compaction"}


def test_a_kernel_is_the_structure_s_on_the_cpu():
    assert configure("bvh", "cpu", None, {"kernel": "single"}).structure == rs.Bvh(kernel="single")
