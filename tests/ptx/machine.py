"""A PTX interpreter: runs the output of NVIDIA's compiler for a kernel without a GPU.

Threads run one after the other, and synchronize at barriers and votes. Registers hold Python and
NumPy numbers; memory is the host's, by address, and every access is checked. Unknown instructions
are errors, and so are those that a device would round differently from the CPU.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ptx.memory import UNWRITTEN, Memory, PtxError, room_for
from ptx.slots import SPECIAL, Slots
from ptx.steps import Step, step_of
from ptx.text import Declared, Function, Module, parse
from ptx.warps import BARRIER, WARP_SIZE, Meeting, run_together

__all__ = ["Kernel", "Memory", "PtxError"]

_RETURN = object()

#: A thread that executes this many instructions is in an endless loop.
_MOST_STEPS = 20_000_000


class _Call(NamedTuple):
    """A function that is to run next."""

    name: str
    given: Sequence[str]
    results: Sequence[str]


class _Code:
    """A function as steps."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.slots = Slots()
        self.steps: list[Step] = []
        for one in function.instructions:
            step = self._step_of(one)
            self.steps.append(step if one.guard is None else self._guarded(one, step))

    def where(self, number: int) -> str:
        """An instruction, for errors."""
        one = self.function.instructions[number]
        return f"{self.function.name[:60]}: {'.'.join(one.opcode)} {', '.join(one.operands)}"

    def _guarded(self, one, step: Step) -> Step:
        at, wanted = self.slots.of(one.guard, "pred"), not one.is_negated
        return lambda f: step(f) if f[at] is wanted else None

    def _step_of(self, one) -> Step:
        name = one.opcode[0]
        if name == "bra":
            target = self.function.labels[one.operands[0]]
            return lambda _f: target
        if name in ("ret", "exit"):
            return lambda _f: _RETURN
        if name == "trap":
            raise PtxError("a trap")
        if name == "bar":
            return lambda _f: BARRIER
        if name == "call":
            return self._call(one.operands)
        return step_of(one, self.slots)

    def _call(self, operands: tuple[str, ...]) -> Step:
        results = operands[0].strip("()").split() if operands[0][0] == "(" else []
        name, *given = operands[1:] if results else operands
        names = [text.strip() for text in given[0].strip("()").split(",")] if given else []

        call = _Call(name, names, results)
        return lambda _f: call


class Kernel:
    """A kernel in PTX, to be launched.

    Parameters
    ----------
    ptx : str
    entry : str
        Its name.
    """

    def __init__(self, ptx: str, entry: str) -> None:
        self.name = entry
        self._module: Module = parse(ptx)
        self._codes: dict[str, _Code] = {}
        self._constants = []
        for one, data in self._module.constants:
            room = room_for(one.byte_count, one.align)
            room[:] = np.frombuffer(data, np.uint8)
            self._constants.append((one.name, room))

    def code(self, name: str) -> _Code:
        """The steps of one of its functions."""
        if name not in self._codes:
            self._codes[name] = _Code(self._module.functions[name])
        return self._codes[name]

    def launch(
        self, memory: Memory, block_count: int, block_size: int, values: Sequence[Any]
    ) -> None:
        """Run all threads of all blocks.

        Raises
        ------
        PtxError
            If a device would not do that.
        """
        parameters = self.code(self.name).function.parameters
        assert len(parameters) == len(values), (len(parameters), len(values))
        given = {}
        for one, value in zip(parameters, values, strict=True):
            data = np.asarray(value).tobytes()
            if len(data) != one.byte_count:
                raise PtxError(f"{one.name[-40:]}: takes {one.byte_count} bytes, not {len(data)}")
            given[one.name] = data
        addresses = {name: memory.add(name, room) for name, room in self._constants}
        with np.errstate(all="ignore"):
            for block in range(block_count):
                self._run_block(memory, (block, block_count, block_size), given, addresses)
        for address in addresses.values():
            memory.drop(address)

    def _run_block(
        self, memory: Memory, where: tuple[int, int, int], given: Any, constants: dict[str, int]
    ) -> None:
        inside = [one for f in self._module.functions.values() for one in f.memory]
        shared = _Rooms(memory, "shared", (*self._module.shared, *inside))
        named = constants | shared.addresses
        threads = [_Thread(self, memory, named, (i, *where), given).run() for i in range(where[2])]
        run_together(threads)
        shared.close()


class _Rooms:
    """Memory that a function or a block declares: there until it ends."""

    def __init__(self, memory: Memory, space: str, declared: Sequence[Declared]) -> None:
        self._memory, self._kept, self.addresses = memory, [], {}
        for one in declared:
            if one.space != space:
                continue
            room = room_for(one.byte_count, one.align)
            self.addresses[one.name] = memory.add(f"{one.space} memory", room)
            self._kept.append(room)

    def close(self) -> None:
        """Forget the memory."""
        for room in self._kept:
            self._memory.drop(int(room.ctypes.data))


class _Thread:
    """A thread: calls, parameters, and its way to memory."""

    def __init__(self, kernel: Kernel, memory: Memory, shared: Any, where: Any, given: Any) -> None:
        self._kernel, self._memory, self._shared = kernel, memory, shared
        number, block, block_count, block_size = where
        self.lane = number % WARP_SIZE
        given_to = (number, block, block_size, block_count, self.lane, 0, 0, 0, 0)
        self._special = dict(zip(SPECIAL, given_to, strict=True))
        self._parameters: list[dict[str, bytearray]] = [{k: bytearray(v) for k, v in given.items()}]

    def run(self) -> Iterator[object]:
        """Run the kernel; yields what it waits for: `BARRIER`, or the place and kind of a vote."""
        yield from self._run(self._kernel.code(self._kernel.name))

    def _run(self, code: _Code) -> Iterator[object]:
        rooms = _Rooms(self._memory, "local", code.function.memory)
        frame = list(code.slots.first)
        frame[0] = self
        for name, at in code.slots.symbols.items():
            frame[at] = rooms.addresses.get(name, self._shared.get(name))
        for name, value in self._special.items():
            if name in code.slots.registers:
                frame[code.slots.registers[name]] = value
        here, steps = 0, code.steps
        for _ in range(_MOST_STEPS):
            try:
                there = steps[here](frame)
            except PtxError as error:
                raise PtxError(f"{error}, in {code.where(here)}") from error
            if there is None:
                here += 1
            elif there is _RETURN:
                rooms.close()
                return
            elif there is BARRIER:
                yield BARRIER
                here += 1
            elif isinstance(there, Meeting):
                yield (code.function.name, here), there
                here += 1
            elif isinstance(there, _Call):
                yield from self._run_call(*there)
                here += 1
            else:
                here = there
        raise PtxError(f"{code.function.name[-40:]}: more than {_MOST_STEPS:,} steps")

    def _run_call(
        self, name: str, given: Sequence[str], results: Sequence[str]
    ) -> Iterator[object]:
        """Run a function: its parameters are the caller's under other names."""
        code, own = self._kernel.code(name), self._parameters[-1]
        theirs = {}
        for there, here in zip(code.function.parameters, given, strict=True):
            # Results that the callee does not use are not written.
            theirs[there.name] = own.pop(here, bytearray([UNWRITTEN] * there.byte_count))
        for there, here in zip(code.function.results, results, strict=True):
            theirs[there.name] = own[here] = bytearray(there.byte_count)
        self._parameters.append(theirs)
        yield from self._run(code)
        self._parameters.pop()

    def read(self, place: Any, size: int, space: str) -> bytes:
        """Bytes of memory, or of a parameter."""
        if space != "param":
            return self._memory.read(place, size)
        name, offset = place
        data = self._parameters[-1][name][offset : offset + size]
        if len(data) != size:
            raise PtxError(f"reads {size} bytes of a parameter, where {len(data)} are")
        return bytes(data)

    def write(self, place: Any, data: bytes, space: str) -> None:
        """Write bytes to memory, or to a parameter."""
        if space != "param":
            self._memory.write(place, data)
            return
        name, offset = place
        room = self._parameters[-1].setdefault(name, bytearray())
        room.extend(bytes(max(0, offset + len(data) - len(room))))
        room[offset : offset + len(data)] = data
