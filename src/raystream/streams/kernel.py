"""Kernels: a function of one record, run over all records of streams."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from raystream.jit.threads import Progress, parallel_for
from raystream.jit.user_loops import Loop
from raystream.streams.condition import Condition
from raystream.streams.constants import changed_constant
from raystream.streams.counters import Counters
from raystream.streams.declarations import INDEX, Declarations, declare
from raystream.streams.record_kernel import RecordKernel
from raystream.streams.source import compile_kernel
from raystream.streams.stream import Stream, as_condition

__all__ = ["CHUNK", "INDEX", "Kernel"]

#: Records per chunk of work of a thread.
CHUNK = 1 << 14


class Kernel(RecordKernel):
    """A function of one record, with the streams that it reads and writes.

    Parameters
    ----------
    function : callable
        Its parameters are the names of inputs (records), gather arrays and constants. Returns the
        output's record, or a tuple with one for each of several outputs; or None, to reject: the
        record of every output then stays as it was. Compiled by Numba: it may use numbers,
        tuples, NumPy's functions of numbers, and other functions compiled by `device`. Variables
        from outside are frozen when it is compiled.
    inputs : mapping of str to Stream, optional
        A stream may be replaced by `INDEX`, the position of the record.
    outputs : Stream or sequence of Stream
        A stream may be both input and output.
    gathers : mapping of str to GatherArray, optional
        A Stream or an array is converted. So are all members of a named tuple, except numbers;
        the function receives a named tuple of that class.
    constants : mapping of str to number, optional
        Tuples of numbers are also accepted. `set_constants` changes them.
    where : Condition, optional
        Run only on records for which it holds, such as ``state == 2``. Also a stream or an
        array of booleans.
    name : str, optional
        Name in errors and counters [default: the function's].

    Raises
    ------
    TypeError
        If the function's parameters are not those declared, or an argument has a wrong type.
        When a kernel first runs: if its function cannot be compiled.
    ValueError
        If the streams differ in length, or an output is given twice.

    Notes
    -----
    The function runs on records in any order and on several threads. A function sees its own
    record, and through gather arrays the old records: the result is the same for any number of
    threads. Do not execute one kernel from two threads at a time.

    Python numbers, as constants and in the function's text, are float64 and int64: write
    ``np.float32(0.5)`` to stay in float32. A stream of integers accepts any integer, without a
    range check, but no float.

    Examples
    --------
    >>> import numpy as np
    >>> values = Stream(np.array([0.0, 0.5, 0.9]))
    >>> def count_up(value, step):
    ...     value += step
    ...     return None if value >= 1.0 else value
    >>> kernel = Kernel(
    ...     count_up, inputs={"value": values}, outputs=values, constants={"step": 0.25}
    ... )
    >>> kernel.execute()
    2
    >>> values.array
    array([0.25, 0.75, 0.9 ])
    >>> kernel.loop()
    3
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        inputs: Mapping[str, Stream | Any] | None = None,
        outputs: Stream | Sequence[Stream],
        gathers: Mapping[str, Any] | None = None,
        constants: Mapping[str, Any] | None = None,
        where: Any = None,
        name: str | None = None,
    ) -> None:
        self.function = function
        self.name: str = getattr(function, "__name__", "kernel") if name is None else name
        self._declared: Declarations = declare(
            self.name, function, inputs, outputs, gathers, constants
        )
        self._source = self._declared.source()
        self.record_count = len(self._declared.outputs[0])
        self.where: Condition | None = as_condition(where, self.record_count)
        self._streams = self._declared.streams()
        self._loops: dict[tuple[str | None, int | None, bool], Loop] = {}

    @property
    def declared(self) -> Declarations:
        """Its streams, gather arrays and constants."""
        return self._declared

    def set_constants(self, **values: Any) -> None:
        """Change constants, without recompilation.

        Parameters
        ----------
        **values
            Each is converted to the type with which the constant was declared.

        Raises
        ------
        TypeError
            If a constant was not declared, or its type cannot hold the value.
        """
        for key, value in values.items():
            if key not in self._declared.constants:
                raise TypeError(f"{self.name}: has no constant {key!r}")
            label = f"{self.name}, constant {key!r}"
            self._declared.constants[key] = changed_constant(
                label, self._declared.constants[key], value
            )

    def execute(
        self,
        *,
        where: Any = None,
        counters: Counters | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Run over all records, or those for which a condition holds.

        Parameters
        ----------
        where : Condition, optional
            Instead of the kernel's own.
        counters : Counters, optional
            The pass is added. With gather arrays, a variant of the loop is compiled for it, which
            counts their reads and checks their indices.
        progress : callable, optional
            Called with (records done, records).

        Returns
        -------
        int
            The number of records written.

        Raises
        ------
        IndexError
            If an index is out of range, in a counted pass.
        KeyboardInterrupt
            On Ctrl-C. Streams that the kernel gathers from are then unchanged; others have some
            of the new records.
        """
        condition = self.where if where is None else as_condition(where, self.record_count)
        is_counted = counters is not None and bool(self._declared.gathers)
        loop = self._loop(condition, is_counted)
        arguments = self._arguments(condition)
        run_count = 0
        if counters is not None and not is_counted:
            run_count = self.record_count if condition is None else condition.count()
        written: list[int] = []
        counted: list[Any] = []

        def run(begin: int, end: int) -> None:
            written.append(loop(begin, end, *arguments))

        def run_counted(begin: int, end: int) -> None:
            counts = np.zeros(1 + len(self._declared.gathers), np.int64)
            written.append(loop(begin, end, *arguments, counts))
            counted.append(counts)

        body = run_counted if is_counted else run
        parallel_for(body, self.record_count, CHUNK, progress)
        for k, is_double in self._source.outputs:
            if is_double and self.record_count:
                self._streams[k].swap()
        total = sum(written)
        if counters is not None:
            first = np.zeros(1 + len(self._declared.gathers), np.int64)
            first[0] = run_count
            run_count, *gathered = sum(counted, first).tolist()
            counters.passes.append(self.pass_of(condition, total, run_count, gathered))
        return total

    def _loop(self, condition: Condition | None = None, is_counted: bool = False) -> Loop:
        operation = None if condition is None else condition.operation
        place = self._place(condition)
        loop = self._loops.get((operation, place, is_counted))
        if loop is None:
            source = replace(
                self._source, operation=operation, condition=place, is_counted=is_counted
            )
            loop = self._loops[operation, place, is_counted] = compile_kernel(self.function, source)
        return loop

    def _place(self, condition: Condition | None) -> int | None:
        """The index of the condition's stream among the kernel's; None if it is another one."""
        if condition is not None:
            for k, stream in enumerate(self._streams):
                if stream is condition.stream:
                    return k
        return None

    def _arguments(self, condition: Condition | None) -> list[Any]:
        """The loop's arguments between the range and the counts."""
        arguments = [stream.array for stream in self._streams]
        arguments += [
            self._streams[k].new_array() for k, is_double in self._source.outputs if is_double
        ]
        arguments += [gather.array for gather in self._declared.gathers.values()]
        arguments += self._declared.constants.values()
        if condition is not None:
            if self._place(condition) is None:
                arguments.append(condition.stream.array)
            arguments.append(condition.value)
        return arguments
