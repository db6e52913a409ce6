"""DeviceLoop: kernels that the device repeats, without the host, until one of them ends the loop.

A CUDA graph with a conditional node, which needs a driver of CUDA 12.4 or later. In the simulator
the host loops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.cuda.compiler import SET_CONDITION
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.range_kernel import RangeKernel
from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.simd.nvvm import is_cuda

__all__ = ["DeviceLoop", "Launch", "set_condition"]


class Launch(NamedTuple):
    """Arguments of `RangeKernel.launch`."""

    kernel: RangeKernel
    length: int
    arguments: tuple[Any, ...]


@intrinsic
def set_condition(typing_context: Any, condition: Any, value: Any) -> Any:
    """Continue (1) or end (0) a loop, a uint32; some kernel must call it in each iteration.

    `condition` is the handle that `DeviceLoop` passes to kernels.
    """
    if condition != types.uint64 or value != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word = ir.IntType(32)
        if is_cuda(builder):
            kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64), word])
            function = cgutils.get_or_insert_function(builder.module, kind, SET_CONDITION)
            builder.call(function, arguments)
        else:
            place = builder.inttoptr(arguments[0], word.as_pointer())
            builder.store(arguments[1], place)
        return context.get_dummy_value()

    return types.void(condition, value), generate


class DeviceLoop:
    """A sequence of kernels, launched repeatedly.

    Parameters
    ----------
    gpu : Gpu
    launches : callable
        Given a condition, a uint64 for `set_condition`, it returns the loop's body, a sequence of
        `Launch`.

    Raises
    ------
    CudaError
        If a kernel does not compile, or the driver does not support conditional nodes.
    """

    def __init__(self, gpu: Gpu, launches: Callable[[np.uint64], Sequence[Launch]]) -> None:
        self._gpu = gpu
        self._graph: Any = None
        self._flag = np.zeros(1, np.uint32)
        if is_simulated():
            at = np.uint64(self._flag.ctypes.data)
            self._runs = [
                one.kernel.prepared(gpu, one.length, one.arguments) for one in launches(at)
            ]
        else:
            self._graph = self._build(launches)

    def begin(self) -> None:
        """Launch the loop asynchronously.

        Raises
        ------
        CudaError
            If it cannot be launched.
        """
        if self._graph is not None:
            self._gpu.launch_graph(self._graph)
            return
        self._flag[0] = 1
        while self._flag[0]:
            for run in self._runs:
                run()

    def _build(self, launches: Callable[[np.uint64], Sequence[Launch]]) -> Any:
        from cuda.core import LaunchConfig
        from cuda.core.graph import GraphDefinition

        with self._gpu.doing(
            "making a graph with a loop (needs a driver for CUDA 12.4; or use loop='batches')"
        ):
            graph = GraphDefinition()
            condition = graph.create_condition(default_value=1)
            latest = graph.while_loop(condition).body
            for one in launches(np.uint64(int(condition.handle))):
                loaded, blocks, size, values = one.kernel.loaded(
                    self._gpu, one.length, one.arguments
                )
                latest = latest.launch(LaunchConfig(grid=blocks, block=size), loaded, *values)
            return graph.instantiate()
