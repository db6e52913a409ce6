"""The decorators that compile kernels and device functions for the CPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from llvmlite.binding import get_host_cpu_features
from numba.core import config

from raystream.jit.cache import keep_on_disk
from raystream.jit.compilers import DeviceCompiler, KernelCompiler, UserCompiler

Function = TypeVar("Function", bound=Callable[..., Any])

# error_model: slab tests divide by numbers that may be tiny, and Python's check for zero
# costs a branch in each division. fastmath=False is said although it is the default: it is
# then part of the function and not taken from its caller. boundscheck=False likewise, so
# that NUMBA_BOUNDSCHECK cannot half-apply.
FLAGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": False,
    "boundscheck": False,
}

if config.ENABLE_CUDASIM and config.CPU_FEATURES is None:
    # In CUDA's simulator, functions of one lane run on the CPU. With AVX-512, LLVM 22 aborts the
    # process where one of them is called with a mask of one lane ("Cannot emit physreg copy
    # instruction"); the simulator does without.
    _features = get_host_cpu_features()
    for _name in _features:
        if _name.startswith(("avx512", "avx10")):
            _features[_name] = False
    config.CPU_FEATURES = _features.flatten()

# Only kernels are called from Python or C: what would call the others is not compiled.
_DEVICE: dict[str, Any] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def compiled(function: Function) -> Function:
    """Compile a function that Python calls, in this process only.

    It runs without the interpreter lock, so that threads run it in parallel.
    """
    return numba.njit(pipeline_class=KernelCompiler, **FLAGS)(function)


def kernel(function: Function) -> Function:
    """Compile a function as `compiled` does, when it is first called, and cache it on disk."""
    dispatcher: Any = compiled(function)
    keep_on_disk(dispatcher)
    return dispatcher


def device(function: Function) -> Function:
    """Compile a function that kernels call; it is inlined into each of them.

    It has no closures, comprehensions or expressions of arrays: see `compilers`.
    """
    return numba.njit(forceinline=True, pipeline_class=DeviceCompiler, **_DEVICE, **FLAGS)(function)


def user_device(function: Function) -> Function:
    """Compile a user's function as `device` does, with all that Numba supports."""
    return numba.njit(forceinline=True, pipeline_class=UserCompiler, **_DEVICE, **FLAGS)(function)


def device_call(function: Function) -> Function:
    """Compile a function that kernels call without inlining it: for rare, long branches."""
    # Said, because a function that does not say takes the flag of the one that calls it.
    return numba.njit(forceinline=False, pipeline_class=DeviceCompiler, **_DEVICE, **FLAGS)(
        function
    )
