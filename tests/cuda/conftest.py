"""A device to test with: a GPU or Numba's simulator; where neither is, tests skip.

Fixtures import everything that needs numba-cuda: without it, each test module says so and skips.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from conftest import skip_without_cuda
from raystream.jit.user_loops import compile_loop

if TYPE_CHECKING:
    from raystream.jit.cuda import Gpu

_HERE = Path(__file__).parent

#: Fixtures of tests that use a device; all others compile, emulate, or fake one.
DEVICES = {"gpu", "device"}


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that Numba's simulator can run."""
    for item in items:
        if not DEVICES.isdisjoint(getattr(item, "fixturenames", ())) and _HERE in item.path.parents:
            item.add_marker(pytest.mark.cuda_device)


@pytest.fixture
def gpu() -> Gpu:
    """The device that tracers use."""
    skip_without_cuda()
    from raystream.jit.cuda import open_gpu

    return open_gpu()


def _rows(address, count, dtype):
    """An array at an address of the simulated device."""
    room = ctypes.c_char * (count * np.dtype(dtype).itemsize)
    return np.frombuffer(room.from_address(int(address)), dtype)


_LOOP = """
def loop(count, arguments):
    for i in range(count):
        function(i, *arguments)
"""


def _launch(kernel, _gpu, count, arguments, stream=None):
    from raystream.jit.cuda.arguments import with_addresses

    if count:
        loop = compile_loop(_LOOP, kernel.function, {}, __name__)
        loop(np.uint64(count), with_addresses(arguments))


def _scan(_scan, values, count, out, dtype):
    sums = np.cumsum(_rows(values, count, dtype), dtype=dtype)
    to = _rows(out, count + 1, dtype)
    to[0], to[1:] = 0, sums


def _sort(_gpu, keys, values, _bits):
    order = np.argsort(keys.host(), kind="stable")
    keys.fill(keys.host()[order])
    values.fill(values.host()[order])
    return keys, values


@pytest.fixture
def simple_sort(monkeypatch):
    """NumPy's sort and sum, where the device is simulated."""
    from raystream.jit.cuda import is_simulated

    if is_simulated():
        from raystream.cuda.builders import binary_tree, lists
        from raystream.cuda.builders.graph import sectors
        from raystream.jit.cuda.scan import Scan

        monkeypatch.setattr(Scan, "run", _scan)
        monkeypatch.setattr(sectors, "sort_pairs", _sort)
        monkeypatch.setattr(lists, "sort_pairs", _sort)
        monkeypatch.setattr(binary_tree, "sort_pairs", _sort)


@pytest.fixture
def device(simple_sort, monkeypatch):
    """The device; a simulated one runs loops."""
    skip_without_cuda()
    from raystream.jit.cuda import RangeKernel, is_simulated, open_gpu

    if is_simulated():
        monkeypatch.setattr(RangeKernel, "launch", _launch)
    return open_gpu()
