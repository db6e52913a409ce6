"""Numba's compilers, made cheaper: device functions become machine code in kernels only.

Numba optimises each function and emits machine code for it, also for those that are inlined into
every caller and that Python never calls. That is a quarter of a first image's compile time.
Here a device function ends as LLVM code, which each kernel that calls it links in, optimises as
a part of itself, and emits; those of raystream go through fewer passes. The cyclic garbage
collector, another tenth, is paused meanwhile.
"""

from __future__ import annotations

import gc
import threading
from functools import cache
from types import SimpleNamespace
from typing import Any

from llvmlite.binding import Linkage
from numba import types
from numba.core import ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.environment import lookup_environment
from numba.core.lowering import Lower
from numba.core.typed_passes import (
    AnnotateTypes,
    InlineOverloads,
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import (
    DeadBranchPrune,
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    RewriteSemanticConstants,
    TranslateByteCode,
)


class _DeviceLibrary(JITCodeLibrary):
    """LLVM code of a device function, to be linked into kernels with that of its callees."""

    _shared_module: Any

    def _optimize_functions(self, ll_module: Any) -> None:
        """Run the same passes as Numba, but prepare them once and not for each declaration."""
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def finalize(self) -> None:
        """Leave the code as it is: the kernel links, checks and optimises it."""
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """The code with that of all callees, each linked once and not at each level."""
        if self._shared_module is None:
            found: dict[Any, None] = {}
            _find_callees(self, found)
            self._shared_module = self._own_module().clone()
            for library in list(found)[-2::-1]:  # callers before callees, after this one
                is_device = isinstance(library, _DeviceLibrary)
                module = library._own_module() if is_device else library._get_module_for_linking()
                self._shared_module.link_in(module, preserve=True)
        return self._shared_module

    def _own_module(self) -> Any:
        """The code without that of callees, as Numba prepares it for several kernels."""
        self._ensure_finalized()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = "linkonce_odr"
        return self._final_module

    def get_pointer_to_function(self, name: str) -> int:
        """Return a null pointer: there is no machine code."""
        return 0

    @property
    def codegen(self) -> Any:
        """A stub, for Numba to set the environment of code that is never loaded."""
        return SimpleNamespace(set_env=lambda name, environment: None)


def _find_callees(library: Any, found: dict[Any, None]) -> None:
    """Add all libraries that one needs, each before those that need it, and then itself.

    They must be linked in the opposite order: LLVM leaves out a function that nothing calls yet.
    """
    if library not in found:
        for callee in library._linking_libraries if isinstance(library, _DeviceLibrary) else ():
            _find_callees(callee, found)
        found[library] = None


def _is_device(function: Any) -> bool:
    return bool(function.targetoptions.get("no_cfunc_wrapper"))


class _Lower(Lower):
    """Numba's translation to LLVM code, where device functions have no address.

    They are called by type and have no code of their own. Numba writes the address of their Python
    object into the code, which cannot be cached if one remains, as in a record that is passed to
    a function that is not inlined.
    """

    def lower_assign(self, ty: Any, inst: Any) -> Any:
        """Lower an assignment."""
        if isinstance(inst.value, ir.Global | ir.FreeVar):
            return self._constant(ty, inst.value.value)
        return super().lower_assign(ty, inst)

    def _constant(self, type_: Any, value: Any) -> Any:
        if isinstance(type_, types.Dispatcher) and _is_device(type_.dispatcher):
            return self.context.get_constant_null(type_)
        if isinstance(type_, types.BaseTuple):
            members = [self._constant(*each) for each in zip(type_, value, strict=True)]
            return self.context.make_tuple(self.builder, type_, members)
        made = self.context.get_constant_generic(self.builder, type_, value)
        self.incref(type_, made)
        return made


@register_pass(mutates_CFG=True, analysis_only=False)
class _DeviceLowering(NativeLowering):
    """Lowering of a device function, into a `_DeviceLibrary`."""

    _name = "raystream_device_lowering"
    lowering_class = _Lower

    def run_pass(self, state: Any) -> bool:
        state.library = _DeviceLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class _KernelLowering(NativeLowering):
    """Lowering of a kernel, which then sets the environments of functions, as loading does."""

    _name = "raystream_kernel_lowering"
    lowering_class = _Lower

    def run_pass(self, state: Any) -> bool:
        super().run_pass(state)
        for variable in state.library._final_module.global_variables:
            if variable.name.startswith("_ZN08NumbaEnv"):
                environment = lookup_environment(variable.name)
                if environment is not None:
                    state.targetctx.codegen().set_env(variable.name, environment)
        return True


#: Those of Numba's 27 passes that serve functions without closures, comprehensions, ``with``,
#: `literal_unroll`, expressions of arrays, and exceptions with values.
_DEVICE_PASSES = (
    TranslateByteCode,
    FixupArgs,
    IRProcessing,
    RewriteSemanticConstants,
    DeadBranchPrune,
    GenericRewrites,
    ReconstructSSA,
    DeadBranchPrune,
    NopythonTypeInference,
    PreLowerStripPhis,
    InlineOverloads,
    IRLegalization,
    AnnotateTypes,
    _DeviceLowering,
    NoPythonBackend,
)


@cache
def _device_pipeline() -> Any:
    pipeline = PassManager("raystream_device")
    for each in _DEVICE_PASSES:
        pipeline.add_pass(each, each.__name__)
    pipeline.finalize()
    return pipeline


class DeviceCompiler(CompilerBase):
    """Compiler of raystream's functions that only kernels call."""

    def define_pipelines(self) -> list[Any]:
        """Fewer passes than Numba's."""
        return [_device_pipeline()]


class UserCompiler(Compiler):
    """Compiler of users' functions that only kernels call."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes, which end in a `_DeviceLibrary`."""
        return _lowered_by(_DeviceLowering, super().define_pipelines())


class KernelCompiler(Compiler):
    """Compiler of functions that Python calls."""

    def define_pipelines(self) -> list[Any]:
        """Numba's passes."""
        return _lowered_by(_KernelLowering, super().define_pipelines())


def _lowered_by(lowering: Any, pipelines: list[Any]) -> list[Any]:
    for pipeline in pipelines:
        pipeline.passes = [
            (lowering if each is NativeLowering else each, text) for each, text in pipeline.passes
        ]
        pipeline.finalize()
    return pipelines


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
