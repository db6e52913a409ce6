"""The loads and stores of compiled code, and which addresses depend on loaded values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from raystream.jit.inspect import Instruction
from raystream_lab.kernels.control_flow import ControlFlow
from raystream_lab.kernels.instructions import bookkeeping

_VECTOR = re.compile(r"<(\d+) x (.+)>")
#: Operands of address computations that may be addresses themselves. Others, such as products and
#: shifts, are offsets.
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
        The origin of the address: the name of an argument; ``"local"`` for the function's own
        memory, ``"table"`` for constants, ``"memory"`` if the address was itself loaded,
        ``"several"`` if it is ambiguous.
    byte_count : int
    is_dependent : bool
        Whether the address depends on any loaded value.
    """

    opcode: str
    root: str
    byte_count: int
    is_dependent: bool


def byte_count(shown: str) -> int:
    """Size of a numeric LLVM type, such as ``"<4 x float>"`` or ``"i64"``."""
    vector = _VECTOR.fullmatch(shown)
    if vector:
        return int(vector[1]) * byte_count(vector[2])
    if shown in _BYTES:
        return _BYTES[shown]
    if not re.fullmatch(r"i\d+", shown):
        raise ValueError(f"{shown!r} is not a numeric type")
    return -(-int(shown[1:]) // 8)


def accesses(instructions: Sequence[Instruction]) -> list[Access]:
    """The loads and stores of a function, in textual order.

    Parameters
    ----------
    instructions : sequence of Instruction

    Notes
    -----
    An address depends on a value if it is computed from it, or if a value it is computed from was
    chosen by a branch that depends on it. Values are followed through the function's own memory.
    Whether a load is reached at all is no dependence: in Foley's dependent fetches, "values read
    from one input texture are used to compute the addresses" (Foley 2005, section 4.2).

    Reads of called functions are not seen, including LLVM's masked loads.
    """
    return _AccessAnalysis(instructions).accesses()


class _AccessAnalysis:
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
        """The origin of an address: an alloca's index, or a name."""
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
        """Values written to each alloca: by stores, and by calls that receive its address."""
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
        """The loads that a value depends on, each without its own dependences."""
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
        """Whether a phi selects from different values, not one value computed twice."""
        values = {
            self._code[x]._replace(block=0) if isinstance(x, int) else x for x in phi.operands
        }
        return len(values) > 1 or "" in values
