"""RangeKernel: a function of an index, run on one thread per index of a range."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from types import MappingProxyType, ModuleType
from typing import Any

import numpy as np
from numba import cuda

from raystream.jit.cpu import kernel
from raystream.jit.cuda.arguments import example_of, flat, kind_of, type_of, with_addresses
from raystream.jit.cuda.compiler import Capability, Compiled, compile_function
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.simulation import is_simulated, simulating

#: Threads of a block: four warps.
_BLOCK_SIZE = 128


def _over_range(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that calls a function with the thread's index, if it is below `count`."""

    def run(count: Any, arguments: Any) -> None:
        i = np.uint64(cuda.grid(1))
        if i < count:
            function(i, *arguments)

    run.__name__ = run.__qualname__ = getattr(function, "__name__", "run")
    return run


class RangeKernel:
    """Runs a function for each index of a range.

    Parameters
    ----------
    function : callable
        Compiled by `jit.cpu.kernel` or `device`: ``function(i, *arguments)``, without a result.
        `i` is a uint64; arguments are numbers, addresses, None, and (named) tuples of these.
        Arrays on the device are passed as their addresses, integers as int64.
    types : mapping of str to type
        Those of parameters that are not uint64: NumPy types, named tuples with annotations, or
        tuples of types. See `example`.

    Attributes
    ----------
    function : callable
        For tests that run it on the CPU.

    Notes
    -----
    In the simulator the function runs as compiled for the CPU, with the host's addresses.
    """

    def __init__(
        self, function: Callable[..., Any], types: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self.function, self._types = function, types
        self._run = _over_range(function)
        self._loaded: dict[Any, Any] = {}

    @property
    def name(self) -> str:
        """Name of the function."""
        return self._run.__name__

    def example(self) -> tuple[Any, ...]:
        """Arguments that have the right types only, to compile it without a device."""
        _, *names = inspect.signature(getattr(self.function, "py_func", self.function)).parameters
        return tuple(example_of(self._types.get(name, np.uint64)) for name in names)

    def compiled(self, arguments: tuple[Any, ...], capability: Capability) -> Compiled:
        """PTX for the types of example arguments; needs no device.

        Raises
        ------
        numba.core.errors.NumbaError
            If it does not compile.
        """
        return compile_function(self._run, (type_of(np.uint64(0)), type_of(arguments)), capability)

    def launch(self, gpu: Gpu, count: int, arguments: tuple[Any, ...], stream: Any = None) -> None:
        """Launch it asynchronously.

        Parameters
        ----------
        gpu : Gpu
        count : int
            Length of the range.
        arguments : tuple
            Arguments after `i`.
        stream : cuda.core.Stream, optional
            [default: the device's stream]

        Raises
        ------
        CudaError
            If it does not compile, or cannot be launched.
        """
        if count == 0:
            return
        if is_simulated():
            # Idle threads take as long as others.
            block_size = min(count, _BLOCK_SIZE)
            block_count = -(-count // block_size)
            with simulating:
                run = cuda.jit(self._run)[block_count, block_size]
                run(np.uint64(count), with_addresses(arguments))
            return
        key = gpu.number, kind_of(arguments)
        if key not in self._loaded:
            with gpu.doing(f"compiling {self.name}"):
                compiled = self.compiled(arguments, gpu.target)
            self._loaded[key] = gpu.load(compiled)
        values = [np.uint64(count), *flat(arguments)]
        gpu.launch(self._loaded[key], -(-count // _BLOCK_SIZE), _BLOCK_SIZE, values, stream)


def gpu_kernel(**types: Any) -> Callable[[Callable[..., Any]], RangeKernel]:
    """Make a decorator that compiles a function by `jit.cpu.kernel`, and makes a kernel of it.

    Parameters
    ----------
    **types
        See `RangeKernel`.
    """
    return lambda function: RangeKernel(kernel(function), types)


def kernels_in(*modules: ModuleType) -> dict[str, tuple[RangeKernel, tuple[Any, ...]]]:
    """The kernels among the globals of modules, by name, each with its `example`."""
    held = [one for module in modules for one in vars(module).values()]
    return {one.name: (one, one.example()) for one in held if isinstance(one, RangeKernel)}
