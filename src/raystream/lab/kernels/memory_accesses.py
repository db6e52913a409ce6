"""What compiled code reads and writes, and which addresses follow from what was read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from raystream.jit.inspect import Instruction
from raystream.lab.kernels.control_flow import ControlFlow
from raystream.lab.kernels.instructions import bookkeeping

__all__ = ["Access", "accesses", "byte_count"]

_VECTOR = re.compile(r"<(\d+) x (.+)>")
#: Which operands of an instruction that makes an address may be addresses themselves. Others,
#: such as products and shifts, make the distance from one.
_STEPS = {
    "getelementptr": slice(0, 1),
    "select": slice(1, None),
    **dict.fromkeys(("phi", "add", "sub", "or", "xor"), slice(None)),
    **dict.fromkeys(("inttoptr", "ptrtoint", "bitcast"), slice(None)),
}

_BYTES = {"float": 4, "double": 8, "half": 2, "ptr": 8}


class Access(NamedTuple):
    """A load or store.

    Attributes
    ----------
    opcode : str
        ``"load"`` or ``"store"``.
    root : str
        Whose memory it is: the name of the argument with the address; ``"local"`` for the
        function's own memory, ``"table"`` for constants, ``"memory"`` if the address was itself
        read, ``"several"`` if it may be of one or another.
    byte_count : int
    is_dependent : bool
        Whether the address follows from anything that was read, from wherever.
    """

    opcode: str
    root: str
    byte_count: int
    is_dependent: bool


def byte_count(shown: str) -> int:
    """Bytes of one of LLVM's types of numbers, such as ``"<4 x float>"`` or ``"i64"``."""
    vector = _VECTOR.fullmatch(shown)
    if vector:
        return int(vector[1]) * byte_count(vector[2])
    if shown in _BYTES:
        return _BYTES[shown]
    if not re.fullmatch(r"i\d+", shown):
        raise ValueError(f"{shown!r} is no number")
    return -(-int(shown[1:]) // 8)


def accesses(instructions: Sequence[Instruction]) -> list[Access]:
    """The loads and stores of a function, in the order of its text.

    Parameters
    ----------
    instructions : sequence of Instruction

    Notes
    -----
    An address depends on a value if it is computed from it, or if a value it is computed from
    was chosen by a jump that depends on it. What is stored to the function's own memory passes
    through it. Whether a load is reached at all is not an address: Foley's dependent fetches
    are those whose "values read from one input texture are used to compute the addresses"
    (Foley 2005, section 4.2).

    What functions read that are called is not seen, masked loads of LLVM's included.
    """
    return _Reader(instructions).accesses()


class _Reader:
    def __init__(self, instructions: Sequence[Instruction]) -> None:
        self._code = instructions
        self._blocks = ControlFlow(instructions)
        self._roots = {
            k: self._root(one.operands[-1])
            for k, one in enumerate(instructions)
            if one.opcode in ("load", "store")
        }
        self._written = self._local_writes()

    def accesses(self) -> list[Access]:
        skipped = bookkeeping(self._code)
        return [
            Access(
                one.opcode,
                self._name(k),
                byte_count(one.type),
                bool(self._loads_of(one.operands[-1 if one.opcode == "store" else 0])),
            )
            for k, one in enumerate(self._code)
            if one.opcode in ("load", "store") and k not in skipped
        ]

    def _name(self, k: int) -> str:
        root = self._roots[k]
        return "local" if isinstance(root, int) else root

    def _root(self, pointer: int | str) -> int | str:
        """Whose memory an address is in: an alloca's number, or a name."""
        found: set[int | str] = set()
        seen: set[int | str] = set()
        waiting = [pointer]
        while waiting:
            one = waiting.pop()
            if one in seen or one == "":
                continue
            seen.add(one)
            if isinstance(one, str):
                found.add("table" if one.startswith("@") else one)
                continue
            instruction = self._code[one]
            if instruction.opcode == "alloca":
                found.add(one)
            elif instruction.opcode == "load":
                found.add("memory")
            elif instruction.opcode in _STEPS:
                waiting += instruction.operands[_STEPS[instruction.opcode]]
        return found.pop() if len(found) == 1 else "several"

    def _local_writes(self) -> dict[int, list[int | str]]:
        """What is written to each alloca: values stored, and what functions called with it got."""
        written: dict[int, list[int | str]] = {}
        for k, one in enumerate(self._code):
            root = self._roots.get(k)
            if one.opcode == "store" and isinstance(root, int):
                written.setdefault(root, []).append(one.operands[0])
            elif one.opcode == "call":
                for operand in one.operands:
                    own = self._root(operand) if isinstance(operand, int) else ""
                    if isinstance(own, int):
                        written.setdefault(own, []).extend(one.operands)
        return written

    def _loads_of(self, value: int | str) -> set[int]:
        """The loads that a value follows from, each without those before it."""
        found: set[int] = set()
        seen: set[int | str] = set()
        waiting = [value]
        while waiting:
            one = waiting.pop()
            if one in seen or isinstance(one, str):
                continue
            seen.add(one)
            instruction = self._code[one]
            root = self._roots.get(one)
            if instruction.opcode == "load" and not isinstance(root, int):
                found.add(one)
                continue
            waiting += instruction.operands
            if isinstance(root, int):
                waiting += self._written.get(root, [])
            if instruction.opcode == "phi" and self._is_choice(instruction):
                for block in self._blocks.deciders(instruction.block):
                    end = self._code[self._blocks.ends[block]]
                    if len(end.blocks) > 1:
                        waiting += end.operands
        return found

    def _is_choice(self, phi: Instruction) -> bool:
        """Whether it has different values to choose from, not one that is computed twice."""
        values = {
            self._code[x]._replace(block=0) if isinstance(x, int) else x for x in phi.operands
        }
        return len(values) > 1 or "" in values
