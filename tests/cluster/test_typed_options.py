"""Typed options on their way to workers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import raystream as rs
from extras import need

need("distributed")

from raystream.cluster.tracer_bundles import pack_tracer, unpack_tracer
from raystream.core.choices import DeviceOptions
from raystream.tracer.devices import DEVICES, register_device

SCENE = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


@dataclass(frozen=True, kw_only=True)
class Slow(DeviceOptions):
    name = "slow"
    patience: int = 1


@pytest.fixture(autouse=True)
def _slow(monkeypatch):
    monkeypatch.setattr("raystream.tracer.devices.DEVICES", dict(DEVICES))
    register_device("slow", options=Slow)


def sent(structure, device, **options) -> rs.Tracer:
    """The tracer that a worker makes."""
    bundle = pack_tracer(SCENE, structure, device, options, for_rendering=False)
    return unpack_tracer(bundle.header, bundle.arrays)


@pytest.mark.parametrize("device", ["cpu", rs.Cpu(), "slow", Slow(patience=3)])
@pytest.mark.parametrize("structure", [rs.Grid(resolution=2), rs.Bvh(kernel="single")])
def test_structures_and_devices_arrive(structure, device):
    tracer = sent(structure, device)
    assert tracer.structure.options == structure
    assert tracer.device == getattr(device, "name", device)
    assert tracer.first_hit([0.2, 0.2, 1.0], [0.0, 0.0, -1.0]).t == 1.0


@pytest.mark.parametrize("device", ["cpu", Slow()])
def test_machines_arrive(device):
    tracer = sent("grid", device, machine=rs.Multipass(scheduler="naive"), resolution=3)
    assert (tracer.machine, tracer.machine_options) == ("multipass", {"scheduler": "naive"})
    assert np.array_equal(tracer.structure.options.resolution, (3, 3, 3))
