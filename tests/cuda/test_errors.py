"""Failures of CUDA are one clear error, and tracers on the CPU keep working in the process."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import reason_against_cuda
from fake_driver import Driver, install
from raystream.core.errors import RaystreamError
from raystream.cuda.structures import kernels_of
from raystream.jit.cuda import (
    Compiled,
    CudaError,
    RangeKernel,
    device_array,
    devices,
    driver_version,
    gpu,
    gpu_facts,
    open_gpu,
    range_kernel,
    streams,
)
from raystream.jit.cuda.driver_errors import explain

SCENE = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
RAY = [[0.25, 0.25, 1.0]], [0.0, 0.0, -1.0]


@pytest.fixture
def driver(monkeypatch):
    """A replacement of CUDA and cuda.core whose kernels do nothing."""
    made = Driver()
    install(monkeypatch, made)
    for module in (device_array, devices, gpu, range_kernel, streams):
        monkeypatch.setattr(module, "is_simulated", lambda: False)
    monkeypatch.setattr(range_kernel, "cuda", made)
    monkeypatch.setattr(RangeKernel, "compiled", lambda *_: Compiled("first_hit", ""))
    for one in kernels_of("brute"):
        monkeypatch.setattr(one, "_loaded", {})
    yield made
    devices._opened.cache_clear()


def complaint(**options):
    """The one-line error of a first-hit query on CUDA; the CPU answers afterwards."""
    with pytest.raises(RaystreamError) as caught:
        rs.Tracer(SCENE, "brute", "cuda", **options).first_hit(*RAY)
    assert rs.Tracer(SCENE, "brute").first_hit(*RAY).prim_id.tolist() == [0]
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_nothing_fails(driver):
    """The fake driver works as a whole, so failures below are the ones requested."""
    assert np.isfinite(rs.Tracer(SCENE, "brute", "cuda").first_hit(*RAY).t)


def test_no_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "raystream.jit.cuda", None)
    assert complaint() == (
        "device 'cuda': needs numba-cuda; pip install 'raystream[cuda]', or use device='cpu' or "
        "'graphics'"
    )


def test_no_driver_here():
    """Numba's own message on a machine without a driver."""
    if not (reason := reason_against_cuda()):
        pytest.skip("there is a device")
    assert complaint() == reason.removesuffix(" (NUMBA_ENABLE_CUDASIM=1 simulates one)")
    assert reason.startswith("device 'cuda': there is no NVIDIA ")


#: Call at which the driver fails, its message, and the expected error.
FAILURES = {
    "no driver": (
        "init",
        "Error at driver init:\nCUDA driver library cannot be found.\nEnsure that",
        "device 'cuda': there is no NVIDIA driver; use device='cpu' or 'graphics'",
    ),
    "no GPU": (
        "init",
        "Error at driver init: Call to cuInit results in CUDA_ERROR_NO_DEVICE (100)",
        "device 'cuda': there is no NVIDIA GPU that this process may use",
    ),
    "a driver without a function": (
        "open",
        'Function "cuKernelGetName" not found',
        "device 'cuda': Fake 0: opening it: the driver is too old; install a newer one",
    ),
    "an old driver": (
        "load",
        "CUDA_ERROR_UNSUPPORTED_PTX_VERSION: This indicates that the PTX was compiled with",
        "loading first_hit: the driver is older than the compiler that made the kernel; install",
    ),
    "no memory": (
        "allocate",
        "Call to cuMemAlloc results in CUDA_ERROR_OUT_OF_MEMORY",
        "device 'cuda': Fake 0 has no memory for brute, ",
    ),
    "no memory for stacks": (
        "launch",
        "CUDA_ERROR_OUT_OF_MEMORY: The API call failed because it was unable to allocate",
        "launching a kernel: there is no memory for it; trace a smaller scene, or fewer rays",
    ),
    "a kernel that takes too long": (
        "sync",
        "CUDA_ERROR_LAUNCH_TIMEOUT: This indicates that the device kernel took too long",
        "running a kernel: it ran longer than allowed on a GPU that also drives a display",
    ),
    "a kernel that reads what is not there": (
        "copy",
        "Call to cuMemcpyAsync results in CUDA_ERROR_ILLEGAL_ADDRESS",
        "copying: it accessed an invalid address, and was stopped. CUDA can no longer be used",
    ),
    "anything else": ("sync", "Something\n  new:", "device 'cuda': Fake 0: running a kernel: "),
}


@pytest.mark.parametrize("name", FAILURES)
def test_what_the_driver_says(driver, name):
    step, message, expected = FAILURES[name]
    driver.failing[step] = message
    assert expected in complaint()
    # A new tracer works as soon as the driver does.
    driver.failing.clear()
    rs.Tracer(SCENE, "brute", "cuda").first_hit(*RAY)


def test_no_device(driver):
    driver.count = 0
    assert "there is no NVIDIA GPU" in complaint()


def test_another_device(driver):
    assert complaint(gpu=2) == "gpu: expected a number from 0 to 1, got 2"
    rs.Tracer(SCENE, "brute", "cuda", gpu=1).first_hit(*RAY)
    with pytest.raises(TypeError, match="gpu: expected the number of a device, got 'first'"):
        rs.Tracer(SCENE, "brute", "cuda", gpu="first")


def test_an_old_gpu(driver):
    driver.capability = (6, 1)
    assert "Fake 0 has compute capability 6.1; kernels need 7.5 or more" in complaint()


@pytest.mark.parametrize(
    ("capability", "target"),
    [((7, 5), (7, 5)), ((8, 6), (8, 0)), ((8, 9), (8, 0)), ((9, 0), (9, 0)), ((12, 0), (9, 0))],
)
def test_kernels_are_compiled_for_what_was_tested(driver, capability, target):
    driver.capability = capability
    opened = open_gpu(0)
    assert (opened.capability, opened.target) == (capability, target)


def test_scenes_larger_than_the_device(driver, monkeypatch):
    asked = []
    monkeypatch.setattr(driver, "device_array", lambda length, _: asked.append(length))
    with pytest.raises(CudaError, match="has no memory for rays, 40,000,000,000 bytes; trace a"):
        open_gpu().empty("rays", (10**10,), np.float32)
    assert asked == []


def test_the_host_s_memory_is_not_the_device_s(driver, monkeypatch):
    def copy(*_):
        raise MemoryError

    tracer = rs.Tracer(SCENE, "brute", "cuda")
    monkeypatch.setattr(driver, "cuMemcpyAsync", copy)
    with pytest.raises(MemoryError):
        tracer.first_hit(*RAY)


def test_ctrl_c(driver, monkeypatch):
    """Between two parts, or while one is waited for."""
    tracer = rs.Tracer(SCENE, "brute", "cuda", rays_at_once=1)
    rays = np.repeat(RAY[0], 3, axis=0), RAY[1]
    done = []

    def stop(*rays_done):
        done.append(rays_done)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tracer.first_hit(*rays, progress=stop)
    assert done == [(1, 3)]
    with monkeypatch.context() as patched:
        patched.setattr(driver, "sync", stop)
        with pytest.raises(KeyboardInterrupt):
            tracer.first_hit(*rays)
    assert len(tracer.first_hit(*rays).t) == 3


def test_queries_in_other_threads_make_streams_of_their_own(driver):
    """A device has to be set current in each thread before it makes a stream."""
    tracer = rs.Tracer(SCENE, "brute", "cuda")
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(tracer.first_hit, *RAY).result().t.shape == (1,)


def test_devices_are_listed_with_what_keeps_them_from_use(driver):
    assert [tuple(one) for one in gpu_facts()] == [
        (0, "Fake 0", (9, 0), 10**9, None),
        (1, "Fake 1", (9, 0), 10**9, None),
    ]
    devices._opened.cache_clear()
    driver.capability = (5, 2)
    assert "kernels need 7.5" in gpu_facts()[0].error
    driver.failing["open"] = "CUDA_ERROR_OUT_OF_MEMORY"
    (first, _) = gpu_facts()
    assert (first.name, first.capability) == ("GPU 0", None)
    assert "no memory" in first.error
    driver.failing["init"] = "CUDA_ERROR_NO_DEVICE"
    with pytest.raises(CudaError, match="no NVIDIA GPU that this process may use"):
        driver_version()


def test_errors_without_words_and_with_too_many():
    assert explain(OSError()) == "OSError"
    assert len(explain(OSError("word\n" * 1000))) < 400
