"""Every kernel form on the bunny at 256 x 256, beside the CPU: hits, passes and active rays."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import raystream as rs
from conftest import skip_without_adapter
from tolerance import Tolerance, assert_close

pytestmark = pytest.mark.exhaustive

SIZE = 256

STRUCTURES = {
    "bvh": {"structure": "bvh"},
    "grid": {"structure": "grid"},
    "kd-tree": {"structure": "kdtree"},
    "kd-restart": {"structure": "kdtree", "traversal": "restart"},
    "kd-backtrack": {"structure": "kdtree", "traversal": "backtrack"},
    "graph": {"structure": "graph"},
}

PASSES = ("grid", "kd-restart", "kd-backtrack")


@pytest.fixture(scope="module")
def bunny(scenes_folder):
    """The scene, its rays, what the CPU answers, and how far the graphics device may be off."""
    skip_without_adapter()
    scene = rs.load(scenes_folder / "bunny" / "bun_zipper.ply")
    origins, directions = scene.camera_for(1.0).rays(SIZE, SIZE)
    rays = {"origins": origins.reshape(-1, 3), "directions": directions.reshape(-1, 3)}
    tracer = rs.Tracer(scene)
    expected = answers_of(tracer.first_hit(**rays))
    every = tracer.multi_hit(**rays)
    for column in ("ray_splits", "prim_id", "t"):
        expected[f"multi_hit, triangles, None: {column}"] = getattr(every, column)
    return SimpleNamespace(
        scene=scene, rays=rays, expected=expected, tolerance=Tolerance(scene, rays)
    )


def answers_of(hits):
    return {f"first_hit: {column}": getattr(hits, column) for column in ("t", "u", "v", "prim_id")}


def assert_as_on_the_cpu(hits, bunny):
    answers = answers_of(hits)
    assert (answers["first_hit: prim_id"] >= 0).mean() > 0.2
    assert_close(answers, bunny.expected, bunny.tolerance)


@pytest.mark.parametrize("machine", ["compute", "branching"])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_hits_are_the_cpu_s(bunny, structure, machine):
    tracer = rs.Tracer(bunny.scene, device="graphics", machine=machine, **STRUCTURES[structure])
    assert_as_on_the_cpu(tracer.first_hit(**bunny.rays), bunny)


@pytest.mark.parametrize("structure", PASSES)
def test_passes_are_the_cpu_s(bunny, structure):
    ours, theirs = (
        rs.Tracer(
            bunny.scene,
            device=device,
            machine="multipass",
            counters=True,
            **STRUCTURES[structure],
        )
        for device in ("graphics", "cpu")
    )
    assert_as_on_the_cpu(ours.first_hit(**bunny.rays), bunny)
    theirs.first_hit(**bunny.rays)
    passes, others = ours.counters.passes, theirs.counters.passes
    assert len(passes) == pytest.approx(len(others), rel=1e-3)
    active, expected = (sum(one.run_count for one in every) for every in (passes, others))
    assert active == pytest.approx(expected, rel=1e-3)
    assert np.mean([one.run_count for one in passes]) > 100
