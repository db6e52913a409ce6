"""The whole engine for machines with narrow registers: the same tree, and the same hits.

A child process compiles everything for a processor with four lanes and without fused
multiply-add, builds trees and traces batches with every kernel. What it finds is compared with
what this machine finds.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import raystream as rs
from conftest import child_environment
from meshes import dented_sphere, soup
from raystream.jit.cache import KernelCache
from raystream.structures.bvh.batches import KERNELS

IS_X86 = platform.machine().lower() in ("x86_64", "amd64")


def batches(rng):
    """Rays that suit each kernel: an image, rays that go anywhere, and awkward limits."""
    x, y = np.meshgrid(np.linspace(-0.2, 1.2, 35), np.linspace(-0.2, 1.2, 50))
    ways = np.stack([x - 0.4, y - 0.6, np.full_like(x, 3.0)], axis=-1).astype(np.float32)
    yield "picture", {"origins": np.float32([0.4, 0.6, -3.0]), "directions": ways}
    origins = rng.normal(size=(1500, 3)).astype(np.float32)
    ways = rng.normal(size=(1500, 3)).astype(np.float32)
    yield "anywhere", {"origins": origins, "directions": ways}
    ways[::3, 1] = 0.0
    ways[::100] = np.nan
    limits = {"t_min": rng.uniform(-0.5, 0.2, 1500), "t_max": rng.uniform(0.0, 3.0, 1500)}
    yield "limits", {"origins": np.float64(origins), "directions": ways, **limits}


def scenes():
    yield "soup", rs.Scene.from_arrays(*soup(300, 1)), {}
    yield "sphere", rs.Scene.from_arrays(*dented_sphere(3)), {}


def columns(tracer, rays):
    """Results of all four queries, by name."""
    first = tracer.first_hit(**rays)
    for name in ("t", "u", "v", "prim_id", "status"):
        yield f"first hit's {name}", getattr(first, name)
    yield "any hit", tracer.any_hit(**rays)
    for crossings in ("triangles", "surfaces"):
        yield f"count of {crossings}", tracer.count_hits(**rays, crossings=crossings)
        many = tracer.multi_hit(**rays, crossings=crossings)
        for name in ("ray_splits", "t", "u", "v", "prim_id"):
            yield f"{name} of all {crossings}", getattr(many, name)


def answers():
    """A hash of the bits of each answer, and of each tree."""
    found = {}

    def note(name, array):
        found[name] = hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()

    for scene_name, scene, options in scenes():
        for kernel in KERNELS:
            tracer = rs.Tracer(scene, kernel=kernel, **options)
            for part, array in tracer.structure.saved_arrays().items():
                note(f"{scene_name}: {part}", array)
            for batch_name, rays in batches(np.random.default_rng(4)):
                for column, array in columns(tracer, rays):
                    note(f"{scene_name}, {kernel}, {batch_name}: {column}", array)
        points = np.random.default_rng(5).normal(size=(2000, 3)) * 2
        near = rs.Tracer(scene).closest_points(points, 3)
        for column in ("distance", "positions", "u", "v", "prim_id"):
            note(f"{scene_name}, points: {column}", getattr(near, column))
        note(f"{scene_name}, points: winding", rs.Tracer(scene).winding_number(points))
    return found


def kernels():
    """The compiled kernels of all packages, by location."""
    modules = [module for name, module in sys.modules.items() if name.startswith("raystream.")]
    values = [value for module in modules for value in vars(module).values()]
    loops, *others = rs.Tracer(next(scenes())[1]).structure.queries
    values += [*loops, *others]
    for value in values:
        is_kernel = isinstance(value, Dispatcher) and isinstance(value._cache, KernelCache)
        if is_kernel and value.overloads:
            yield f"{value.__module__}.{value.__name__}", value


def instructions():
    """Code specific to a family of processors, and vector registers, of each kernel."""
    found = {}
    for name, kernel in kernels():
        language = "".join(kernel.inspect_llvm().values())
        machine = "".join(kernel.inspect_asm().values())
        # LLVM itself makes the atomic ones, of Numba's reference counts.
        special = set(re.findall(r"llvm\.(?:x86|aarch64)\.(?!atomic)[\w.]*", language))
        found[name] = sorted(special), sorted(set(re.findall(r"%([xyz]mm)\d", machine)))
    return found


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """Results of a child process that compiles everything for registers of four lanes."""
    environment = child_environment(
        NUMBA_CPU_NAME="generic",
        NUMBA_CPU_FEATURES="",
        RAYSTREAM_CACHE_DIR=str(tmp_path_factory.mktemp("narrow")),
    )
    # Started in the folder of the tests: `python FILE` puts its own folder before all others.
    child = subprocess.run(
        [sys.executable, __file__],
        cwd=Path(__file__).parents[1],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert child.returncode == 0, child.stderr
    return json.loads(child.stdout)


@pytest.mark.slow
@pytest.mark.exhaustive
def test_every_kernel_gives_the_same_bits(narrow):
    here = answers()
    assert list(narrow["answers"]) == list(here)
    assert [name for name in here if narrow["answers"][name] != here[name]] == []


@pytest.mark.slow
@pytest.mark.exhaustive
def test_every_kernel_is_written_in_generic_instructions(narrow):
    names = " ".join(narrow["instructions"])
    for kernel in ("trace_wavefront", "trace_packets", "trace_groups", "first_hit"):
        assert kernel in names
    for name, (special, registers) in narrow["instructions"].items():
        assert special == [], name
        if IS_X86:
            assert set(registers) <= {"xmm"}, name


if __name__ == "__main__":
    print(json.dumps({"answers": answers(), "instructions": instructions()}))  # noqa: T201
