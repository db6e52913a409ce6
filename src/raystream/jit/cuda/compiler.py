"""Compiling for CUDA: from Python to PTX, without a device, and with the CPU's bits.

Numba's own compiler contracts a product and a sum into one operation that rounds once. An edge
function may then have another sign than on the CPU, and meshes leak. Here contraction is off.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba_cuda
from numba import types

from raystream.jit.cuda.ptx_cache import cached_text, path_of
from raystream.jit.cuda.user_checks import check_calls, check_raises, with_extremes
from raystream.jit.simd.types import VectorClass, VectorType

#: Major and minor compute capability of a GPU.
Capability = tuple[int, int]

#: Capabilities that kernels are checked for: Turing, Ampere, Hopper.
CAPABILITIES: tuple[Capability, ...] = ((7, 5), (8, 0), (9, 0))

#: A kernel's entry in PTX.
_ENTRY = re.compile(r"^\.visible \.entry (\S+)\(", re.MULTILINE)

#: One function is compiled at a time: Numba finds the target by a global name.
_compiling = threading.Lock()


class Compiled(NamedTuple):
    """A kernel in PTX.

    Attributes
    ----------
    entry : str
        Its name in PTX.
    ptx : str
    """

    entry: str
    ptx: str


def compile_function(
    function: Callable[..., Any],
    arguments: Sequence[Any],
    capability: Capability,
    *,
    is_checked: bool = False,
) -> Compiled:
    """Compile a Python function as a kernel, or read it from the disk cache.

    Parameters
    ----------
    function : callable
        It returns nothing. Functions that it calls may be compiled for the CPU: their source is
        compiled for CUDA.
    arguments : sequence
        Numba types of its arguments.
    capability : (int, int)
        Of the oldest GPUs that are to run it.
    is_checked : bool
        Whether it contains a user's function, which must have the CPU's bits; see `user_checks`.

    Raises
    ------
    numba.core.errors.NumbaError
        If it does not compile.
    CpuOnlyError
        If it is checked, and has other bits than on the CPU, or may raise an exception.
    """
    make = _checked_ptx_of if is_checked else _ptx_of
    version = f"{numba_cuda.__version__}{', checked' if is_checked else ''}"
    path = path_of(function, arguments, capability, version)
    ptx = cached_text(path, lambda: make(function, tuple(arguments), capability))
    (entry,) = _ENTRY.findall(ptx)
    return Compiled(entry, ptx)


def _ptx_of(function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any) -> str:
    with _compiling, _target(capability):
        return _text_of(_lowered(function, arguments, capability, notes_errors=False), capability)


def _checked_ptx_of(
    function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any
) -> str:
    with _compiling, _target(capability):
        code = _lowered(function, arguments, capability, notes_errors=True)
        # Other kernels share the modules of the callees: change this kernel's copy.
        code._llvm_strs = [with_extremes(text) for text in code.llvm_strs]
        check_calls(code.llvm_strs)
        ptx = _text_of(code, capability)
    check_raises(ptx)
    return ptx


def _lowered(
    function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any, notes_errors: bool
) -> Any:
    """LLVM code of a kernel; `notes_errors` adds code that records exceptions, if any."""
    from numba.cuda import compiler

    _register_vectors()
    made = compiler.compile_cuda(
        function, types.void, arguments, nvvm_options={"opt": 3, "fma": 0}, cc=capability
    )
    name, code = made.fndesc.llvm_func_name, made.library
    code._entry_name = name
    compiler.kernel_fixup(code.get_function(name), notes_errors)
    return code


@cache
def _register_vectors() -> None:
    """Register vector types with Numba's CUDA compiler, which has its own table of types."""
    from numba.cuda.typing.typeof import typeof_impl

    @typeof_impl.register(VectorType)
    def type_of(value: VectorType, context: Any) -> VectorClass:
        return VectorClass(value)


def _text_of(code: Any, capability: Any) -> str:
    *_, ptx = code.get_asm_strs(cc=capability)
    return ptx.decode() if isinstance(ptx, bytes) else str(ptx)


@contextmanager
def _target(capability: Capability) -> Iterator[None]:
    """Let Numba compile for a capability, whether or not there is such a device.

    It queries the current device when it compiles a function that another one calls.
    """
    from numba.cuda import dispatcher

    original = dispatcher.get_current_device
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=capability)
    try:
        yield
    finally:
        dispatcher.get_current_device = original
