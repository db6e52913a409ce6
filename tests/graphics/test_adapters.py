"""Selection of an adapter, and the errors where none is found."""

from __future__ import annotations

import importlib
import sys
from types import SimpleNamespace

import pytest

import raystream as rs
from raystream.graphics import adapters as module
from raystream.graphics.adapters import ADAPTER_VARIABLE, adapters, choose_adapter, open_device
from raystream.graphics.errors import GraphicsError


def adapter(name, kind, backend="Vulkan"):
    info = {"device": name, "adapter_type": kind, "backend_type": backend, "description": "1.0"}
    limits = {"max-buffer-size": 1 << 28, "max-new-thing": 3}
    features = {"shader-early-depth-test", "new-thing"}
    return SimpleNamespace(info=info, limits=limits, features=features)


@pytest.fixture
def machine_with(monkeypatch):
    """Pretend that wgpu finds these adapters."""
    monkeypatch.setattr(module, "_OPEN", {})
    monkeypatch.delenv(ADAPTER_VARIABLE, raising=False)

    def pretend(*found):
        gpu = SimpleNamespace(enumerate_adapters_sync=lambda: list(found))
        monkeypatch.setattr(module, "_wgpu", lambda: SimpleNamespace(gpu=gpu))

    return pretend


def test_real_gpus_come_first_and_opengl_is_passed_over(machine_with):
    machine_with(
        adapter("llvmpipe", "CPU"),
        adapter("OpenGL", "DiscreteGPU", "OpenGL"),
        adapter("Strange", "Quantum"),
        adapter("Iris", "IntegratedGPU"),
        adapter("Radeon", "DiscreteGPU", "D3D12"),
        adapter("M3", "IntegratedGPU", "Metal"),
    )
    assert [one.name for one in adapters()] == ["Radeon", "Iris", "M3", "Strange", "llvmpipe"]
    assert str(choose_adapter()) == "Radeon (DiscreteGPU, D3D12)"
    assert str(choose_adapter("LLVM")) == "llvmpipe (software, Vulkan)"
    assert choose_adapter("metal").name == "M3"


def test_a_name_that_no_adapter_has(machine_with, monkeypatch):
    machine_with(adapter("llvmpipe", "CPU"), adapter("Iris", "IntegratedGPU"))
    known = r"adapter: none is called 'radeon'; available: Iris \(IntegratedGPU, Vulkan\), llvmpipe"
    with pytest.raises(GraphicsError, match=known):
        rs.Tracer(rs.Scene(), "brute", "graphics", adapter="radeon")
    monkeypatch.setenv(ADAPTER_VARIABLE, "radeon")
    with pytest.raises(GraphicsError, match=known):
        rs.Tracer(rs.Scene(), "brute", "graphics")


def test_an_adapter_that_gives_no_device(machine_with):
    def refuse(**_):
        raise RuntimeError("no more devices")

    broken = adapter("Iris", "IntegratedGPU")
    broken.request_device_sync = refuse
    machine_with(broken)
    with pytest.raises(GraphicsError, match=r"adapter Iris .*: cannot be opened: no more devices"):
        open_device()


def test_limits_are_asked_for_as_they_are_offered(machine_with):
    asked, features = [], []
    generous = adapter("Iris", "IntegratedGPU")

    def give(*, required_limits, required_features):
        asked.append(required_limits)
        features.extend(required_features)
        return SimpleNamespace(limits=required_limits, features=required_features)

    generous.request_device_sync = give
    machine_with(generous)
    assert open_device().limits == {"max-buffer-size": 1 << 28}
    assert asked == [{"max-buffer-size": 1 << 28}]
    assert features == ["shader-early-depth-test"]
    assert open_device().has_early_test


NO_ADAPTER = r"device 'graphics': no Vulkan.* adapter; install .* apt install mesa-vulkan-drivers"
NO_WGPU = r"device 'graphics': needs wgpu; install it with: pip install 'raystream\[graphics\]'"


def test_no_adapter_says_what_to_install(machine_with):
    machine_with(adapter("OpenGL", "DiscreteGPU", "OpenGL"))
    assert adapters() == []
    with pytest.raises(GraphicsError, match=NO_ADAPTER):
        rs.Tracer(rs.Scene(), "brute", "graphics")
    assert not rs.Tracer(rs.Scene(), "brute").any_hit([0, 0, 0], [1, 0, 0])


@pytest.fixture
def without_wgpu(monkeypatch):
    monkeypatch.setattr(module, "_OPEN", {})
    monkeypatch.setitem(sys.modules, "wgpu", None)


def test_no_wgpu_says_what_to_install(without_wgpu):
    with pytest.raises(GraphicsError, match=NO_WGPU):
        rs.Tracer(rs.Scene(), "brute", "graphics")
    assert not rs.Tracer(rs.Scene(), "brute").any_hit([0, 0, 0], [1, 0, 0])


def test_wgpu_that_cannot_be_loaded(monkeypatch):
    """Its library is missing, say, or made for another machine."""
    monkeypatch.setattr(module, "_OPEN", {})

    def fail(name):
        raise OSError("libwgpu_native.so: wrong ELF class")

    monkeypatch.setattr(importlib, "import_module", fail)
    with pytest.raises(GraphicsError, match=r"wgpu cannot be used: libwgpu_native\.so: wrong ELF"):
        adapters()


def test_one_device_is_shared_until_it_is_lost(fresh):
    assert open_device() is fresh
    assert str(open_device(fresh.adapter.name[:4]).adapter) == str(fresh.adapter)
    assert not fresh.is_lost
    fresh.device.destroy()
    assert fresh.is_lost
    assert open_device() is not fresh
