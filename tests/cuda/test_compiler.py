"""Kernels are compiled without a device; and products and sums are not fused."""

from __future__ import annotations

import re

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from raystream.jit.cpu import kernel
from raystream.jit.cuda import CAPABILITIES, RangeKernel, is_simulated
from raystream.jit.cuda.arguments import flat
from raystream.jit.simd import load, store

if is_simulated():
    pytest.skip("the simulator has no compiler", allow_module_level=True)

from raystream.cuda.precompile import (
    point_kernels,
    scenes_of_kinds,
    shared_kernels,
    structure_kernels,
)
from raystream.structures import STRUCTURES

QUERIES = ("first_hit", "any_hit", "count_hits", "multi_hit")


def parameters_of(compiled):
    """Types of a kernel's parameters."""
    text = compiled.ptx[compiled.ptx.index(f".visible .entry {compiled.entry}") :]
    return re.findall(r"\.param \.(\w+)", text[: text.index("{")])


@pytest.fixture(scope="module")
def scene():
    return rs.load("cornell")


#: Every structure, and its ways to be traced: options of `structure_kernels`.
WAYS = {
    **{name: {} for name in STRUCTURES},
    "bvh, own layout": {"is_own": True, "counters": True},
    "bvh, float64": {"precision": "float64"},
    "brute, float64": {"precision": "float64"},
}


#: The kernels compiled in a default run; .ci/nightly compiles everything.
USUAL = [
    ("kdtree", "multi_hit"),
    ("bvh", "first_hit"),
    ("bvh, float64", "multi_hit"),
]


@pytest.mark.parametrize(
    ("name", "query"),
    [
        pytest.param(
            name,
            query,
            marks=[pytest.mark.exhaustive] * ((name, query) not in USUAL),
        )
        for name in WAYS
        for query in QUERIES
    ],
)
def test_every_kernel_compiles(scene, name, query):
    made, arguments = structure_kernels(name.partition(",")[0], scene, **WAYS[name])[query]
    compiled = made.compiled(arguments, CAPABILITIES[0])
    assert f".target sm_{CAPABILITIES[0][0]}{CAPABILITIES[0][1]}" in compiled.ptx
    assert len(parameters_of(compiled)) == 1 + len(list(flat(arguments)))
    # Nodes and triangles made for GPUs are read by 16 bytes.
    is_float64 = "float64" in name
    assert ("ld.global.nc.v4" in compiled.ptx) == (name in ("bvh", "bvh, float64"))
    # Fused in float64 is on purpose: distances of boxes, signs with bounds, errors of products.
    assert ("fma.rn.f64" in compiled.ptx) == is_float64
    assert "fma.rn.f32" not in compiled.ptx or not is_float64
    # The largest memory of a thread: its stack, and expansions (docs/decisions/0052-float64.rst).
    depots = map(int, re.findall(r"__local_depot\d+\[(\d+)\]", compiled.ptx))
    assert not is_float64 or sum(depots) < 18_000
    # Nothing is left to a linker, such as a function that only CPUs have.
    assert ".extern .func" not in compiled.ptx
    # Small numbers are not flushed to 0; divisions and roots are those of IEEE 754.
    assert not re.search(r"\.(ftz|approx|full)\b", compiled.ptx)


#: Most local memory of a thread, bytes: the stacks of two trees, and of a tree and a height field.
LOCAL_BYTES = {
    **{("bvh", "instances"): 1904, ("brute", "instances"): 192},
    **{("bvh", "primitives"): 3440, ("brute", "primitives"): 6784},
}


@pytest.mark.exhaustive  # test_ptx.py compiles some in a default run
@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize(("name", "kind"), LOCAL_BYTES)
def test_every_kernel_of_instances_and_primitives_compiles(scene, name, kind, query):
    made, arguments = structure_kernels(name, scenes_of_kinds(scene)[kind])[query]
    compiled = made.compiled(arguments, CAPABILITIES[0])
    assert len(parameters_of(compiled)) == 1 + len(list(flat(arguments)))
    assert ".extern .func" not in compiled.ptx
    assert "fma.rn.f64" not in compiled.ptx
    assert not re.search(r"\.(ftz|approx|full)\b", compiled.ptx)
    depots = re.findall(r"\.local .*__local_depot\d+\[(\d+)\]", compiled.ptx)
    assert sum(map(int, depots)) <= LOCAL_BYTES[name, kind] + 64


OTHERS = [
    f"{name}, {kind}"
    for name in ("brute", "bvh")
    for kind in ("instances", "primitives", "float64")
]


@pytest.mark.parametrize(
    "name",
    ["brute", "bvh", *(pytest.param(one, marks=pytest.mark.exhaustive) for one in OTHERS)],
)
def test_every_kernel_of_points_compiles(scene, name):
    made, arguments = point_kernels(scene)[name]
    compiled = made.compiled(arguments, CAPABILITIES[0])
    assert len(parameters_of(compiled)) == 1 + len(list(flat(arguments)))
    assert ".extern .func" not in compiled.ptx
    assert "fma.rn.f64" in compiled.ptx  # of the products of normals, and no others
    assert not re.search(r"\.(ftz|approx|full)\b", compiled.ptx)


@pytest.mark.parametrize("name", shared_kernels("arrays"))
def test_every_kernel_over_arrays_compiles(name):
    made, arguments = shared_kernels("arrays")[name]
    compiled = made.compiled(arguments, CAPABILITIES[0])
    assert len(parameters_of(compiled)) == 1 + len(list(flat(arguments)))


@pytest.mark.parametrize(
    "name",
    [
        "compact",
        "add_unblocked",
        *(
            pytest.param(name, marks=pytest.mark.exhaustive)
            for name in (
                "generate_camera_rays",
                "shade_paths",
                "shade_unshadowed",
                "shade_facing_ratio",
                "sample_all_lights",
                "spawn_ao_rays",
            )
        ),
    ],
)
def test_every_kernel_of_renderers_compiles(name):
    made, arguments = shared_kernels("rendering")[name]
    compiled = made.compiled(arguments, CAPABILITIES[0])
    assert len(parameters_of(compiled)) == 1 + len(list(flat(arguments)))
    assert ".extern .func" not in compiled.ptx
    assert "fma.rn.f32" not in compiled.ptx
    # NVIDIA's sines, arcs and powers have float64 fused on purpose, and begin with a guess.
    ours = compiled.ptx
    if name not in ("generate_camera_rays", "spawn_ao_rays", "compact", "add_unblocked"):
        ours = re.sub(r"rcp\.approx\.ftz\.f64|fma\.rn\.f64", "", ours)
    assert not re.search(r"\.(ftz|approx|full)\b|fma\.rn\.f64", ours)
    # One path per thread: local memory holds a few lanes, not 16 of everything.
    depot = re.search(r"\.local .*__local_depot\d+\[(\d+)\]", compiled.ptx)
    assert depot is None or int(depot[1]) < 1024


@kernel
def _multiply_and_add(i, x, to):
    a = load(np.float32, x + np.uint64(4) * i)
    store(to + np.uint64(4) * i, a * a + a)


def test_nothing_is_fused():
    zero = np.uint64(0)
    ptx = RangeKernel(_multiply_and_add).compiled((zero, zero), (7, 5)).ptx
    assert "fma" not in ptx
    assert "mul.rn.f32" in ptx
    assert "add.rn.f32" in ptx


def test_code_is_kept_on_disk(tmp_path, monkeypatch):
    from raystream.jit.cuda import compiler, ptx_cache

    monkeypatch.setattr(ptx_cache, "kernel_folder", lambda: tmp_path)
    zero = np.uint64(0)
    one = RangeKernel(_multiply_and_add)
    first = one.compiled((zero, zero), (7, 5))
    (file,) = tmp_path.iterdir()
    assert file.read_text() == first.ptx
    monkeypatch.setattr(compiler, "_ptx_of", None)
    assert one.compiled((zero, zero), (7, 5)) == first
    with pytest.raises(TypeError):  # other arguments, other code
        one.compiled((zero, np.float32(0.0)), (7, 5))
