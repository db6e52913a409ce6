"""A device to test with: a GPU or Numba's simulator; where neither is, tests skip."""

from __future__ import annotations

import pytest

from conftest import skip_without_cuda
from raystream.jit.cuda import Gpu, open_gpu


@pytest.fixture
def gpu() -> Gpu:
    """The device that tracers use."""
    skip_without_cuda()
    return open_gpu()
