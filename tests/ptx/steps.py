"""Instructions of PTX as functions of a frame: a list of what registers and constants hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ptx import arithmetic, data
from ptx.memory import PtxError
from ptx.slots import Slots
from ptx.text import Instruction

__all__ = ["Step", "step_of"]

#: Changes a frame; returns what comes next if that is not the next instruction.
Step = Callable[[list[Any]], Any]

_MAKERS = {**arithmetic.MAKERS, **data.MAKERS}

#: Words that change nothing here.
_IGNORED = ("nc", "volatile", "relaxed", "gpu", "cta", "sys", "weak", "uni")


def step_of(one: Instruction, slots: Slots) -> Step:
    """The function of an instruction that is no branch, call, barrier or return.

    Raises
    ------
    PtxError
        If it is not known.
    """
    name, *more = one.opcode
    words = [word for word in more if word not in _IGNORED]
    maker = _MAKERS.get(name)
    if maker is None:
        raise PtxError(f"no such instruction is known: {'.'.join(one.opcode)}")
    return maker(words, one.operands, slots)
