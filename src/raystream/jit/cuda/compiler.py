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
    function: Callable[..., Any], arguments: Sequence[Any], capability: Capability
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

    Raises
    ------
    numba.core.errors.NumbaError
        If it does not compile.
    """
    path = path_of(function, arguments, capability, numba_cuda.__version__)
    ptx = kept(path, lambda: _ptx_of(function, tuple(arguments), capability))
    (entry,) = _ENTRY.findall(ptx)
    return Compiled(entry, ptx)


def _ptx_of(function: Callable[..., Any], arguments: tuple[Any, ...], capability: Any) -> str:
    from numba.cuda import compiler

    register_types()
    with _turn, _target(capability):
        made = compiler.compile_cuda(
            function, types.void, arguments, nvvm_options={"opt": 3, "fma": 0}, cc=capability
        )
        name, code = made.fndesc.llvm_func_name, made.library
        code._entry_name = name
        compiler.kernel_fixup(code.get_function(name), False)
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
