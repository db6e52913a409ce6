"""Inspection of compiled code: the optimised LLVM instructions of a function, and its assembly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numba
from llvmlite import binding, ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.cpu import compiled

_ONE_BIT = ir.IntType(1)


@intrinsic
def assume(typing_context: Any, condition: Any) -> Any:
    """Tell the compiler that a condition holds, so that it drops the code for the other case."""
    if not isinstance(condition, types.Boolean):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.assume(builder.trunc(arguments[0], _ONE_BIT))
        return context.get_dummy_value()

    return types.void(condition), generate


class Instruction(NamedTuple):
    """An LLVM instruction.

    Attributes
    ----------
    opcode : str
        Such as ``"fadd"``, ``"load"`` or ``"call"``.
    type : str
        Of the result, such as ``"float"`` or ``"<4 x i32>"``; of the stored value, for a store.
    operands : tuple of int or str
        Index of an instruction; name of an argument, with ``%``, or of a global, with ``@``;
        empty for constants.
    block : int
        Index of its basic block.
    callee : str
        Name of the function called; empty for other instructions.
    blocks : tuple of int
        Targets of a branch, or incoming blocks of a phi.
    """

    opcode: str
    type: str
    operands: tuple[int | str, ...]
    block: int
    callee: str
    blocks: tuple[int, ...]


class Code(NamedTuple):
    """A compiled function.

    Attributes
    ----------
    name : str
        Its LLVM name.
    functions : dict of str to tuple of Instruction
        Instructions of all functions in its module, by LLVM name. Blocks are numbered in order;
        the first one is the entry.
    assembly : str
        Of its module.
    """

    name: str
    functions: dict[str, tuple[Instruction, ...]]
    assembly: str

    @property
    def instructions(self) -> tuple[Instruction, ...]:
        """Instructions of the function itself."""
        return self.functions[self.name]


def compile_code(function: Callable[..., Any], arguments: Sequence[Any]) -> Code:
    """Compile a function as `kernel` does, for the types of example arguments.

    Parameters
    ----------
    function : callable
        A Python function.
    arguments : sequence
        Examples of arguments; the function is not called.

    Returns
    -------
    Code
        Compiled in this process: the disk cache stores no instructions.
    """
    dispatcher: Any = compiled(function)
    dispatcher.compile(tuple(numba.typeof(argument) for argument in arguments))
    (signature,) = dispatcher.signatures
    name = dispatcher.overloads[signature].fndesc.llvm_func_name
    functions = read_functions(dispatcher.inspect_llvm(signature))
    return Code(name, functions, dispatcher.inspect_asm(signature))


def read_functions(text: str) -> dict[str, tuple[Instruction, ...]]:
    """Functions defined in LLVM assembly.

    Raises
    ------
    RuntimeError
        If the text is not LLVM assembly.
    """
    module = binding.parse_assembly(text)
    return {one.name: _instructions(one) for one in module.functions if not one.is_declaration}


def _instructions(function: Any) -> tuple[Instruction, ...]:
    blocks = list(function.blocks)
    number_of_block = {hash(block): k for k, block in enumerate(blocks)}
    rows = [(k, one) for k, block in enumerate(blocks) for one in block.instructions]
    number_of = {hash(one): k for k, (_, one) in enumerate(rows)}
    result = []
    for block, one in rows:
        given = list(one.operands)
        operands = [_operand(operand, number_of) for operand in given]
        jumps = [number_of_block[hash(x)] for x in given if hash(x) in number_of_block]
        opcode, callee = one.opcode, ""
        if opcode == "call":
            callee = given[-1].name
            operands.pop()
        elif opcode == "phi":
            jumps = [number_of_block[hash(x)] for x in one.incoming_blocks]
        shown = str(given[0].type if opcode == "store" else one.type)
        result.append(Instruction(opcode, shown, tuple(operands), block, callee, tuple(jumps)))
    return tuple(result)


def _operand(value: Any, number_of: dict[int, int]) -> int | str:
    known = number_of.get(hash(value))
    if known is not None:
        return known
    if value.value_kind == binding.ValueKind.argument:
        return f"%{value.name}"
    kinds = (binding.ValueKind.global_variable, binding.ValueKind.function)
    return f"@{value.name}" if value.value_kind in kinds else ""
