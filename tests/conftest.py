"""Fixtures that tests share."""

from __future__ import annotations

import gc
import math
import os
import signal
import sys
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import raystream as rs
from docstrings import Docstrings
from extras import Skipped, need
from tally import Tally
from tiers import Tiers

# Kernels may have to be compiled, and cores are shared: no test of properties is timed.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


def pytest_configure(config: pytest.Config) -> None:
    """Let tests be interrupted, and note which skip for want of a package."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell began this in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    path = os.environ.get("RAYSTREAM_TEST_SKIPPED")
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Skipped(Path(path)))
    config.pluginmanager.register(Docstrings())
    config.pluginmanager.register(Tiers())
    counts = os.environ.get("RAYSTREAM_TEST_TALLY")
    tally = Tally(Path(counts) if counts and not hasattr(config, "workerinput") else None)
    tally.listen()
    config.pluginmanager.register(tally)


MULTIPASS = {"machine": "multipass"}

GRAPHICS = {"device": "graphics"}

#: Every way to trace on the CPU: structure and the options of its tracer. A new structure or
#: machine gets its line here, and is then compared with brute force in every query: by its bits.
TRACERS = {
    "brute": {"structure": "brute"},
    "bvh": {"structure": "bvh"},
    "bvh, wavefront": {"structure": "bvh", "kernel": "wavefront"},
    "bvh, packets": {"structure": "bvh", "kernel": "packet"},
    "bvh, groups": {"structure": "bvh", "kernel": "groups"},
    "bvh, single rays": {"structure": "bvh", "kernel": "single"},
    "bvh, fast": {"structure": "bvh", "quality": "fast"},
    "bvh, leaves of 1": {"structure": "bvh", "max_leaf_size": 1},
    "bvh, leaves of 32": {"structure": "bvh", "max_leaf_size": 32, "kernel": "wavefront"},
    "grid": {"structure": "grid"},
    "grid, one cell": {"structure": "grid", "resolution": 1},
    "grid, 7 x 3 x 5": {"structure": "grid", "resolution": (7, 3, 5)},
    "grid, two levels": {"structure": "grid", "resolution": (2, 3, 2), "levels": 2},
    "kdtree, stack": {"structure": "kdtree"},
    "kdtree, restart": {"structure": "kdtree", "traversal": "restart", "intersection_cost": 12.0},
    "kdtree, backtrack": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "intersection_cost": 12.0,
        "empty_bonus": 0.8,
    },
    "kdtree, short stack": {
        "structure": "kdtree",
        "traversal": "short-stack",
        "intersection_cost": 12.0,
    },
    "kdtree, Foley's": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "layout": "foley",
        "traversal_cost": 8.0,
        "intersection_cost": 1.0,
    },
    "kdtree, shallow": {
        "structure": "kdtree",
        "layout": "foley",
        "intersection_cost": 12.0,
        "max_depth": 3,
    },
    "graph": {"structure": "graph"},
    "graph, small sectors": {
        "structure": "graph",
        "crossing_cost": 0.5,
        "link_cost": 0.1,
        "max_leaf_size": 1,
    },
    "graph, multipass": {
        "structure": "graph",
        "crossing_cost": 2.0,
        "link_cost": 0.5,
        **MULTIPASS,
        "scheduler": "double",
        "traversal_steps": 2,
        "intersections": 2,
    },
    "brute, multipass": {"structure": "brute", **MULTIPASS, "intersections": 50},
    "bvh, multipass": {"structure": "bvh", **MULTIPASS},
    "bvh, multipass, compacting": {
        "structure": "bvh",
        **MULTIPASS,
        "scheduler": "most-work",
        "traversal_steps": 3,
        "intersections": 2,
        "compaction": True,
    },
    "grid, multipass": {"structure": "grid", **MULTIPASS, "scheduler": "naive"},
    "grid, 7 x 3 x 5, multipass": {
        "structure": "grid",
        "resolution": (7, 3, 5),
        **MULTIPASS,
        "scheduler": "double",
        "traversal_steps": 4,
        "intersections": 2,
        "compaction": True,
    },
    "grid, two levels, multipass": {
        "structure": "grid",
        "resolution": (2, 3, 2),
        "levels": 2,
        **MULTIPASS,
        "scheduler": "most-work",
        "traversal_steps": 2,
        "intersections": 5,
    },
    "kdtree, stack, multipass": {"structure": "kdtree", **MULTIPASS},
    "kdtree, restart, multipass": {
        "structure": "kdtree",
        "traversal": "restart",
        "intersection_cost": 12.0,
        **MULTIPASS,
        "scheduler": "double",
        "traversal_steps": 8,
        "intersections": 4,
        "compaction": True,
    },
    "kdtree, backtrack, multipass": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "layout": "foley",
        **MULTIPASS,
        "scheduler": "most-work",
        "traversal_steps": 5,
        "intersections": 3,
    },
}


#: Those with distinct code: a traversal, a kernel or a machine that no other one of these has. The
#: rest run the same code on another tree, or in other passes. CI has these in every test of
#: tracers, and the rest with some cases in turn: see `is_turn`. `.ci/nightly` runs all. A new line
#: above with its own code gets one here, too.
CODE_PATHS = (
    "brute",
    "bvh",
    "bvh, wavefront",
    "bvh, packets",
    "bvh, groups",
    "bvh, single rays",
    "grid",
    "grid, two levels",
    "kdtree, stack",
    "kdtree, restart",
    "kdtree, backtrack",
    "kdtree, short stack",
    "graph",
    "bvh, multipass, compacting",
    "kdtree, backtrack, multipass",
)


#: One of each kind of code: every structure, each of the BVH's kernels for many rays, and passes.
#: A default run has only these.
EVERYDAY = (
    "brute",
    "bvh",
    "bvh, wavefront",
    "bvh, packets",
    "bvh, groups",
    "grid",
    "kdtree, stack",
    "graph",
    "bvh, multipass, compacting",
)


def tier(*, is_everyday: bool, is_ci: bool = True) -> list[pytest.MarkDecorator]:
    """The marks of a parameter: none if a default run has it."""
    return [] if is_everyday else [pytest.mark.ci if is_ci else pytest.mark.exhaustive]


def is_turn(tracer: str, number: int, every: int) -> bool:
    """Whether it is a tracer's turn in the case of this number: one case in `every`.

    Any `every` consecutive tracers in the table cover all cases between them.
    """
    return (list(TRACERS).index(tracer) + number) % every == 0


def _tree_of(tracer: str) -> dict[str, object]:
    """The options of the build, without those of tracing."""
    how = ("kernel", "machine", "scheduler", "traversal_steps", "intersections", "compaction")
    return {key: value for key, value in TRACERS[tracer].items() if key not in how}


#: One for each tree that they build.
TREES = [
    name
    for i, name in enumerate(TRACERS)
    if _tree_of(name) not in [_tree_of(one) for one in list(TRACERS)[:i]]
]


def every_tracer(
    in_ci: Collection[str] = CODE_PATHS, everyday: Collection[str] = EVERYDAY
) -> list[Any]:
    """Tracers by name, as parameters of a test: these in CI, and those of them in a default run."""
    return [
        pytest.param(name, marks=tier(is_everyday=name in everyday, is_ci=name in in_ci))
        for name in TRACERS
    ]


#: For tests of one case, for tests of building, moving or saving, and for tests of what does not
#: depend on how rays are searched.
EVERY_TRACER = every_tracer()
EVERY_TREE = every_tracer({*CODE_PATHS, *TREES})
EVERY_QUERY = every_tracer(everyday=("brute", "bvh", "kdtree, stack"))

#: The same on graphics devices, where t, u and v are compared with a tolerance.
GRAPHICS_TRACERS = {
    "brute, graphics": {"structure": "brute", **GRAPHICS},
    "grid, graphics": {"structure": "grid", **GRAPHICS},
    "grid, two levels, graphics": {
        "structure": "grid",
        "resolution": (2, 3, 2),
        "levels": 2,
        **GRAPHICS,
    },
    "bvh, graphics": {"structure": "bvh", **GRAPHICS},
    "kdtree, stack, graphics": {"structure": "kdtree", **GRAPHICS},
    "kdtree, restart, graphics": {
        "structure": "kdtree",
        "traversal": "restart",
        "layout": "foley",
        **GRAPHICS,
    },
    "kdtree, backtrack, graphics": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "intersection_cost": 12.0,
        **GRAPHICS,
    },
    "kdtree, short stack, graphics": {
        "structure": "kdtree",
        "traversal": "short-stack",
        "layout": "foley",
        "intersection_cost": 12.0,
        **GRAPHICS,
    },
    "graph, graphics": {"structure": "graph", **GRAPHICS},
    "grid, fragments, graphics": {"structure": "grid", **GRAPHICS, "machine": "branching"},
    "brute, multipass, graphics": {
        "structure": "brute",
        **GRAPHICS,
        **MULTIPASS,
        "intersections": 50,
    },
    "grid, multipass, graphics": {
        "structure": "grid",
        "resolution": (2, 3, 2),
        **GRAPHICS,
        **MULTIPASS,
        "scheduler": "naive",
        "intersections": 3,
    },
    "kdtree, restart, multipass, graphics": {
        "structure": "kdtree",
        "traversal": "restart",
        "intersection_cost": 12.0,
        **GRAPHICS,
        **MULTIPASS,
        "traversal_steps": 3,
    },
    "kdtree, backtrack, multipass, graphics": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "layout": "foley",
        **GRAPHICS,
        **MULTIPASS,
        "scheduler": "double",
        "intersections": 2,
    },
}


CUDA = {"device": "cuda"}

#: Every way to trace on CUDA, to be compared with brute force by the bits: on a GPU, or with few
#: rays in Numba's simulator (``NUMBA_ENABLE_CUDASIM=1``).
CUDA_TRACERS = {
    "brute": {"structure": "brute", **CUDA},
    "bvh": {"structure": "bvh", **CUDA},
    "grid": {"structure": "grid", **CUDA},
    "grid, two levels": {"structure": "grid", "resolution": (2, 3, 2), "levels": 2, **CUDA},
    "kdtree, stack": {"structure": "kdtree", **CUDA},
    "kdtree, restart": {
        "structure": "kdtree",
        "traversal": "restart",
        "intersection_cost": 12.0,
        **CUDA,
    },
    "kdtree, backtrack": {
        "structure": "kdtree",
        "traversal": "backtrack",
        "layout": "foley",
        "traversal_cost": 8.0,
        "intersection_cost": 1.0,
        **CUDA,
    },
    "kdtree, short stack": {
        "structure": "kdtree",
        "traversal": "short-stack",
        "intersection_cost": 12.0,
        **CUDA,
    },
    "graph": {"structure": "graph", **CUDA},
}

BUILT = {"build": "device", **CUDA}

#: And those that are for a GPU alone: blocks of threads that build take the simulator seconds.
GPU_TRACERS = {
    "bvh, built there": {"structure": "bvh", **BUILT},
    "grid, built there": {"structure": "grid", **BUILT},
    "kdtree, built there": {"structure": "kdtree", **BUILT},
    "graph, built there": {"structure": "graph", **BUILT},
}


#: In float64.
FLOAT64 = {"precision": "float64", **CUDA}
FLOAT64_CUDA_TRACERS = {
    "bvh, float64": {"structure": "bvh", **FLOAT64},
    "brute, float64": {"structure": "brute", **FLOAT64},
}


@pytest.fixture(params=EVERY_TRACER)
def make_tracer(request):
    """Make a tracer for a scene on the CPU, once for each structure and machine."""
    return lambda scene: rs.Tracer(scene, **TRACERS[request.param])


#: All in CI, but for fragment programs, where a test does not say otherwise: they take many passes.
EVERY_GRAPHICS_TRACER = [
    pytest.param(name, marks=tier(is_everyday=False, is_ci="machine" not in options))
    for name, options in GRAPHICS_TRACERS.items()
]


@pytest.fixture(params=[*EVERY_TRACER, *EVERY_GRAPHICS_TRACER])
def make_tracer_anywhere(request):
    """Make a tracer for a scene, once for each structure, machine and device."""
    if request.param in GRAPHICS_TRACERS:
        skip_without_adapter()
        return lambda scene: rs.Tracer(scene, **GRAPHICS_TRACERS[request.param])
    return lambda scene: rs.Tracer(scene, **TRACERS[request.param])


@cache
def reason_against_graphics() -> str:
    """Why no graphics device can be opened here, in a line; nothing if one can."""
    from raystream.graphics.adapters import choose_adapter
    from raystream.graphics.errors import GraphicsError

    try:
        choose_adapter()
    except GraphicsError as error:
        return str(error)
    return ""


def skip_without_adapter() -> None:
    """Skip the calling test, with the reason, where wgpu or an adapter is missing."""
    need("wgpu")
    if reason := reason_against_graphics():
        pytest.skip(reason)


@cache
def reason_against_cuda() -> str:
    """Why there is no CUDA device here, in a line; nothing if there is one."""
    try:
        from raystream.jit.cuda import CudaError, open_gpu
    except ImportError as error:
        return f"needs numba-cuda: {error}"
    try:
        open_gpu()
    except CudaError as error:
        return f"{error} (NUMBA_ENABLE_CUDASIM=1 simulates one)"
    return ""


def skip_without_cuda() -> None:
    """Skip the calling test, with the reason, where numba-cuda or a GPU is missing."""
    need("numba_cuda")
    if reason := reason_against_cuda():
        pytest.skip(reason)


@pytest.fixture
def rng():
    return np.random.default_rng(2013)


@pytest.fixture(scope="session")
def scenes_folder() -> Path:
    """The folder of public models; tests that need it skip without it."""
    folder = os.environ.get("RAYSTREAM_SCENES")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs public models: set RAYSTREAM_SCENES to their folder")
    return Path(folder)


@pytest.fixture(scope="module")
def few_objects():
    """For tests of what collects garbage before each measurement: it need not look at all that
    other tests and the compiler have left."""
    gc.freeze()
    yield
    gc.unfreeze()


def leave_out_first_use(monkeypatch) -> None:
    """Make commands compile only what they need, and silently, as after the first use."""
    from raystream.cli import compiling

    monkeypatch.setattr(compiling.KernelCompilation, "_compile_all", lambda *_: None)
    monkeypatch.setattr(compiling, "DELAY", math.inf)


def child_environment(**changes: str) -> dict[str, str]:
    """The environment for a process that imports what this one does."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **changes}


def assert_same_bits(a, b) -> None:
    """Floats are compared as integers: -0 is not 0, and NaN is NaN."""
    a, b = np.asarray(a), np.asarray(b)
    assert a.dtype == b.dtype
    assert a.shape == b.shape
    assert a.tobytes() == b.tobytes(), np.flatnonzero(a.ravel() != b.ravel())[:5]
