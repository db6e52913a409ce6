"""PTX instructions that move data: selections, comparisons, conversions, memory."""

from __future__ import annotations

import operator
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from ptx.numbers import COMPARISONS, as_bits, converted, from_bits, is_float, signed, width_of
from ptx.slots import Slots, class_of
from ptx.warps import Meeting

#: Changes a frame.
Step = Callable[[list[Any]], Any]

_SPACES = ("param", "local", "global", "shared", "const")
_CODES = {"f32": "<f", "f64": "<d"}


def _selected(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    to, a, b = (slots.of(text, words[-1]) for text in operands[:3])
    p = slots.of(operands[3], "pred")

    def step(f):
        f[to] = f[a] if f[p] else f[b]

    return step


def _compared(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    (name, kind), to = words, slots.of(operands[0], "pred")
    a, b = (slots.of(text, kind) for text in operands[1:])
    if is_float(kind):
        compare = COMPARISONS[name]

        def step(f):
            f[to] = compare(f[a], f[b])

        return step
    name = {"lo": "lt", "ls": "le", "hi": "gt", "hs": "ge"}.get(name, name)
    compare, width = COMPARISONS[f"whole {name}"], width_of(kind)
    mask, has_sign = (1 << width) - 1, kind[0] == "s"

    def step_of_integers(f):
        x, y = f[a] & mask, f[b] & mask
        f[to] = compare(signed(x, width), signed(y, width)) if has_sign else compare(x, y)

    return step_of_integers


def _convert(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    *rounding, target, source = words
    function = converted(target, source, rounding[0] if rounding else "")
    to, a = slots.of(operands[0], target), slots.of(operands[1], source)
    wide = width_of(class_of(operands[0])) if not is_float(target) else 0
    mask = (1 << wide) - 1
    has_sign = target[0] == "s"

    def step(f):
        value = function(f[a])
        if wide > width_of(target) and has_sign:
            value = signed(value, width_of(target)) & mask
        f[to] = value

    return step


def _moved(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    kind, (target, source) = words[-1], operands
    if target[0] == "{":
        return _parted(kind, target, source, slots)
    if source[0] == "{":
        return _joined(kind, target, source, slots)
    to, a = slots.of(target, kind), slots.of(source, kind)
    change = _recast(source, target)
    if change is None:

        def step(f):
            f[to] = f[a]

    else:

        def step(f):
            f[to] = change(f[a])

    return step


def _recast(source: str, target: str) -> Callable[[Any], Any] | None:
    """Conversion of a register's content to another class; None if none is needed."""
    if source[0] != "%":
        return None
    given, wanted = class_of(source), class_of(target)
    if is_float(given) == is_float(wanted):
        return None
    if is_float(given):
        return lambda value: as_bits(value, given)
    return lambda value: from_bits(value, wanted)


def _names(text: str) -> list[str]:
    return [one.strip() for one in text.strip("{}").split(",")]


def _parted(kind: str, target: str, source: str, slots: Slots) -> Step:
    places = [slots.of(name, "b32") for name in _names(target)]
    width = width_of(kind) // len(places)
    a, given = slots.of(source, kind), class_of(source)

    def step(f):
        bits = as_bits(f[a], given) if is_float(given) else f[a]
        for at in places:
            f[at], bits = bits & ((1 << width) - 1), bits >> width

    return step


def _joined(kind: str, target: str, source: str, slots: Slots) -> Step:
    places = [slots.of(name, "b32") for name in _names(source)]
    width = width_of(kind) // len(places)
    to, wanted = slots.of(target, kind), class_of(target)

    def step(f):
        bits = sum(f[at] << (width * i) for i, at in enumerate(places))
        f[to] = from_bits(bits, wanted) if is_float(wanted) else bits

    return step


# ---- Memory.


def _place(text: str, slots: Slots, is_param: bool) -> Callable[[list[Any]], Any]:
    """Evaluator of an address in brackets; for a parameter, its name and an offset."""
    base, _, offset = text.strip("[]").replace(" ", "").partition("+")
    more = int(offset or 0)
    if is_param:
        return lambda _f: (base, more)
    at = slots.of(base, "b64")
    return lambda f: f[at] + more


def _loaded(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    kind, count = words[-1], _count_of(words)
    space = words[0] if words[0] in _SPACES else ""
    names = _names(operands[0])
    assert len(names) == count, operands
    places = [slots.of(name, kind) for name in names]
    of, size = _place(operands[1], slots, space == "param"), width_of(kind) // 8
    decode = _decoder(kind, class_of(names[0]))

    def step(f):
        thread = f[0]
        data = thread.read(of(f), size * count, space)
        for i, at in enumerate(places):
            f[at] = decode(data[i * size : (i + 1) * size])

    return step


def _count_of(words: list[str]) -> int:
    return next((int(word[1:]) for word in words if word in ("v2", "v4")), 1)


def _decoder(kind: str, wanted: str) -> Callable[[bytes], Any]:
    if is_float(wanted):
        code, made = _CODES[wanted], np.float32 if wanted == "f32" else np.float64
        return lambda data: made(struct.unpack(code, data)[0])
    mask = (1 << width_of(wanted)) - 1
    if kind[0] == "s":
        return lambda data: int.from_bytes(data, "little", signed=True) & mask
    return lambda data: int.from_bytes(data, "little")


def _stored(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    kind, count = words[-1], _count_of(words)
    space = words[0] if words[0] in _SPACES else ""
    names = _names(operands[1])
    assert len(names) == count, operands
    places = [slots.of(name, kind) for name in names]
    of, size = _place(operands[0], slots, space == "param"), width_of(kind) // 8
    encode = _encoder(kind, size)

    def step(f):
        f[0].write(of(f), b"".join([encode(f[at]) for at in places]), space)

    return step


def _encoder(kind: str, size: int) -> Callable[[Any], bytes]:
    mask = (1 << 8 * size) - 1

    def encode(value: Any) -> bytes:
        if isinstance(value, np.floating):
            return value.tobytes()
        return (value & mask).to_bytes(size, "little")

    del kind
    return encode


def _atomic(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    *spaces, name, kind = words
    function = {
        "add": lambda old, new: old + new,
        "min": min,
        "max": max,
        "exch": lambda _old, new: new,
        "or": operator.or_,
        "and": operator.and_,
        "cas": lambda old, expected, new: new if old == expected else old,
    }[name]
    del spaces
    to = slots.of(operands[0], kind)
    of, width = _place(operands[1], slots, False), width_of(kind)
    places, mask = [slots.of(text, kind) for text in operands[2:]], (1 << width) - 1

    def step(f):
        address = of(f)
        old = int.from_bytes(f[0].read(address, width // 8, ""), "little")
        values = [old, *[f[at] & mask for at in places]]
        if kind[0] == "s":
            values = [signed(value, width) for value in values]
        new = function(*values) & mask
        f[0].write(address, new.to_bytes(width // 8, "little"), "")
        f[to] = old

    return step


def _reduced(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    return _atomic(words, ("%rd_nowhere", *operands), slots)


def _voted(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    """A vote of a warp's threads: ``vote.sync.ballot.b32 to, value, voters``, and the like."""
    kinds = [word for word in words if word in ("any", "all", "ballot")]
    kind = "match" if words[0] == "match" else kinds[0] if kinds else words[0]
    to = slots.of(operands[0], words[-1])
    value, voters = None, None
    if kind != "activemask":
        value_type = words[-1] if kind == "match" else "pred"
        value, voters = slots.of(operands[1], value_type), slots.of(operands[2], "b32")

    def step(f):
        said = None if value is None else f[value]
        asked = 0 if voters is None else f[voters]
        return Meeting(kind, f[0].lane, asked, said, lambda result: f.__setitem__(to, result))

    return step


def _nothing(_words: list[str], _operands: tuple[str, ...], _slots: Slots) -> Step:
    return lambda _f: None


MAKERS = {
    "activemask": lambda words, operands, slots: _voted(["activemask", *words], operands, slots),
    "match": lambda words, operands, slots: _voted(["match", *words], operands, slots),
    "atom": _atomic,
    "cvt": _convert,
    "cvta": lambda words, operands, slots: _moved([words[-1]], operands, slots),
    "ld": _loaded,
    "membar": _nothing,
    "mov": _moved,
    "red": _reduced,
    "selp": _selected,
    "setp": _compared,
    "st": _stored,
    "vote": _voted,
}
