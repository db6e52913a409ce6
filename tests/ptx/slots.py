"""Indices into a function's frame of the operands of its instructions."""

from __future__ import annotations

from typing import Any

from ptx.memory import PtxError
from ptx.numbers import constant

#: Special registers: a thread's position.
SPECIAL = (
    *("%tid.x", "%ctaid.x", "%ntid.x", "%nctaid.x", "%laneid"),
    *("%tid.y", "%tid.z", "%ctaid.y", "%ctaid.z"),
)


class Slots:
    """Indices into a function's frame of the operands of its instructions; 0 is the thread."""

    def __init__(self) -> None:
        self.first: list[Any] = [None]
        self.registers: dict[str, int] = {}
        self.symbols: dict[str, int] = {}

    def of(self, text: str, kind: str) -> int:
        """The index of a register, a constant, or the address of a symbol."""
        if text[0] == "%" or not (text[0].isdigit() or text[0] == "-"):
            known = self.registers if text[0] == "%" else self.symbols
            if text not in known:
                known[text] = len(self.first)
                self.first.append(None)
            return known[text]
        self.first.append(constant(text, kind))
        return len(self.first) - 1


def class_of(register: str) -> str:
    """The type of a register, by its name."""
    for prefix, kind in (
        ("%rd", "b64"),
        ("%SP", "b64"),
        ("%rs", "b16"),
        ("%r", "b32"),
        ("%fd", "f64"),
        ("%f", "f32"),
        ("%p", "pred"),
        ("%temp", "b32"),
        *((name, "b32") for name in SPECIAL),
    ):
        if register.startswith(prefix):
            return kind
    raise PtxError(f"a register of no known type: {register}")
