"""The pass kernel: all steps of a structure's traversal, one of which runs per launch.

The number of that step is in device memory: all threads take the same branch, and the host need not
know it. So a pass is one launch, not one for each kernel that might be next.
"""

from __future__ import annotations

import inspect
from functools import cache
from typing import Any

import numpy as np

from raystream.cuda.multipass.kernels.ray_states import chosen_kernel, is_waiting, move, row_of
from raystream.cuda.soa import NAMES, SoaLayout
from raystream.jit.cuda import RangeKernel
from raystream.jit.from_source import device_from_source, kernel_from_source
from raystream.machines.records import FOUND, RAY, WANTED
from raystream.machines.steps.base import StepKernel, Steps

__all__ = ["STREAMS", "columns_of", "pass_of"]

#: Streams with records, in the order of the pass's arguments. The state is one byte per ray.
STREAMS = ("ray", "wanted", "found", "place")


def columns_of(steps: Steps) -> dict[str, SoaLayout]:
    """The memory layout of the streams."""
    types = RAY, WANTED, FOUND, steps.place
    return {name: SoaLayout.of(dtype) for name, dtype in zip(STREAMS, types, strict=True)}


def pass_of(steps: Steps) -> RangeKernel:
    """The pass kernel of a traversal.

    Returns
    -------
    RangeKernel
        For ``(control, rows, capacity, *addresses of STREAMS, state, tree, query)``: the ray of
        thread i is element i of the uint32 numbers at `rows`, or ray i if that address is 0.
    """
    return _pass_of(steps.kernels, steps.place)


@cache
def _pass_of(kernels: tuple[StepKernel, ...], place: np.dtype[Any]) -> RangeKernel:
    columns = columns_of(Steps(kernels, place, None))
    names = {
        **NAMES,
        "row_of": row_of,
        "chosen_kernel": chosen_kernel,
        "is_waiting": is_waiting,
        "move": move,
    }
    for number, one in enumerate(kernels):
        names[f"step_{number}"] = _step(number, one, columns)
    return RangeKernel(kernel_from_source(_text(len(kernels)), names, __name__))


def _text(kernel_count: int) -> str:
    arguments = f"capacity, {', '.join(STREAMS)}, tree, query"
    lines = [
        f"def run_pass(i, control, rows, {arguments.replace('tree', 'state, tree')}):",
        "    chosen = chosen_kernel(control)",
        f"    if chosen >= uint32({kernel_count}):",
        "        return",
        "    row = row_of(rows, i)",
        "    now = load(uint8, state + row)",
        "    if not is_waiting(control, chosen, now):",
        "        return",
        "    then = now",
    ]
    for number in range(kernel_count):
        lines += [
            f"    {'elif' if number else 'if'} chosen == uint32({number}):",
            f"        then = step_{number}(row, {arguments})",
        ]
    lines += ["    store(state + row, then)", "    move(control, now, then)"]
    return "\n".join(lines) + "\n"


def _step(number: int, one: StepKernel, columns: dict[str, SoaLayout]) -> Any:
    """A step on the ray in a row: reads and writes its records, and returns its state."""
    parts = []
    for name in inspect.signature(one.function).parameters:
        value = f"unsigned({number})" if name == "kernel" else name
        if name in columns:
            value = columns[name].load(name, "capacity", "row", f"Record_{name}")
        parts.append(f"{name}={value}")
    lines = [
        f"def step(row, capacity, {', '.join(STREAMS)}, tree, query):",
        f"    result = function({', '.join(parts)})",
    ]
    for k, name in enumerate(one.outputs):
        lines += [
            f"    {line}" for line in columns[name].store(name, "capacity", "row", f"result[{k}]")
        ]
    lines.append(f"    return uint8({f'result[{len(one.outputs)}]' if one.outputs else 'result'})")
    records = {f"Record_{name}": columns[name].layout.record for name in columns}
    names = {**NAMES, **records, "function": one.function}
    return device_from_source("\n".join(lines) + "\n", names, __name__)
