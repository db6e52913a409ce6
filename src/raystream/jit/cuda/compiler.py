"""Compiling for CUDA: from Python to PTX, without a device, and the same bits as on the CPU.

Numba's own way to a CUDA kernel lets the compiler fuse a product and a sum into one operation that
rounds once. Then an edge is on another side than on the CPU, and meshes leak. Here it may not.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, NamedTuple

import numba_cuda
from numba import types

from raystream.jit.cuda.disk import kept, path_of
from raystream.jit.cuda.exact import check_calls, check_raises, with_extremes
from raystream.jit.cuda.types import register_types

__all__ = ["CAPABILITIES", "Capability", "Compiled", "compile_function"]

#: Major and minor compute capability of a GPU.
Capability = tuple[int, int]

#: Those that kernels are checked for: Turing, Ampere, Hopper.
CAPABILITIES: tuple[Capability, ...] = ((7, 5), (8, 0), (9, 0))

#: What PTX calls a kernel.
_ENTRY = re.compile(r"^\.visible \.entry (\S+)\(", re.MULTILINE)

#: One function is compiled at a time: Numba is told the target by a global name.
_turn = threading.Lock()


class Compiled(NamedTuple):
    """A kernel in PTX.

    Attributes
    ----------
    entry : str
        What PTX calls it.
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
    """Compile a Python function as a kernel, or take it from the disk.

    Parameters
    ----------
    function : callable
        It returns nothing. What it calls may be compiled for the CPU: the same source is compiled
        anew.
    arguments : sequence
        Numba's types of its arguments.
    capability : (int, int)
        Of the oldest GPUs that are to run it.
    is_checked : bool
        Whether it is somebody else's, and may do only what has the CPU's bits; see `exact`.

    Raises
    ------
    numba.core.errors.NumbaError
        If it does not compile.
    UnfitError
        If it is checked, and has other bits than on the CPU, or may raise something.
    """
    make = _checked_ptx_of if is_checked else _ptx_of
    how = f"{numba_cuda.__version__}{', checked' if is_checked else ''}"
    path = path_of(function, arguments, capability, how)
    ptx = kept(path, lambda: make(function, tuple(arguments), capability))
    (entry,) = _ENTRY.findall(ptx)
    return Compiled(entry, ptx)


def _ptx_of(function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any) -> str:
    with _turn, _target(capability):
        return _text_of(_lowered(function, arguments, capability, notes_errors=False), capability)


def _checked_ptx_of(
    function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any
) -> str:
    with _turn, _target(capability):
        code = _lowered(function, arguments, capability, notes_errors=True)
        # The modules of what it calls are others', too: what changes is this kernel's copy.
        code._llvm_strs = [with_extremes(text) for text in code.llvm_strs]
        check_calls(code.llvm_strs)
        ptx = _text_of(code, capability)
    check_raises(ptx)
    return ptx


def _lowered(
    function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any, notes_errors: bool
) -> Any:
    """LLVM code of a kernel; with the note of an error, which goes where none is possible."""
    from numba.cuda import compiler

    register_types()
    made = compiler.compile_cuda(
        function, types.void, arguments, nvvm_options={"opt": 3, "fma": 0}, cc=capability
    )
    name, code = made.fndesc.llvm_func_name, made.library
    code._entry_name = name
    compiler.kernel_fixup(code.get_function(name), notes_errors)
    return code


def _text_of(code: Any, capability: Any) -> str:
    *_, ptx = code.get_asm_strs(cc=capability)
    return ptx.decode() if isinstance(ptx, bytes) else str(ptx)


@contextmanager
def _target(capability: Capability) -> Iterator[None]:
    """Let Numba compile for GPUs of a kind, whether one is here or not.

    It asks for the current device when it compiles a function that another one calls.
    """
    from numba.cuda import dispatcher

    asked = dispatcher.get_current_device
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=capability)
    try:
        yield
    finally:
        dispatcher.get_current_device = asked
