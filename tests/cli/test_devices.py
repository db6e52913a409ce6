"""``--device graphics`` and ``cuda``, and ``raystream info --devices``."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import raystream as rs
from conftest import skip_without_adapter
from raystream.jit.threads import thread_count

COMMANDS = {
    "render": ["render", "square.obj", "--size", "8x8"],
    "info": ["info", "square.obj"],
    "query": ["query", "square.obj", "rays.npz", "-o", "hits.npz"],
}


@pytest.fixture
def adapter():
    skip_without_adapter()


@pytest.fixture
def without_adapter(monkeypatch):
    nothing = SimpleNamespace(enumerate_adapters_sync=list)
    monkeypatch.setattr("raystream.graphics.adapters._OPEN", {})
    monkeypatch.setitem(sys.modules, "wgpu", SimpleNamespace(gpu=nothing))


@pytest.fixture
def without_wgpu(monkeypatch):
    monkeypatch.setattr("raystream.graphics.adapters._OPEN", {})
    monkeypatch.setitem(sys.modules, "wgpu", None)


@pytest.fixture(params=COMMANDS)
def command(request, square, rays):
    return [*COMMANDS[request.param], "--structure", "grid"]


def test_json_names_the_device_and_its_machine(run, command, adapter):
    figures = run(*command, "--device", "graphics", "--json").figures
    assert (figures["device"], figures["machine"]) == ("graphics", "compute")


def test_hits_are_the_processor_s(run, square, rays, adapter):
    found = []
    for device in ("cpu", "graphics"):
        asked = ("--structure", "grid", "--device", device)
        assert run("query", square, rays, "-o", f"{device}.npz", *asked).code == 0
        with np.load(f"{device}.npz") as arrays:
            found.append(dict(arrays))
    cpu, graphics = found
    assert cpu.keys() == graphics.keys()
    for name in ("prim_id", "mesh_id", "status"):
        np.testing.assert_array_equal(cpu[name], graphics[name])
    for name in ("t", "u", "v"):
        np.testing.assert_allclose(graphics[name], cpu[name], rtol=1e-5)


def test_pictures_are_the_processor_s(run, adapter):
    """Rendered in bands, by several threads."""
    pictures = []
    for device in ("cpu", "graphics"):
        asked = ("--mode", "shadow", "--size", "96x96", "--structure", "grid", "--device", device)
        assert run("render", "cornell", "-o", f"{device}.png", *asked).code == 0
        pictures.append(rs.Image.load(f"{device}.png").pixels)
    is_other = (np.abs(pictures[0] - pictures[1]) > 0.02).any(axis=2)
    assert is_other.mean() < 0.002  # a shadow's edge may lie in the last digit of t
    assert pictures[0].std() > 0.05


def test_saved_structure(run, square, rays, adapter):
    rs.Tracer(rs.load(square), "grid").save("saved.npz")
    asked = ("--device", "graphics", "--option", "rays_at_once=2", "--json")
    figures = run("query", "saved.npz", rays, "-o", "hits.npz", *asked).figures
    assert (figures["machine"], figures["rays_hit"]) == ("compute", 2)
    complaint = run(
        "info", "saved.npz", "--device", "graphics", "--option", "threshold=1"
    ).complaint
    assert "'threshold'" in complaint


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--adapter", "abacus"], "adapter: none is called 'abacus'; available: "),
        (["--machine", "abacus"], "expected branching or multipass or compute, got 'abacus'"),
        (["--option", "machine=abacus"], "--machine: expected one of 'compute'"),
        (["--option", "rays_at_once=0"], "--option: rays_at_once: expected at least 1, got 0"),
        (["--scheduler", "naive"], "--scheduler: only with --machine multipass"),
    ],
)
def test_bad_choices_are_refused_in_one_line(run, command, adapter, arguments, complaint):
    assert complaint in run(*command, "--device", "graphics", *arguments).complaint


def test_a_structure_without_shaders(run, square, adapter, monkeypatch):
    monkeypatch.delitem(rs.Grid.forms, "graphics")
    refused = run("info", square, "--device", "graphics", "--structure", "grid").complaint
    assert refused.startswith("device 'graphics': supports the structures 'bvh'")
    assert refused.endswith("not 'grid'")


def test_no_adapter(run, command, without_adapter):
    complaint = run(*command, "--device", "graphics").complaint
    assert "no Vulkan, Metal or Direct3D 12 adapter; install the driver" in complaint
    assert run(*command).code == 0


def test_no_wgpu(run, command, without_wgpu):
    complaint = run(*command, "--device", "graphics").complaint
    assert complaint.endswith("install it with: pip install 'raystream[graphics]'")
    assert run(*command).code == 0


# raystream info --devices


def test_devices_are_listed(run, adapter):
    figures = run("info", "--devices", "--json").figures
    assert figures["cpu"]["threads"] == thread_count()
    assert figures["cpu"]["name"]
    graphics = figures["graphics"]
    assert graphics["error"] is None
    assert [one["is_default"] for one in graphics["adapters"]].count(True) == 1
    for one in graphics["adapters"]:
        assert one["backend"] in ("Vulkan", "Metal", "D3D12")
        assert one["limits"]["max-buffer-size"] >= 1 << 28  # WebGPU promises as much
    result = run("info", "--devices", "--threads", 3)
    assert (result.code, result.err) == (0, "")
    assert ["threads", "3"] in [line.split() for line in result.out.splitlines()]
    for one in graphics["adapters"]:
        assert one["name"] in result.out
        assert ("software" in result.out) == (one["kind"] == "software")


def test_no_devices_but_the_processor(run, without_adapter):
    graphics = run("info", "--devices", "--json").figures["graphics"]
    assert graphics["adapters"] == []
    assert "mesa-vulkan-drivers" in graphics["error"]
    result = run("info", "--devices")
    assert result.code == 0
    assert "no graphics: device 'graphics': no Vulkan" in result.out


def test_what_to_install_is_said(run, without_wgpu):
    assert "pip install 'raystream[graphics]'" in run("info", "--devices").out


def test_an_adapter_that_is_not_there(run, monkeypatch, adapter):
    monkeypatch.setenv("RAYSTREAM_ADAPTER", "abacus")
    graphics = run("info", "--devices", "--json").figures["graphics"]
    assert graphics["adapters"]
    assert not any(one["is_default"] for one in graphics["adapters"])
    assert "none is called 'abacus'" in graphics["error"]


GPUS = [
    SimpleNamespace(number=0, name="Fast", capability=(9, 0), byte_count=85 * 10**9, error=None),
    SimpleNamespace(number=1, name="Old", capability=(6, 1), byte_count=4 * 10**9, error="too old"),
]


def test_gpus_of_cuda_are_listed(run, monkeypatch):
    monkeypatch.setattr("raystream.cuda.devices.list_gpus", lambda: (GPUS, (12, 9)))
    cuda = run("info", "--devices", "--json").figures["cuda"]
    assert (cuda["driver"], cuda["error"]) == ("12.9", None)
    assert list(cuda["gpus"][0].values()) == [0, "Fast", "9.0", 85 * 10**9, None]
    lines = run("info", "--devices").out.splitlines()
    assert "driver for CUDA 12.9" in lines[-3]
    assert lines[-2].split() == ["0", "Fast", "9.0", "85.0", "GB"]
    assert lines[-1].split() == ["1", "Old", "6.1", "4.0", "GB", "too", "old"]


def test_no_cuda(run, square, rays, monkeypatch):
    """Said in one line; the CPU is used as ever."""
    monkeypatch.setitem(sys.modules, "raystream.jit.cuda", None)
    reason = "device 'cuda': needs numba-cuda; pip install 'raystream[cuda]'"
    cuda = run("info", "--devices", "--json").figures["cuda"]
    assert cuda["gpus"] == []
    assert cuda["error"].startswith(reason)
    assert f"no CUDA: {reason}" in run("info", "--devices").out
    for command in COMMANDS.values():
        asked = *command, "--structure", "grid"
        assert run(*asked, "--device", "cuda").complaint.startswith(reason)
        assert run(*asked).code == 0
        assert run(*asked, "--gpu", 0).complaint == "--gpu: only with --device cuda"


@pytest.mark.parametrize("arguments", [[], ["cornell", "--devices"]])
def test_scene_or_devices(run, arguments):
    assert run("info", *arguments).complaint == "info: expected either SCENE or --devices"
