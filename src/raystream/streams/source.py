"""The loop around a kernel's function, as text: load a record, call, store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.gather_arrays import counted_gather, plain_gather
from raystream.jit.user_loops import Loop, compile_loop
from raystream.jit.user_results import accept
from raystream.streams.layout import Layout


@dataclass(frozen=True)
class KernelSource:
    """All inputs of the text of a loop; equal ones share compiled code.

    The loop is ``loop(begin, end, *streams, *new_streams, *tables, *constants, ...)`` and
    returns the number of records written. The last arguments are the condition's array, unless it
    is one of the streams, its value, and the counts. A stream with several roles is one argument:
    loops over arrays that might overlap are slow.

    Attributes
    ----------
    streams : tuple of Layout
    inputs : tuple of (str, int or None)
        Parameter and stream of each input; None is the record's index.
    outputs : tuple of (int, bool)
        Stream of each output, and whether its new records go to a second array.
    gathers : tuple of (str, Layout, int)
        Name, layout and number of dimensions.
    constant_count : int
    bindings : tuple of (str, str)
        Other parameters of the function, and the loop's expressions for them.
    groups : tuple of (tuple of str, type)
        Fields and class of named tuples in these expressions.
    is_single : bool
        Whether the function returns one record, not a tuple with one for each output.
    operation : str or None
        The comparison of the condition.
    condition : int or None
        Its stream, if it is one of these.
    is_counted : bool
    """

    streams: tuple[Layout, ...]
    inputs: tuple[tuple[str, int | None], ...]
    outputs: tuple[tuple[int, bool], ...]
    gathers: tuple[tuple[str, Layout, int], ...]
    constant_count: int
    bindings: tuple[tuple[str, str], ...]
    groups: tuple[tuple[tuple[str, ...], type], ...]
    is_single: bool
    operation: str | None = None
    condition: int | None = None
    is_counted: bool = False

    def parameters(self) -> list[str]:
        """Names of the loop's parameters."""
        names = ["begin", "end"]
        names += [f"stream_{k}" for k in range(len(self.streams))]
        names += [f"new_{k}" for k, is_double in self.outputs if is_double]
        names += [f"table_{k}" for k in range(len(self.gathers))]
        names += [f"constant_{k}" for k in range(self.constant_count)]
        if self.operation:
            names += ["value"] if self.condition is not None else ["where", "value"]
        return names + (["counts"] if self.is_counted else [])

    def arguments(self) -> list[str]:
        """The arguments of the call of the function."""
        parts = []
        for name, k in self.inputs:
            if k is None:
                loaded = "index(i)"
            else:
                loaded = self.streams[k].load(f"stream_{k}", ["i"], f"Record_{k}")
            parts.append(f"{name}={loaded}")
        return parts + [f"{name}={expression}" for name, expression in self.bindings]

    def stores(self) -> list[str]:
        """The statements that write the result."""
        lines = ["record = accept(result)"]
        for part, (k, is_double) in enumerate(self.outputs):
            value = "record" if self.is_single else f"record[{part}]"
            lines += self.streams[k].store(f"{'new' if is_double else 'stream'}_{k}", "i", value)
        return lines

    def copies(self) -> list[str]:
        """The statements that keep a record that is not written."""
        lines = []
        for k, is_double in self.outputs:
            if is_double:
                lines += self.streams[k].copy(f"new_{k}", f"stream_{k}", "i")
        return lines

    def test(self) -> str:
        """The condition for one record."""
        if self.operation is None:
            return "True"
        array = "where" if self.condition is None else f"stream_{self.condition}"
        return f"{array}[i] {self.operation} value"

    def text(self) -> str:
        """The loop."""
        # The first line distinguishes loops whose layouts do not show in the rest.
        lines = [f"# {self!r}", f"def loop({', '.join(self.parameters())}):"]
        for k in range(len(self.gathers)):
            counted = f", inside_{k}, counts" if self.is_counted else ""
            lines.append(f"    gather_{k} = make_gather_{k}(table_{k}, load_{k}{counted})")
        lines += [
            "    run = written = 0",
            "    for i in range(unsigned(begin), unsigned(end)):",
            f"        if {self.test()}:",
            *(["            run += 1"] if self.is_counted else []),
            f"            result = function({', '.join(self.arguments())})",
            "            if result is not None:",
            *(f"                {line}" for line in self.stores()),
            "                written += 1",
            "                continue",
            *(f"        {line}" for line in self.copies()),
            *(["    counts[0] = run"] if self.is_counted else []),
            "    return written",
        ]
        return "\n".join(lines) + "\n"

    def names(self) -> dict[str, Any]:
        """The globals of the text."""
        shapes = tuple(self.streams[k].shape for k, _ in self.outputs)
        names: dict[str, Any] = {
            "accept": accept(shapes[0] if self.is_single else shapes, "its output"),
            "index": np.int64,
            "unsigned": np.uint64,
        }
        for k, layout in enumerate(self.streams):
            names[f"Record_{k}"] = layout.record
        for k, (_, group) in enumerate(self.groups):
            names[f"Group_{k}"] = group
        for k, (name, layout, dimensions) in enumerate(self.gathers):
            names[f"load_{k}"] = _load_function(layout, dimensions)
            if self.is_counted:
                names[f"inside_{k}"] = _inside_function(dimensions)
                names[f"make_gather_{k}"] = counted_gather(dimensions, k + 1, name)
            else:
                names[f"make_gather_{k}"] = plain_gather(dimensions)
        return names


def compile_kernel(function: Callable[..., Any], source: KernelSource) -> Loop:
    """Compile the loop of a kernel; equal functions and sources share one."""
    return compile_loop(source.text(), function, source.names(), __name__)


def compile_fold(function: Callable[..., Any], layout: Layout) -> Loop:
    """Compile the loop of a reduction.

    It is ``loop(begin, end, block, records, folds)``: it folds the blocks begin to end, of
    `block` records each, into one record of `folds` for each.
    """
    names = _parameter_names(function)
    first = layout.load("folds", ["b"], "Record")
    second = layout.load("records", ["i"], "Record")
    lines = [
        f"# {layout!r}",
        "def loop(begin, end, block, records, folds):",
        "    for b in range(unsigned(begin), unsigned(end)):",
        "        start = b * unsigned(block)",
        "        stop = min(start + unsigned(block), unsigned(len(records)))",
        *(f"        {line}" for line in _copy_first(layout)),
        "        for i in range(start + unsigned(1), stop):",
        f"            result = function({names[0]}={first}, {names[1]}={second})",
        "            record = accept(result)",
        *(f"            {line}" for line in layout.store("folds", "b", "record")),
    ]
    known = {
        "accept": accept(layout.shape, "the stream"),
        "unsigned": np.uint64,
        "Record": layout.record,
    }
    return compile_loop("\n".join(lines) + "\n", function, known, __name__)


def _parameter_names(function: Callable[..., Any]) -> Sequence[str]:
    """Names of the two parameters of a function that folds."""
    python = getattr(function, "py_func", function)
    code = getattr(python, "__code__", None)
    if code is None or code.co_argcount != 2:
        raise TypeError(
            f"{getattr(function, '__name__', function)}: a function that folds takes two records"
        )
    return code.co_varnames[:2]


def _copy_first(layout: Layout) -> list[str]:
    """The statements that copy the first record of a block."""
    if layout.component_count:
        return [f"folds[b, {k}] = records[start, {k}]" for k in range(layout.component_count)]
    return ["folds[b] = records[start]"]


_FUNCTIONS: dict[tuple[Any, ...], Callable[..., Any]] = {}


def _load_function(layout: Layout, dimensions: int) -> Callable[..., Any]:
    """The device function (array, index) that reads a record of a gather array."""
    text = f"return {layout.load('array', _indices(dimensions), 'Record')}"
    return _device_function((layout, dimensions), text, {"Record": layout.record})


def _inside_function(dimensions: int) -> Callable[..., Any]:
    """The device function (array, index) that tests whether an index is in range."""
    parts = [
        f"-array.shape[{k}] <= {index} < array.shape[{k}]"
        for k, index in enumerate(_indices(dimensions))
    ]
    return _device_function((dimensions,), f"return {' and '.join(parts)}", {})


def _indices(dimensions: int) -> list[str]:
    return ["index"] if dimensions == 1 else [f"index[{k}]" for k in range(dimensions)]


def _device_function(key: tuple[Any, ...], body: str, names: dict[str, Any]) -> Callable[..., Any]:
    function = _FUNCTIONS.get(key)
    if function is None:
        namespace = {"__name__": __name__, **names}
        exec(f"def function(array, index):\n    {body}\n", namespace)
        function = _FUNCTIONS[key] = device(namespace["function"])
    return function
