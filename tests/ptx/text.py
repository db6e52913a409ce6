"""A PTX parser: the functions of a module, their instructions, and the memory they declare.

It supports the output of NVIDIA's compiler for raystream's kernels; anything else is an error.
Source: NVIDIA, "Parallel Thread Execution ISA", chapters 4 and 5.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
#: Statements that end with their line.
_DIRECTIVE = re.compile(r"\s*\.(?:version|target|address_size|file|loc|section)\b[^\n]*\n")
_IGNORED = (".reg", ".pragma", ".loc")
_HEAD = re.compile(
    r"^(?:\.\w+\s+)*\.(?P<kind>entry|func)\s*(?:\((?P<results>[^)]*)\))?\s*(?P<name>[\w$]+)"
    r"\s*(?:\((?P<parameters>[^)]*)\))?(?P<more>[^{;]*)",
    re.DOTALL,
)
_MEMORY = re.compile(
    r"\.(?P<space>local|shared|param|global|const)(?:\s+\.align\s+(?P<align>\d+))?\s+\.[bsuf](?P<bits>\d+)"
    r"\s+(?P<name>[\w$]+)(?:\[(?P<count>\d+)\])?$"
)
_GUARD = re.compile(r"^@(?P<not>!?)(?P<register>%\w+)\s+(?P<rest>.*)$", re.DOTALL)
_OPERAND = re.compile(r"\{[^}]*\}|\[[^\]]*\]|\([^)]*\)|[^,\s]+")


class Declared(NamedTuple):
    """Memory that has a name."""

    space: str
    name: str
    byte_count: int
    align: int


class Instruction(NamedTuple):
    """An instruction, which only runs if a predicate register is, or is not, set."""

    guard: str | None
    is_negated: bool
    opcode: tuple[str, ...]
    operands: tuple[str, ...]


class Function(NamedTuple):
    """A kernel, or a function that one calls."""

    name: str
    results: tuple[Declared, ...]
    parameters: tuple[Declared, ...]
    memory: tuple[Declared, ...]
    instructions: tuple[Instruction, ...]
    labels: dict[str, int]


class Module(NamedTuple):
    """Functions of a module by name, shared memory of blocks, and initialized bytes."""

    functions: dict[str, Function]
    shared: tuple[Declared, ...]
    constants: tuple[tuple[Declared, bytes], ...]


def parse(text: str) -> Module:
    """Read a module.

    Raises
    ------
    ValueError
        If there is something that is not known.
    """
    functions, shared, constants = {}, [], []
    for head, body in _parts(_COMMENT.sub("", text)):
        if body is None:
            declared = _declared(head)
            if declared is not None and declared.space == "shared":
                shared.append(declared)
            continue
        if head.endswith("="):
            declared = _declared(head[:-1].strip())
            if declared is None:
                raise ValueError(f"not known: {head[:200]}")
            constants.append((declared, _bytes_of(declared, body)))
            continue
        function = _function(head, body)
        functions[function.name] = function
    return Module(functions, tuple(shared), tuple(constants))


def _bytes_of(declared: Declared, text: str) -> bytes:
    """The values of an array of bytes; missing ones are 0."""
    given = bytes(int(number, 0) for number in text.split(","))
    return given + bytes(declared.byte_count - len(given))


def _parts(text: str):
    """Declarations, and heads with bodies, of a module."""
    at = 0
    while True:
        ignored = _DIRECTIVE.match(text, at)
        if ignored:
            at = ignored.end()
            continue
        end = re.compile(r"[;{]").search(text, at)
        if end is None:
            return
        head, at = text[at : end.start()].strip(), end.end()
        if end[0] == ";":
            yield head, None
            continue
        begin, depth = at, 1
        while depth:
            depth += {"{": 1, "}": -1}.get(text[at], 0)
            at += 1
        yield head, text[begin : at - 1]


def _declared(text: str) -> Declared | None:
    """Memory, if a text declares some."""
    found = _MEMORY.search(" ".join(text.split()))
    if found is None:
        return None
    size = int(found["bits"]) // 8
    count = int(found["count"] or 1)
    return Declared(found["space"], found["name"], size * count, int(found["align"] or size))


def _list_of(text: str | None) -> tuple[Declared, ...]:
    made = [_declared(one) for one in (text or "").split(",") if one.strip()]
    assert None not in made, text
    return tuple(one for one in made if one is not None)


def _function(head: str, body: str) -> Function:
    found = _HEAD.match(head)
    if found is None:
        raise ValueError(f"no function begins like this: {head[:200]}")
    memory, instructions, labels = [], [], {}
    for statement in _statements(body):
        if statement.endswith(":"):
            labels[statement[:-1]] = len(instructions)
        elif statement.startswith("."):
            declared = _declared(statement)
            if declared is not None:
                memory.append(declared)
            elif not statement.startswith(_IGNORED):
                raise ValueError(f"not known: {statement[:200]}")
        else:
            instructions.append(_instruction(statement))
    return Function(
        found["name"],
        _list_of(found["results"]),
        _list_of(found["parameters"]),
        tuple(memory),
        tuple(instructions),
        labels,
    )


def _statements(body: str):
    """Labels, with a colon; declarations; and instructions. Braces of blocks say nothing here."""
    for line in re.split(r";", body):
        rest = line.strip()
        while True:
            label = re.match(r"^(\$?\w+):\s*", rest)
            brace = re.match(r"^[{}]\s*(?!%)", rest)
            if label:
                yield f"{label[1]}:"
                rest = rest[label.end() :]
            elif brace:
                rest = rest[brace.end() :]
            else:
                break
        if rest:
            yield rest


def _instruction(statement: str) -> Instruction:
    guard, is_negated, rest = None, False, statement
    guarded = _GUARD.match(statement)
    if guarded:
        guard, is_negated, rest = guarded["register"], bool(guarded["not"]), guarded["rest"]
    words = rest.split(None, 1)
    operands = words[1] if len(words) > 1 else ""
    return Instruction(
        guard, is_negated, tuple(words[0].split(".")), tuple(_OPERAND.findall(operands))
    )
