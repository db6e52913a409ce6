"""Kernels: a function of one record, run over all records of streams."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from raystream.core.errors import LoopLimitError
from raystream.jit.loops import Loop
from raystream.jit.threads import Progress, parallel_for
from raystream.streams.chains import LOOP_LIMIT, Count, check_limit
from raystream.streams.condition import Condition, as_condition
from raystream.streams.constants import as_constant, changed_constant
from raystream.streams.counters import Counters, Pass
from raystream.streams.gather import GatherArray
from raystream.streams.source import KernelSource, Output, compile_kernel
from raystream.streams.stream import Stream

__all__ = ["CHUNK", "INDEX", "Kernel"]

#: Records that a thread takes at a time.
CHUNK = 1 << 14


class _Index:
    def __repr__(self) -> str:
        return "INDEX"


#: As an input: the position of the record, an int64.
INDEX = _Index()


class Kernel:
    """A function of one record, with the streams that it reads and writes.

    Parameters
    ----------
    function : callable
        Takes the records of its inputs, gather arrays and constants as arguments of these
        names. Returns the output's record, or a tuple with one for each of several outputs;
        or None, to reject: the record of every output then stays as it was.
        Numba compiles it: it may use numbers, tuples, NumPy's functions of numbers, and other
        functions compiled by `device`. Its variables from outside are frozen when it is compiled.
    inputs : mapping of str to Stream, optional
        Or `INDEX`, for the position of the record.
    outputs : Stream or sequence of Stream
        A stream may be both input and output.
    gathers : mapping of str to GatherArray, optional
        A Stream or an array is made one.
    constants : mapping of str to number, optional
        Or to tuples of numbers. `set_constants` changes them.
    where : Condition, optional
        Run only on records for which it holds, such as ``state == 2``. Also a stream or an
        array of booleans.
    name : str, optional
        For errors and counters; by default the function's.

    Raises
    ------
    TypeError
        If the function's parameters are not those declared, or something is not what it
        should be. When a kernel first runs: if its function cannot be compiled.
    ValueError
        If the streams differ in length, or an output is given twice.

    Notes
    -----
    Records run in any order and on several threads. A function sees its own record, and
    through gather arrays the records as they were before: the result is the same for every
    number of threads.

    Python's numbers are float64 and int64 inside, as constants and in the function's text:
    write ``np.float32(0.5)`` to stay in float32. A float is not stored in a stream of
    integers; any integer is, without a check of its range.

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
        self._inputs = dict(inputs or {})
        is_single = isinstance(outputs, Stream)
        self._outputs: list[Stream] = [outputs] if isinstance(outputs, Stream) else list(outputs)
        self._gathers = {
            key: value if isinstance(value, GatherArray) else GatherArray(value)
            for key, value in (gathers or {}).items()
        }
        self._constants = {
            key: as_constant(f"{self.name}, constant {key!r}", value)
            for key, value in (constants or {}).items()
        }
        self._check()
        self.record_count = len(self._outputs[0])
        self.where: Condition | None = as_condition(where, self.record_count)
        gathered = {id(gather.stream) for gather in self._gathers.values()}
        self._source = KernelSource(
            tuple(
                (key, stream.layout if isinstance(stream, Stream) else None)
                for key, stream in self._inputs.items()
            ),
            tuple((key, gather.layout, len(gather.shape)) for key, gather in self._gathers.items()),
            tuple(self._constants),
            tuple(Output(stream.layout, id(stream) in gathered) for stream in self._outputs),
            is_single,
        )
        self._loops: dict[tuple[str | None, bool], Loop] = {}

    @property
    def constants(self) -> Mapping[str, Any]:
        """The constants as they are now."""
        return MappingProxyType(self._constants)

    def set_constants(self, **values: Any) -> None:
        """Change constants; nothing is compiled again.

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
            if key not in self._constants:
                raise TypeError(f"{self.name}: has no constant {key!r}")
            label = f"{self.name}, constant {key!r}"
            self._constants[key] = changed_constant(label, self._constants[key], value)

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
            Gets the pass. Another variant of the loop is compiled for it, which also checks
            the indices of gather arrays.
        progress : callable, optional
            Called with how many records are done and how many there are.

        Returns
        -------
        int
            The number of records written.

        Raises
        ------
        IndexError
            If an index is out of range, in a counted pass.
        KeyboardInterrupt
            On Ctrl-C. Streams that the kernel gathers from are then as they were; others
            have some of the new records.
        """
        condition = self.where if where is None else as_condition(where, self.record_count)
        loop = self._loop(condition, counters is not None)
        arguments = self._arguments(condition)
        written: list[int] = []
        counted: list[Any] = []

        def run(begin: int, end: int) -> None:
            written.append(loop(begin, end, *arguments))

        def run_counted(begin: int, end: int) -> None:
            counts = np.zeros(1 + len(self._gathers), np.int64)
            written.append(loop(begin, end, *arguments, counts))
            counted.append(counts)

        body = run if counters is None else run_counted
        parallel_for(body, self.record_count, CHUNK, progress)
        for stream, output in zip(self._outputs, self._source.outputs, strict=True):
            if output.is_double and self.record_count:
                stream._swap()
        total = sum(written)
        if counters is not None:
            counts = [int(count) for count in sum(counted, np.zeros(1 + len(self._gathers), int))]
            counters.passes.append(self._pass(condition, total, counts[0], counts[1:]))
        return total

    def loop(
        self,
        *,
        where: Any = None,
        limit: int = LOOP_LIMIT,
        counters: Counters | None = None,
        progress: Progress | None = None,
    ) -> int:
        """Execute until no record is written.

        Parameters
        ----------
        where, counters : optional
            As for `execute`. A condition is looked at anew in each call.
        limit : int
            Most calls.
        progress : callable, optional
            Called after each call with how many records it did not write, and how many there
            are.

        Returns
        -------
        int
            The number of calls, with the last, which wrote none.

        Raises
        ------
        LoopLimitError
            If the last call of those allowed still wrote records.
        """
        written = 0
        for call in range(1, check_limit(self.name, limit) + 1):
            written = self.execute(where=where, counters=counters)
            if progress:
                progress(self.record_count - written, self.record_count)
            if not written:
                return call
        raise LoopLimitError(self.name, limit, written)

    def run(self, counters: Counters | None = None) -> Count:
        """Execute once, as a step of a chain."""
        return Count(1, 1, self.execute(counters=counters))

    def __repr__(self) -> str:
        return f"<Kernel {self.name!r}: {self.record_count:,} records>"

    def _check(self) -> None:
        """Check the declarations against each other and the function."""
        for key, stream in self._inputs.items():
            if stream is not INDEX and not isinstance(stream, Stream):
                raise TypeError(
                    f"{self.name}, input {key!r}: expected a Stream, got {type(stream).__name__}"
                )
        if not self._outputs:
            raise ValueError(f"{self.name}: a kernel writes at least one stream")
        for stream in self._outputs:
            if not isinstance(stream, Stream):
                raise TypeError(
                    f"{self.name}, outputs: expected streams, got {type(stream).__name__}"
                )
        if len({id(stream) for stream in self._outputs}) < len(self._outputs):
            raise ValueError(f"{self.name}: writes a stream twice")
        streams = [*self._inputs.values(), *self._outputs]
        lengths = {len(stream) for stream in streams if isinstance(stream, Stream)}
        if len(lengths) > 1:
            found = ", ".join(f"{length:,}" for length in sorted(lengths))
            raise ValueError(f"{self.name}: its streams differ in length: {found} records")
        for key, gather in self._gathers.items():
            if any(stream.shares_memory(gather.array) for stream in self._outputs) and (
                gather.stream is None
            ):
                raise ValueError(
                    f"{self.name}, gather array {key!r}: is the array of a stream that the kernel "
                    "writes; give it the stream instead"
                )
        self._check_parameters()

    def _check_parameters(self) -> None:
        declared = [*self._inputs, *self._gathers, *self._constants]
        for key in declared:
            if declared.count(key) > 1:
                raise TypeError(f"{self.name}: {key!r} is declared twice")
        python = getattr(self.function, "py_func", self.function)
        if not inspect.isfunction(python):
            raise TypeError(f"{self.name}: expected a Python function, got {python!r:.60}")
        parameters = inspect.signature(python).parameters
        for key, parameter in parameters.items():
            if parameter.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
                raise TypeError(f"{self.name}: the parameter {parameter} must have a plain name")
            if parameter.default is inspect.Parameter.empty and key not in declared:
                raise TypeError(
                    f"{self.name}: the parameter {key!r} is no input, gather array or constant"
                )
        for key in declared:
            if key not in parameters:
                raise TypeError(f"{self.name}: the function has no parameter {key!r}")

    def _loop(self, condition: Condition | None, is_counted: bool) -> Loop:
        operation = None if condition is None else condition.operation
        loop = self._loops.get((operation, is_counted))
        if loop is None:
            source = replace(self._source, operation=operation, is_counted=is_counted)
            loop = self._loops[operation, is_counted] = compile_kernel(self.function, source)
        return loop

    def _arguments(self, condition: Condition | None) -> list[Any]:
        """The loop's arguments between the range and the counts."""
        arguments = [s.array for s in self._inputs.values() if isinstance(s, Stream)]
        arguments += [gather.array for gather in self._gathers.values()]
        arguments += self._constants.values()
        for stream, output in zip(self._outputs, self._source.outputs, strict=True):
            if output.is_double:
                arguments += [stream._new_records(), stream.array]
            else:
                arguments.append(stream.array)
        if condition is not None:
            arguments += [condition.stream.array, condition.value]
        return arguments

    def _pass(
        self, condition: Condition | None, written: int, run: int, gathered: list[int]
    ) -> Pass:
        """The record of a pass: words follow from the counts."""
        read: dict[str, int] = {}
        wrote: dict[str, int] = {}

        def add(words: dict[str, int], name: str, more: int) -> None:
            words[name] = words.get(name, 0) + more

        for key, stream in self._inputs.items():
            if isinstance(stream, Stream):
                add(read, stream.name or key, run * stream.layout.word_count)
        for (key, gather), count in zip(self._gathers.items(), gathered, strict=True):
            add(read, gather.name or key, count * gather.layout.word_count)
        if condition is not None:
            state = condition.stream
            add(read, self._name_of(state) or "where", self.record_count * state.layout.word_count)
        for k, stream in enumerate(self._outputs):
            name = self._name_of(stream) or f"output {k}"
            add(wrote, name, written * stream.layout.word_count)
        return Pass(self.name, self.record_count, run, written, read, wrote)

    def _name_of(self, stream: Stream) -> str | None:
        """The stream's own name, else that of the parameter which it is an input for."""
        keys = [key for key, one in self._inputs.items() if one is stream]
        return stream.name or (keys[0] if keys else None)
