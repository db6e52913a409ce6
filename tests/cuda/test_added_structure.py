"""A structure from outside the package on CUDA, with the CPU's traversal unchanged."""

from __future__ import annotations

from extras import need

need("numba_cuda")

import numpy as np

import raystream as rs
from conftest import assert_same_bits
from raystream.structures import STRUCTURES
from slabs import Slabs
from test_agreement import case_of, rays_of


def test_its_traversal_runs_there(device, monkeypatch):
    monkeypatch.setitem(STRUCTURES, "slabs", Slabs)
    case = case_of("one_triangle")
    rays = rays_of(case)
    here = rs.Tracer(case.scene, Slabs(slab_count=3))
    there = rs.Tracer(case.scene, Slabs(slab_count=3), rs.Cuda())
    assert_same_bits(there.first_hit(**rays).t, here.first_hit(**rays).t)
    assert_same_bits(there.multi_hit(**rays).prim_id, here.multi_hit(**rays).prim_id)
    assert np.array_equal(there.any_hit(**rays), here.any_hit(**rays))
