"""Selection of the GPU, and its free memory."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from raystream.jit.cuda import CudaError, Gpu, gpu_count
from test_agreement import case_of


@pytest.fixture(scope="module")
def case():
    return case_of("random_soup")


def test_gpus_are_known_by_their_numbers(gpu, case):
    count = gpu_count()
    assert rs.Tracer(case.scene, "brute", "cuda", gpu=np.int64(count - 1)).device == "cuda"
    for number in (count, -1):
        with pytest.raises(CudaError, match=f"gpu: expected a number from 0 to .*, got {number}"):
            rs.Tracer(case.scene, "brute", "cuda", gpu=number)
    with pytest.raises(TypeError, match="gpu: expected the number"):
        rs.Tracer(case.scene, "brute", "cuda", gpu="first")


def test_a_scene_too_large_is_refused_before_it_is_copied(gpu, case, monkeypatch):
    def upload(self, name, array):
        raise AssertionError("something was copied")

    monkeypatch.setattr(Gpu, "free_byte_count", lambda self: 1000)
    monkeypatch.setattr(Gpu, "upload", upload)
    with pytest.raises(CudaError, match=r"takes [\d,]+ bytes as 'brute', but .* has 1,000 free"):
        rs.Tracer(case.scene, "brute", "cuda")
