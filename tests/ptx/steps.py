"""PTX instructions as functions of a frame, the list of registers' and constants' values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ptx import arithmetic, data
from ptx.memory import PtxError
from ptx.slots import Slots
from ptx.text import Instruction

#: Changes a frame; returns the next instruction if it is not the following one.
Step = Callable[[list[Any]], Any]

_MAKERS = {**arithmetic.MAKERS, **data.MAKERS}

#: Modifiers without effect here.
_IGNORED = ("nc", "volatile", "relaxed", "gpu", "cta", "sys", "weak", "uni")


def step_of(one: Instruction, slots: Slots) -> Step:
    """The function of an instruction other than a branch, call, barrier or return.

    One that is not known is an error when it is run: libraries have some for numbers that are rare.

    Raises
    ------
    PtxError
        If it may be fused with another one.
    """
    name, *more = one.opcode
    words = [word for word in more if word not in _IGNORED]
    maker = _MAKERS.get(name)
    text = ".".join(one.opcode)
    if maker is None or "cc" in words or "approx" in words:
        return _unknown(text)
    return maker(words, one.operands, slots)


def _unknown(text: str) -> Step:
    def step(_frame):
        raise PtxError(f"no such instruction is known: {text}")

    return step
