"""Kernels on the graphics device: a function of one record in WGSL, run over all records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from raystream.graphics.buffers import Buffer, ReadBack, uniform, whole
from raystream.graphics.error_scope import guarded
from raystream.graphics.errors import GraphicsError
from raystream.graphics.fragment_program import cover_screen
from raystream.graphics.pipelines import Program, bind, fragment_pipeline
from raystream.graphics.streams.compile_errors import check_source
from raystream.graphics.streams.conditions import as_device_condition
from raystream.graphics.streams.declarations import Declarations, declare
from raystream.graphics.streams.program import COUNTER_SLOTS, KernelProgram, make_program, reads_of
from raystream.graphics.streams.stream import Stream
from raystream.graphics.streams.wgsl_types import constant_words, type_of
from raystream.streams import Counters
from raystream.streams.condition import Condition
from raystream.streams.record_kernel import RecordKernel


class Kernel(RecordKernel):
    """A function of one record in WGSL, with the streams that it reads and writes.

    It becomes a fragment program, run by drawing all records (Christen 2005, section 4.2).

    Parameters
    ----------
    source : str
        WGSL with the function and everything that it uses: other functions, structures, constants.
    function : str, optional
        Name of the function [default: the only one]. Its parameters are the names of inputs and
        constants. It returns the output's record, or a structure with a member for each of
        several outputs, in their order. After ``discard;`` the record is rejected: the records of
        all outputs stay as they were.
    inputs : mapping of str to Stream, optional
        A stream may be replaced by `INDEX`, the position of the record: i32 or u32.
    outputs : Stream or sequence of Stream
        A stream may be both input and output.
    gathers : mapping of str to GatherArray, optional
        A Stream or an array is converted. The source calls them by their names.
    constants : mapping of str to number, optional
        Tuples of two to four numbers are also accepted; they get the type of the parameter: f32,
        i32, u32 or a vector. `set_constants` changes them.
    where : Condition, optional
        Run only on records for which it holds, such as ``state == 2``. Also an array of booleans.
    name : str, optional
        Name in errors and counters [default: the function's].

    Raises
    ------
    GraphicsError
        If the source does not compile, with the kernel's name and the line; if streams are on
        different devices.
    TypeError
        If the function's parameters are not those declared, or an argument has a wrong type.
    ValueError
        If the streams differ in length, an output is given twice, or the source declares
        entry points or bindings, or is larger than the compiler can take.

    Notes
    -----
    The function runs on records in any order, and sees the old records through gather arrays.
    Numbers have 32 bits, and a shader's compiler may fuse or reorder float operations: results
    equal the CPU's for integers, and nearly for floats. NaN and infinity are not guaranteed.

    A source is run unchanged, within the limits of ``graphics/streams/wgsl_text.py``. It can read
    its own streams and gather arrays only, but nothing limits its time: an infinite loop blocks
    the device until its driver resets it.

    Examples
    --------
    >>> import numpy as np
    >>> from raystream.graphics.streams import Kernel, Stream
    >>> values = Stream(np.array([0.0, 0.5, 0.9], np.float32))  # doctest: +SKIP
    >>> count_up = '''
    ... fn count_up(value: f32, step: f32) -> f32 {
    ...     if value + step >= 1.0 { discard; }
    ...     return value + step;
    ... }
    ... '''
    >>> kernel = Kernel(  # doctest: +SKIP
    ...     count_up, inputs={"value": values}, outputs=values, constants={"step": 0.25}
    ... )
    >>> kernel.execute()  # doctest: +SKIP
    2
    >>> values.array  # doctest: +SKIP
    array([0.25, 0.75, 0.9 ], dtype=float32)
    """

    def __init__(
        self,
        source: str,
        function: str | None = None,
        *,
        inputs: Mapping[str, Stream | Any] | None = None,
        outputs: Stream | Sequence[Stream],
        gathers: Mapping[str, Any] | None = None,
        constants: Mapping[str, Any] | None = None,
        where: Any = None,
        name: str | None = None,
    ) -> None:
        self._declared: Declarations = declare(
            name, source, function, inputs, outputs, gathers, constants
        )
        self.name: str = self._declared.function.name if name is None else name
        self.record_count = len(self._declared.outputs[0])
        self.where: Condition | None = self._condition(where)
        self._programs: dict[Any, KernelProgram] = {}
        self._uniform: tuple[bytes, Any] = (b"", None)
        self._counters = Buffer(self._declared.opened, f"counters of {self.name}")
        self._read_back = ReadBack(self._declared.opened)
        self._program(self.where, False)  # raises if it does not compile

    @property
    def wgsl(self) -> str:
        """The whole program that is compiled: the source, and the code around it."""
        return self._program(self.where, False).source

    def set_constants(self, **values: Any) -> None:
        """Change constants, without recompilation.

        Parameters
        ----------
        **values
            Each is converted to the type of its parameter.

        Raises
        ------
        TypeError
            If a constant was not declared, or its type cannot hold the value.
        ValueError
            If the value is out of range.
        """
        for key, value in values.items():
            if key not in self._declared.constants:
                raise TypeError(f"{self.name}: has no constant {key!r}")
            constant_words(f"{self.name}, constant {key!r}", self._declared.types[key], value)
        self._declared.constants.update(values)

    def execute(self, *, where: Any = None, counters: Counters | None = None) -> int:
        """Run over all records, or those for which a condition holds.

        Parameters
        ----------
        where : Condition, optional
            Instead of the kernel's own.
        counters : Counters, optional
            The pass is added. Another program is compiled for it, which counts reads of gather
            arrays and checks their indices.

        Returns
        -------
        int
            The number of records written. A kernel that cannot reject any does not wait for the
            device.

        Raises
        ------
        GraphicsError
            If the device fails, or the program for the condition or the counters does not compile.
        IndexError
            If an index is out of range, in a counted pass. The streams are then unchanged, except
            outputs that the kernel does not read.
        """
        condition = self.where if where is None else self._condition(where)
        program = self._program(condition, counters is not None)
        if self.record_count == 0:
            counts = np.zeros(max(program.counter_kinds, 1), np.int64)
        else:
            counts = self._run(program, condition)
        if counters is not None:
            tables = self._declared.gathers
            for key, wrong in zip(tables, counts[2 + len(tables) :], strict=True):
                if wrong:
                    raise IndexError(
                        f"{self.name}, gather array {key!r}: {wrong:,} indices out of range"
                    )
            written, run, *gathered = counts[: 2 + len(tables)].tolist()
            counters.passes.append(self.pass_of(condition, written, run, gathered))
        for stream in self._declared.outputs:
            if _is_in(stream, program.reads) and self.record_count:
                stream.swap()
        return int(counts[0])

    def _condition(self, where: Any) -> Condition | None:
        opened = self._declared.opened
        return as_device_condition(self.name, where, self.record_count, opened)

    def _program(self, condition: Condition | None, is_counted: bool) -> KernelProgram:
        """The program for a condition; compiled once for its operation and kind of stream."""
        declared, key = self._declared, None
        reads = reads_of(declared, condition)
        if condition is not None:
            assert isinstance(condition.stream, Stream)
            key = condition.operation, _place(condition.stream, reads), condition.stream.format
        if (key, is_counted) not in self._programs:
            opened = declared.opened
            most = opened.limits["max-sampled-textures-per-shader-stage"]
            if len(reads) > most:
                raise GraphicsError(
                    f"kernel {self.name}: reads {len(reads)} streams and gather arrays, but "
                    f"{opened.adapter} allows {most}"
                )
            program = make_program(declared, condition, is_counted)
            with guarded(opened):
                check_source(opened, self.name, program.source, declared.text.text.count("\n") + 1)
                for group in range(len(program.groups)):
                    self._pipeline(program, group)
            self._programs[key, is_counted] = program._replace(reads=())
        return self._programs[key, is_counted]._replace(reads=reads)

    def _pipeline(self, program: KernelProgram, group: int) -> Any:
        drawn = Program(program.source, program.entry(group), [program.layout])
        outputs = self._declared.outputs
        targets = [(outputs[k].format, True) for k in program.groups[group]]
        return fragment_pipeline(self._declared.opened, self.name, drawn, targets)

    def _run(self, program: KernelProgram, condition: Condition | None) -> np.ndarray[Any, Any]:
        """Draw all records, and return the sum of each kind of counters."""
        declared, opened = self._declared, self._declared.opened
        with guarded(opened):
            encoder = opened.device.create_command_encoder()
            resources = []
            if program.uniform:
                resources.append(whole(self._constants(program, condition)))
            if program.counter_kinds:
                self._counters.reserve(4 * COUNTER_SLOTS * program.counter_kinds)
                encoder.clear_buffer(self._counters.handle)
                resources.append(self._counters.binding)
            resources += [stream.texture.view for stream in program.reads]
            group = bind(opened, program.layout, resources)
            targets = []
            for stream in declared.outputs:
                is_read = _is_in(stream, program.reads)
                targets.append(stream.target(is_read=is_read))
                if is_read and program.may_reject:
                    stream.texture.copy_to(encoder, targets[-1])
            for number, outputs in enumerate(program.groups):
                attachments = [
                    {"view": targets[k].view, "load_op": "load", "store_op": "store"}
                    for k in outputs
                ]
                drawn = encoder.begin_render_pass(color_attachments=attachments)
                cover_screen(drawn, declared.outputs[0].size)
                drawn.set_pipeline(self._pipeline(program, number))
                drawn.set_bind_group(0, group)
                drawn.draw(3)
                drawn.end()
            if not program.counter_kinds:
                opened.device.queue.submit([encoder.finish()])
                return np.array([self.record_count])
            size = 4 * COUNTER_SLOTS * program.counter_kinds
            memory = self._read_back.read(encoder, [(self._counters, size)])[0]
        words = memory.view(np.uint32).reshape(program.counter_kinds, COUNTER_SLOTS)
        return np.asarray(words.sum(axis=1, dtype=np.int64))

    def _constants(self, program: KernelProgram, condition: Condition | None) -> Any:
        """The uniform buffer with the current constants."""
        words = []
        for key in program.uniform:
            if key:
                wanted, value = self._declared.types[key], self._declared.constants[key]
            else:
                assert condition is not None
                wanted, value = type_of(condition.stream.dtype, 1), condition.value
            words.append(constant_words(f"{self.name}, {key or 'where'}", wanted, value))
        content = b"".join(words)
        if content != self._uniform[0]:
            self._uniform = content, uniform(self._declared.opened, content)
        return self._uniform[1]


def _is_in(stream: Stream, streams: Sequence[Stream]) -> bool:
    """Whether a stream is one of these; comparing streams gives conditions."""
    return any(one is stream for one in streams)


def _place(stream: Stream, streams: Sequence[Stream]) -> int:
    return next(place for place, one in enumerate(streams) if one is stream)
