"""Masks on CUDA: the bits of the scene without what a ray's mask leaves out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from mask_cases import (
    check,
    left_of,
    of_all_kinds,
    of_instances,
    of_meshes,
    some_masks,
    some_rays,
)
from raystream.jit.cuda import Gpu, is_simulated

#: The simulator takes a tenth of a millisecond to begin a thread, and compiles a tree's kernels in
#: a minute.
COUNT = 25 if is_simulated() else 400
SLOW = [pytest.mark.exhaustive] * is_simulated()

CASES = {
    "meshes": (of_meshes, {}),
    "instances": (of_instances, {}),
    "spheres and height fields": (of_all_kinds, {}),
    "float64": (of_meshes, {"precision": "float64"}),
}
WAYS = [
    ("brute", "meshes"),
    ("brute", "instances"),
    *(pytest.param("brute", name, marks=SLOW) for name in [*CASES][2:]),
    *(pytest.param("bvh", name, marks=SLOW) for name in CASES),
    *(pytest.param(one, "meshes", marks=SLOW) for one in ("kdtree", "grid", "graph")),
]


@pytest.mark.parametrize(("structure", "name"), WAYS)
def test_bits_are_those_without_the_parts(gpu: Gpu, structure: str, name: str) -> None:
    make, options = CASES[name]
    case = make()
    tracer = rs.Tracer(case.scene, structure, "cuda", rays_at_once=16, **options)
    left = left_of(case, **options)
    for coherent in (True, False):
        check(tracer, left, some_rays(COUNT, 1, coherent), some_masks(COUNT))
    check(tracer, left, some_rays(COUNT, 2, True), np.uint32(5))


class Lent:
    """An array on the device, as CuPy lends one."""

    def __init__(self, gpu: Gpu, array: Any) -> None:
        self._array = gpu.upload("rays", np.ascontiguousarray(array))
        self.__cuda_array_interface__ = self._array.__cuda_array_interface__


def test_rays_and_masks_on_the_device(gpu: Gpu) -> None:
    case, (origins, directions) = of_meshes(), some_rays(COUNT, 1, True)
    tracer, oracle = (rs.Tracer(case.scene, "brute", one) for one in ("cuda", "cpu"))
    masks = some_masks(COUNT)
    for given, lent in ((masks, masks), (5, 5), (masks, Lent(gpu, masks.astype(np.uint32)))):
        expected = oracle.first_hit(origins, directions, mask=given)
        hits = tracer.first_hit(Lent(gpu, origins), Lent(gpu, directions), mask=lent).host()
        for name in ("t", "u", "v", "prim_id"):
            assert_same_bits(getattr(hits, name), getattr(expected, name))
    rays = Lent(gpu, origins), Lent(gpu, directions)
    counts = tracer.count_hits(*rays, mask=masks).host()
    assert_same_bits(counts, oracle.count_hits(origins, directions, mask=masks))
    with pytest.raises(ValueError, match="mask: shape"):
        tracer.any_hit(*rays, mask=Lent(gpu, np.ones(3, np.uint32)))
    with pytest.raises(TypeError, match="mask: expected integers"):
        tracer.any_hit(*rays, mask=Lent(gpu, np.ones(COUNT, np.float32)))


def _is_low(hit: Any) -> Any:
    return hit.u < 0.5


def test_with_filters_and_counters(gpu: Gpu) -> None:
    case, rays, masks = of_meshes(), some_rays(COUNT, 1, True), some_masks(COUNT)
    tracer, oracle = (rs.Tracer(case.scene, "brute", one) for one in ("cuda", "cpu"))
    for options in ({"on_hit": _is_low}, {"skip_prim_ids": oracle.first_hit(*rays)}):
        for query in ("any_hit", "count_hits"):
            found, expected = (
                getattr(one, query)(*rays, mask=masks, **options) for one in (tracer, oracle)
            )
            assert_same_bits(np.asarray(found), np.asarray(expected))
        many, expected = (one.multi_hit(*rays, mask=masks, **options) for one in (tracer, oracle))
        assert_same_bits(many.prim_id, expected.prim_id)
        assert_same_bits(many.t, expected.t)
