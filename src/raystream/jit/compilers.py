"""Numba's compilers, made cheaper: device functions become machine code in kernels only.

Numba optimises each function and emits machine code for it, also for those that are inlined into
every caller and that Python never calls. That is a quarter of a first image's compile time.
Here a device function ends as LLVM code, which each kernel that calls it links in, optimises as
a part of itself, and emits. The cyclic garbage collector, another tenth, is paused meanwhile.
"""

from __future__ import annotations

import gc
import threading
from types import SimpleNamespace
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.environment import lookup_environment
from numba.core.typed_passes import NativeLowering


class _DeviceLibrary(JITCodeLibrary):
    """LLVM code of a device function and its callees, to be linked into kernels."""

    def _optimize_final_module(self) -> None:
        """Do nothing: the kernel's passes optimise the same code."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return a null pointer: there is no machine code."""
        return 0

    @property
    def codegen(self) -> Any:
        """A stub, for Numba to set the environment of code that is never loaded."""
        return SimpleNamespace(set_env=lambda name, environment: None)


@register_pass(mutates_CFG=False, analysis_only=False)
class _ChooseDeviceLibrary(LoweringPass):
    """Before lowering: compile the function into a `_DeviceLibrary`."""

    _name = "raystream_choose_device_library"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        state.library = _DeviceLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _SetEnvironments(LoweringPass):
    """After lowering: set the environments of the functions linked in, as loading does."""

    _name = "raystream_set_environments"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        for variable in state.library._final_module.global_variables:
            if variable.name.startswith("_ZN08NumbaEnv"):
                environment = lookup_environment(variable.name)
                if environment is not None:
                    state.targetctx.codegen().set_env(variable.name, environment)
        return False


class DeviceCompiler(Compiler):
    """Compiler of functions that only kernels call."""

    def define_pipelines(self) -> list[Any]:
        """Numba's pipelines, compiling into a `_DeviceLibrary`."""
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            _add_before_lowering(pipeline, _ChooseDeviceLibrary)
            pipeline.finalize()
        return pipelines


class KernelCompiler(Compiler):
    """Compiler of functions that Python calls."""

    def define_pipelines(self) -> list[Any]:
        """Numba's pipelines, which also set the environments of device functions."""
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.add_pass_after(_SetEnvironments, NativeLowering)
            pipeline.finalize()
        return pipelines


def _add_before_lowering(pipeline: Any, new_pass: Any) -> None:
    names = [each for each, _ in pipeline.passes]
    pipeline.add_pass_after(new_pass, names[names.index(NativeLowering) - 1])


class _GcPaused:
    """A context that disables the cyclic garbage collector, in all threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._depth = 0
        self._was_enabled = False

    def __enter__(self) -> None:
        with self._lock:
            if self._depth == 0:
                self._was_enabled = gc.isenabled()
                gc.disable()
            self._depth += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._depth -= 1
            if self._depth == 0 and self._was_enabled:
                gc.enable()


gc_paused = _GcPaused()
