"""Memory, cores and the machine."""

from __future__ import annotations

import os

import pytest

import raystream as rs
from raystream.bench.contender_process import ContenderError, ContenderProcess
from raystream.bench.contenders import Entry
from raystream.bench.cores import limit_cores
from raystream.bench.machine import describe_machine
from raystream.bench.memory import Memory, can_measure
from raystream.bench.runner import geometry_of
from raystream.bench.worker import save_geometry


@pytest.mark.skipif(not can_measure(), reason="needs /proc/self/status, which only Linux has")
def test_memory_is_that_of_the_structure(tmp_path):
    geometry = geometry_of(rs.load("forest:200000"))
    save_geometry(tmp_path, geometry)
    process = ContenderProcess(Entry("raystream", "raystream", {}), 1)
    try:
        memory = Memory(**process.ask("build", folder=str(tmp_path), measured=True)["memory"])
        assert "memory" not in process.ask("build", folder=str(tmp_path), measured=False)
    finally:
        process.close()
    triangle_bytes = 36 * len(geometry.faces)
    assert triangle_bytes < memory.kept < 30 * triangle_bytes
    assert memory.kept <= memory.peak + (1 << 20)


def test_a_contender_that_cannot_start_leaves_no_process():
    with pytest.raises(ContenderError, match=r"TypeError: .*speed"):
        ContenderProcess(Entry("raystream", "raystream", {"speed": 9}), 1)


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="needs sched_setaffinity, which only Linux has"
)
def test_cores_are_limited_and_given_back():
    before = os.sched_getaffinity(0)
    with limit_cores(1):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
    with limit_cores(10_000):
        assert os.sched_getaffinity(0) == before


def test_machine():
    machine = describe_machine(3)
    assert machine["threads"] == 3
    assert machine["cpu"]
    assert machine["cores"] >= 1
    assert machine["numba"]
