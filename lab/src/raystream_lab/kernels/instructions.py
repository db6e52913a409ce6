"""Count LLVM instructions of compiled code by class."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from raystream.jit.inspect import Instruction
from raystream_lab.kernels.control_flow import ControlFlow

_CLASSES = {
    "floating": "fadd fsub fmul fdiv frem fneg",
    "integer": "add sub mul udiv sdiv urem srem shl lshr ashr and or xor",
    "conversions": "fpext fptrunc sitofp uitofp fptosi fptoui sext zext trunc",
    "comparisons": "icmp fcmp select",
    "addresses": "getelementptr",
    "lanes": "extractelement insertelement shufflevector",
    "loads": "load",
    "stores": "store",
    "branches": "switch",
}
_CLASS_OF = {opcode: name for name, opcodes in _CLASSES.items() for opcode in opcodes.split()}

#: LLVM's intrinsics for integers; its others compute with floats.
_INTEGER_CALLS = (
    *("abs", "ctlz", "ctpop", "cttz", "fshl", "fshr", "sadd", "smax", "smin", "ssub"),
    *("uadd", "umax", "umin", "usub", "vector.reduce.and", "vector.reduce.or"),
)

#: Hints to the compiler, which generate no code.
_HINTS = ("assume", "lifetime", "dbg", "experimental.noalias", "invariant")

#: Reference counting of arrays: once per call of a loop, not per record.
_ARRAY_OWNERS = ("NRT_incref", "NRT_decref")


@dataclass(frozen=True)
class InstructionCounts:
    """Optimised LLVM instructions by class.

    Each corresponds to about one machine instruction. Instructions that generate no code are not
    counted: unconditional jumps, phis, bitcasts, compiler hints; nor is work done once for a whole
    loop over records.

    Attributes
    ----------
    floating : int
        Float arithmetic, including minimum, absolute value and the like.
    integer : int
        Integer arithmetic and bit operations.
    conversions : int
        Between numeric types.
    comparisons : int
        Comparisons and selects.
    addresses : int
        Address computations. Machines fold many of them into loads and stores.
    lanes : int
        Moves between vector lanes.
    loads, stores : int
    branches : int
        Conditional jumps.
    calls : int
        Calls that were not inlined.
    """

    floating: int = 0
    integer: int = 0
    conversions: int = 0
    comparisons: int = 0
    addresses: int = 0
    lanes: int = 0
    loads: int = 0
    stores: int = 0
    branches: int = 0
    calls: int = 0

    @property
    def total(self) -> int:
        """All instructions, each once."""
        arithmetic = self.floating + self.integer + self.conversions + self.comparisons
        memory = self.addresses + self.lanes + self.loads + self.stores
        return arithmetic + memory + self.branches + self.calls


def class_of(one: Instruction) -> str | None:
    """The field of `InstructionCounts` for an instruction; None if not counted."""
    if one.opcode == "br":
        return "branches" if len(one.blocks) > 1 else None
    if one.opcode != "call":
        return _CLASS_OF.get(one.opcode)
    if not one.callee.startswith("llvm."):
        return None if one.callee in _ARRAY_OWNERS else "calls"
    name = one.callee.removeprefix("llvm.")
    if name.startswith(_HINTS):
        return None
    if name.startswith(("masked.load", "masked.gather")):
        return "loads"
    if name.startswith(("masked.store", "masked.scatter", "memcpy", "memset")):
        return "stores"
    return "integer" if name.startswith(_INTEGER_CALLS) else "floating"


def bookkeeping(instructions: Sequence[Instruction]) -> set[int]:
    """Instructions that only feed compiler hints, and stores of return values."""
    users: list[list[int]] = [[] for _ in instructions]
    for k, one in enumerate(instructions):
        for operand in one.operands:
            if isinstance(operand, int):
                users[operand].append(k)
    hints = {
        k
        for k, one in enumerate(instructions)
        if one.opcode == "call" and one.callee.startswith("llvm.assume")
    }
    waiting = [x for k in hints for x in instructions[k].operands if isinstance(x, int)]
    while waiting:
        k = waiting.pop()
        if k not in hints and hints.issuperset(users[k]):
            hints.add(k)
            waiting += [x for x in instructions[k].operands if isinstance(x, int)]
    # Return values go to %retptr. Pointers are stored for exceptions only.
    return hints | {
        k
        for k, one in enumerate(instructions)
        if one.opcode == "store" and (one.type == "ptr" or one.operands[-1] == "%retptr")
    }


def count_instructions(
    instructions: Sequence[Instruction], among: Iterable[int] | None = None
) -> InstructionCounts:
    """Count the instructions of a function.

    Parameters
    ----------
    instructions : sequence of Instruction
    among : iterable of int, optional
        Only count these blocks [default: all].
    """
    blocks = None if among is None else set(among)
    skipped = bookkeeping(instructions)
    counts: Counter[str] = Counter()
    for k, one in enumerate(instructions):
        name = class_of(one)
        if name is None or k in skipped or (blocks is not None and one.block not in blocks):
            continue
        counts[name] += 1
    return InstructionCounts(**counts)


def count_loop(instructions: Sequence[Instruction]) -> InstructionCounts | None:
    """Count the instructions of the longest outermost loop; None without loops."""
    loops = ControlFlow(instructions).loops()
    counts = [count_instructions(instructions, loop) for loop in loops]
    return max(counts, key=lambda one: one.total, default=None)
