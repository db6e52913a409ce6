"""Devices by name: users can register one, with its own machines."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.machines import make_machine
from raystream.tracer.devices import DEVICES, build_on_cpu, device_of, register_device

SCENE = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
RAY = [0.25, 0.25, 1.0], [0.0, 0.0, -1.0]


class _Machines:
    """The CPU's machines under other names, with an option; records the calls."""

    names = ("eager", "patient")

    def __init__(self) -> None:
        self.made: list[tuple[str, str, dict]] = []

    def own_options(self, machine, options):
        if machine not in self.names:
            raise ValueError(f"machine: expected one of {self.names}, got {machine!r}")
        return {name: value for name, value in options.items() if name == "patience"}

    def make(self, machine, structure, options):
        self.made.append((machine, structure.name, dict(options)))
        return make_machine("branching", structure, {})


@pytest.fixture
def machines(monkeypatch):
    monkeypatch.setattr("raystream.tracer.devices.DEVICES", dict(DEVICES))
    made = _Machines()
    register_device("slow", machines=made)
    return made


def test_device_makes_the_machine_with_its_options(machines):
    tracer = rs.Tracer(SCENE, "grid", "slow", machine="patient", patience=3, resolution=2)
    assert machines.made == [("patient", "grid", {"patience": 3})]
    assert tracer.first_hit(*RAY).t == 1.0
    assert repr(tracer) == "Tracer(1 triangles, structure='grid', device='slow', machine='patient')"


def test_first_machine_is_the_usual_one(machines):
    tracer = rs.Tracer(SCENE, device="slow")
    assert (tracer.device, tracer.machine) == ("slow", "eager")
    assert repr(tracer) == "Tracer(1 triangles, structure='bvh', device='slow')"
    assert rs.Tracer(SCENE).machine == "branching"


def test_moved_and_loaded_tracers_stay_on_their_device(machines, tmp_path):
    tracer = rs.Tracer(SCENE, "bvh", "slow")
    tracer.update(np.asarray(SCENE.meshes[0].vertices) + [0, 0, 0.5])
    assert tracer.first_hit(*RAY).t == 0.5
    tracer.save(tmp_path / "tree.npz")
    loaded = rs.Tracer.load(tmp_path / "tree.npz", device="slow", machine="patient")
    assert loaded.first_hit(*RAY).t == 0.5
    assert [one[0] for one in machines.made] == ["eager", "eager", "patient"]


def test_unknown_devices_and_machines_are_refused(machines):
    with pytest.raises(ValueError, match=r"expected one of 'cpu', .*'graphics'.*, got 'abacus'"):
        rs.Tracer(SCENE, device="abacus")
    with pytest.raises(ValueError, match="got 'branching'"):
        rs.Tracer(SCENE, device="slow", machine="branching")
    with pytest.raises(TypeError, match="resolution"):
        rs.Tracer(SCENE, "bvh", "slow", resolution=3)


def test_factory_alone_gets_the_machines_of_the_cpu(machines):
    built = []

    def build(structure, triangles, **more):
        built.append(structure)
        return build_on_cpu(rs.Brute(), triangles, **more)

    register_device("plain", build)
    tracer = rs.Tracer(SCENE, "bvh", "plain", machine="multipass")
    assert built == [rs.Bvh()]
    assert tracer.first_hit(*RAY).t == 1.0
    assert device_of("plain").machines.names == ("branching", "multipass")
