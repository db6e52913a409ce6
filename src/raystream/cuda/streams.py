"""Stream kernels on a GPU: runs kernels of `raystream.streams` on streams in GPU memory.

A kernel is declared as for the CPU. `StreamMemory` copies its streams and gather arrays to a
device and runs it; outputs stay there until they are read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import LoopLimitError
from raystream.cuda.soa import NAMES, SoaLayout, capacity_of
from raystream.jit.atomics import atomic_add_aggregated
from raystream.jit.cuda import (
    MAX_DIMENSIONS,
    DeviceArray,
    Gpu,
    RangeKernel,
    gather_table_at,
)
from raystream.jit.from_source import device_from_source, kernel_from_source
from raystream.jit.user_loops import as_device
from raystream.jit.user_results import accept
from raystream.streams import Counters, Kernel, Stream
from raystream.streams.chains import LOOP_LIMIT, Count, check_limit
from raystream.streams.condition import Condition, as_condition
from raystream.streams.gather import GatherArray
from raystream.streams.record_stream import RecordStream

__all__ = ["CudaKernel", "StreamMemory"]

_NONE = np.uint64(0)


@dataclass
class _Resident:
    """Records on a device, and a back buffer for kernels that gather what they write."""

    columns: SoaLayout
    count: int
    front: DeviceArray
    back: DeviceArray | None = None

    def second(self, gpu: Gpu) -> DeviceArray:
        if self.back is None:
            self.back = self.columns.empty(gpu, "second array of a stream", self.count)
        return self.back

    def swap(self) -> None:
        assert self.back is not None
        self.front, self.back = self.back, self.front


class StreamMemory:
    """Streams and gather arrays in a GPU's memory, and kernels over them.

    Parameters
    ----------
    gpu : Gpu

    Examples
    --------
    >>> import numpy as np
    >>> from raystream.jit.cuda import open_gpu
    >>> from raystream.streams import Kernel, Stream
    >>> values = Stream(np.array([0.0, 0.5, 0.9]))
    >>> def count_up(value):
    ...     value += 0.25
    ...     return None if value >= 1.0 else value
    >>> kernel = Kernel(count_up, inputs={"value": values}, outputs=values)
    >>> memory = StreamMemory(open_gpu())  # doctest: +SKIP
    >>> memory.kernel(kernel).execute()  # doctest: +SKIP
    2
    >>> memory.read(values).array  # doctest: +SKIP
    array([0.25, 0.75, 0.9 ])
    """

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        # By id; the values keep the objects alive, so that no other has the id.
        self._streams: dict[int, tuple[Stream, _Resident]] = {}
        self._arrays: dict[int, tuple[GatherArray, _Resident]] = {}

    def write(self, stream: Stream) -> None:
        """Copy a stream's current records to the device.

        Raises
        ------
        CudaError
            If there is no memory for them.
        TypeError
            If they have complex numbers.
        """
        columns = SoaLayout(stream.layout)
        front = columns.upload(self.gpu, stream.label, stream.array)
        self._streams[id(stream)] = stream, _Resident(columns, len(stream), front)

    def read(self, stream: Stream) -> Stream:
        """Copy a stream's records from the device, if it has them; returns the stream."""
        if id(stream) in self._streams:
            _, resident = self._streams[id(stream)]
            resident.columns.read(resident.front, stream.array)
        return stream

    def kernel(self, kernel: Kernel) -> CudaKernel:
        """Prepare a kernel for the device; copies streams that are not there yet."""
        return CudaKernel(kernel, self)

    def resident(self, stream: Stream) -> _Resident:
        """A stream's records on the device."""
        if id(stream) not in self._streams:
            self.write(stream)
        return self._streams[id(stream)][1]

    def place(self, stream: RecordStream) -> DeviceArray:
        """A stream's records on the device; a temporary copy if no kernel uses the stream."""
        if id(stream) in self._streams:
            return self._streams[id(stream)][1].front
        return SoaLayout(stream.layout).upload(self.gpu, stream.label, stream.array)

    def table(self, gather: GatherArray) -> _Resident:
        """A gather array's records on the device; an array is copied once."""
        if gather.stream is not None:
            return self.resident(gather.stream)
        if id(gather) not in self._arrays:
            columns, records = SoaLayout(gather.layout), _flat(gather)
            front = columns.upload(self.gpu, gather.name or "gather array", records)
            self._arrays[id(gather)] = gather, _Resident(columns, len(records), front)
        return self._arrays[id(gather)][1]


class CudaKernel:
    """A kernel that runs on a GPU.

    Parameters
    ----------
    kernel : Kernel
    memory : StreamMemory

    Raises
    ------
    CudaError
        If there is no memory for its streams.
    TypeError
        If records are complex, or a gather array has more than three dimensions.

    Notes
    -----
    As on the CPU, the function runs on records in any order, and gather arrays show the records
    from before the pass. Indices of gather arrays are not checked.
    """

    def __init__(self, kernel: Kernel, memory: StreamMemory) -> None:
        self._kernel, self._memory = kernel, memory
        self.name = kernel.name
        declared = kernel.declared
        self._streams = declared.streams()
        for gather in declared.gathers.values():
            if len(gather.shape) > MAX_DIMENSIONS:
                raise TypeError(
                    f"{kernel.name}: device 'cuda' reads gather arrays of up to {MAX_DIMENSIONS} "
                    f"dimensions, not {len(gather.shape)}"
                )
            memory.table(gather)
        for stream in self._streams:
            memory.resident(stream)
        self._made: dict[tuple[str | None, int | None], RangeKernel] = {}
        self._mask: DeviceArray | None = None

    def execute(self, *, where: Any = None, counters: Counters | None = None) -> int:
        """Run over all records, or those that satisfy a condition.

        Parameters
        ----------
        where : Condition, optional
            Replaces the kernel's own.
        counters : Counters, optional
            Records the pass.

        Returns
        -------
        int
            The number of records written.

        Raises
        ------
        TypeError
            If its function cannot be compiled, or counters are given for a kernel with gather
            arrays, whose reads only the CPU counts.
        CudaError
            If the device fails.
        """
        kernel, gpu = self._kernel, self._memory.gpu
        if counters is not None and kernel.declared.gathers:
            raise TypeError(f"{self.name}: device 'cuda' does not count gather reads")
        condition = kernel.where if where is None else as_condition(where, kernel.record_count)
        counts = gpu.upload("counts", np.zeros(2, np.uint32))
        made, arguments = self.prepared(condition)
        made.launch(gpu, kernel.record_count, (counts.address, *arguments))
        run, written = counts.host().tolist()
        for k, is_double in kernel.declared.source().outputs:
            if is_double:
                self._memory.resident(self._streams[k]).swap()
        if counters is not None:
            counters.passes.append(kernel.pass_of(condition, written, run, ()))
        return int(written)

    def loop(self, *, where: Any = None, limit: int = LOOP_LIMIT) -> int:
        """Execute until no record is written; returns the number of passes.

        Raises
        ------
        LoopLimitError
            If the last permitted pass still wrote records.
        """
        written = 0
        for call in range(1, check_limit(self.name, limit) + 1):
            written = self.execute(where=where)
            if not written:
                return call
        raise LoopLimitError(self.name, limit, written)

    def run(self, counters: Counters | None = None) -> Count:
        """Execute once, as a step of a chain."""
        return Count(1, 1, self.execute(counters=counters))

    def prepared(self, condition: Condition | None) -> tuple[RangeKernel, tuple[Any, ...]]:
        """The compiled kernel, and its arguments after the counts."""
        kernel, memory = self._kernel, self._memory
        place = next(
            (
                k
                for k, one in enumerate(self._streams)
                if condition is not None and one is condition.stream
            ),
            None,
        )
        key = (None if condition is None else condition.operation), place
        if key not in self._made:
            self._made[key] = self._make(condition, place)
        declared = kernel.declared
        arguments: list[Any] = [np.uint64(capacity_of(kernel.record_count))]
        arguments += [memory.resident(one).front.address for one in self._streams]
        arguments += [
            memory.resident(self._streams[k]).second(memory.gpu).address
            for k, is_double in declared.source().outputs
            if is_double
        ]
        for gather in declared.gathers.values():
            table = memory.table(gather)
            shape = tuple(np.int64(length) for length in gather.shape)
            arguments.append((table.front.address, np.uint64(capacity_of(table.count)), shape))
        arguments += declared.constants.values()
        if condition is not None:
            if place is None:
                self._mask = memory.place(condition.stream)  # kept alive until it is read
                arguments.append(self._mask.address)
            arguments.append(condition.value)
        return self._made[key], tuple(arguments)

    def _make(self, condition: Condition | None, place: int | None) -> RangeKernel:
        text, names = _text_of(self._kernel, condition, place)
        return RangeKernel(kernel_from_source(text, names, __name__))


def _flat(gather: GatherArray) -> NDArray[Any]:
    """A gather array's records, one after the other."""
    array = gather.array
    width = gather.layout.component_count
    return array.reshape((-1, width) if width else -1)


def _text_of(
    kernel: Kernel, condition: Condition | None, place: int | None
) -> tuple[str, dict[str, Any]]:
    """The source of the kernel of one record, and the names that it uses.

    The counterpart of the loop of `streams.source`, for records in columns.
    """
    declared, source = kernel.declared, kernel.declared.source()
    columns = [SoaLayout(layout) for layout in source.streams]
    names: dict[str, Any] = {
        **NAMES,
        "accept": accept(_shapes(source), "its output"),
        "atomic_add_aggregated": atomic_add_aggregated,
        "gather_table_at": gather_table_at,
        "function": as_device(kernel.function),
        **{f"Record_{k}": one.layout.record for k, one in enumerate(columns)},
        **{f"Group_{k}": group for k, (_, group) in enumerate(source.groups)},
    }
    parameters = ["i", "counts", "capacity", *(f"stream_{k}" for k in range(len(columns)))]
    parameters += [f"new_{k}" for k, is_double in source.outputs if is_double]
    parameters += [f"table_{k}" for k in range(len(source.gathers))]
    parameters += [f"constant_{k}" for k in range(source.constant_count)]
    lines = []
    for k, gather in enumerate(declared.gathers.values()):
        names[f"load_{k}"] = _load_function(gather)
        base = f"table_{k}[0], table_{k}[1], table_{k}[2]"
        lines.append(f"gather_{k} = gather_table_at({base}, load_{k})")
    test = "True"
    if condition is not None:
        parameters += ["value"] if place is not None else ["where", "value"]
        own = SoaLayout(condition.stream.layout)
        base = "where" if place is None else f"stream_{place}"
        test = f"{own.load(base, 'capacity', 'i', '')} {condition.operation} value"
    arguments = []
    for name, number in source.inputs:
        loaded = "int64(i)"
        if number is not None:
            base = f"stream_{number}"
            loaded = columns[number].load(base, "capacity", "i", f"Record_{number}")
        arguments.append(f"{name}={loaded}")
    arguments += [f"{name}={expression}" for name, expression in source.bindings]
    lines += [
        f"if {test}:",
        "    atomic_add_aggregated(counts, uint32(1))",
        f"    result = function({', '.join(arguments)})",
        "    if result is not None:",
        "        record = accept(result)",
        *(f"        {line}" for line in _stores(source, columns)),
        "        atomic_add_aggregated(counts + unsigned(4), uint32(1))",
        "        return",
        *_copies(source, columns),
    ]
    body = "\n".join(f"    {line}" for line in lines)
    return f"def run({', '.join(parameters)}):\n{body}\n", names


def _shapes(source: Any) -> Any:
    """The shapes that the function returns; see `jit.user_results.accept`."""
    shapes = tuple(source.streams[k].shape for k, _ in source.outputs)
    return shapes[0] if source.is_single else shapes


def _stores(source: Any, columns: list[SoaLayout]) -> list[str]:
    lines = []
    for part, (k, is_double) in enumerate(source.outputs):
        value = "record" if source.is_single else f"record[{part}]"
        base = f"{'new' if is_double else 'stream'}_{k}"
        lines += columns[k].store(base, "capacity", "i", value)
    return lines


def _copies(source: Any, columns: list[SoaLayout]) -> list[str]:
    """The statements that copy a record that is not written to the back buffer."""
    lines = []
    for k, is_double in source.outputs:
        if is_double:
            lines += columns[k].copy(f"new_{k}", f"stream_{k}", "capacity", "i")
    return lines


def _load_function(gather: GatherArray) -> Callable[..., Any]:
    """The device function (base, capacity, i) that reads a record."""
    columns = SoaLayout(gather.layout)
    loaded = columns.load("base", "capacity", "i", "Record")
    names = {**NAMES, "Record": gather.layout.record}
    return device_from_source(
        f"def read(base, capacity, i):\n    return {loaded}\n", names, __name__
    )
