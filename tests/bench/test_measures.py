"""Memory, cores and the machine."""

from __future__ import annotations

import os

import pytest

import raystream as rs
from raystream.bench.contenders import Entry
from raystream.bench.cores import limit_cores
from raystream.bench.machine import describe_machine
from raystream.bench.memory import can_measure, measure_memory
from raystream.bench.runner import geometry_of


@pytest.mark.skipif(not can_measure(), reason="needs /proc/self/status, which only Linux has")
def test_memory_is_that_of_the_structure():
    geometry = geometry_of(rs.load("forest:200000"))
    memory = measure_memory(Entry("raystream", "raystream", {}), geometry, 1)
    assert memory is not None
    triangle_bytes = 36 * len(geometry.faces)
    assert triangle_bytes < memory.kept < 30 * triangle_bytes
    assert memory.kept <= memory.peak + (1 << 20)


@pytest.mark.skipif(not can_measure(), reason="needs /proc/self/status, which only Linux has")
def test_memory_of_what_fails_is_unknown():
    geometry = geometry_of(rs.load("cornell"))
    assert measure_memory(Entry("raystream", "raystream", {"speed": 9}), geometry, 1) is None


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
