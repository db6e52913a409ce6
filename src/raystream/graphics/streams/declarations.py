"""The streams, gather arrays and constants of a kernel, checked against its function in WGSL."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.streams.gather import GatherArray
from raystream.graphics.streams.stream import Stream, check_device
from raystream.graphics.streams.wgsl_text import Function, Member, WgslText
from raystream.graphics.streams.wgsl_types import CONSTANT_TYPES, constant_words, type_of
from raystream.streams import INDEX
from raystream.streams.declarations import check_streams
from raystream.streams.layout import Layout
from raystream.streams.record_stream import RecordStream

#: Names that begin with it belong to the code that is generated around a kernel's function.
PREFIX = "raystream_"

_NAME = re.compile(r"(?!__)[A-Za-z_]\w*", re.ASCII)


@dataclass
class Declarations:
    """A kernel's function, streams, gather arrays and constants.

    Attributes
    ----------
    text : WgslText
    function : Function
    fields : tuple of str
        Members of the structure that it returns; empty if it returns one record.
    inputs : dict of str to Stream or INDEX
    outputs : list of Stream
    gathers : dict of str to GatherArray
    constants : dict of str to number or sequence
    types : dict of str to str
        WGSL's types of the constants.
    opened : OpenDevice
    """

    text: WgslText
    function: Function
    fields: tuple[str, ...]
    inputs: dict[str, Any]
    outputs: list[Stream]
    gathers: dict[str, GatherArray]
    constants: dict[str, Any]
    types: dict[str, str]
    opened: OpenDevice

    def name_of(self, stream: RecordStream) -> str | None:
        """A stream's name for counters: its own, else that of the parameter or output."""
        keys = [key for key, one in self.inputs.items() if one is stream]
        keys += [f"output {k}" for k, one in enumerate(self.outputs) if one is stream]
        return stream.name or (keys[0] if keys else None)

    def layout_of(self, gather: GatherArray) -> Layout:
        """Records of a gather array."""
        return gather.stream(self.opened).layout


def declare(
    name: str | None,
    source: str,
    function: str | None,
    inputs: Mapping[str, Any] | None,
    outputs: Stream | Sequence[Stream],
    gathers: Mapping[str, Any] | None,
    constants: Mapping[str, Any] | None,
) -> Declarations:
    """Check the arguments of `Kernel`.

    Raises
    ------
    GraphicsError, TypeError, ValueError
        See `Kernel`.
    """
    if not isinstance(source, str):
        raise TypeError(f"{name or 'kernel'}: expected a source in WGSL, got {source!r:.60}")
    text = WgslText(source)
    if excess := text.too_large():
        raise ValueError(f"{name or 'kernel'}, line {excess[0]}: {excess[1]}")
    entry = _find_function(name or "kernel", text, function)
    name = name or entry.name
    _check_text(name, text)
    single = isinstance(outputs, Stream)
    written: list[Stream] = [outputs] if isinstance(outputs, Stream) else list(outputs)
    tables = {
        key: value if isinstance(value, GatherArray) else GatherArray(value)
        for key, value in (gathers or {}).items()
    }
    found = Declarations(
        text,
        entry,
        (),
        dict(inputs or {}),
        written,
        tables,
        dict(constants or {}),
        {},
        None,  # type: ignore[arg-type]
    )
    _check_names(name, found)
    check_streams(name, found.inputs, found.outputs, Stream, _expected)
    found.opened = written[0].opened
    for key, one in found.inputs.items():
        if one is not INDEX:
            check_device(f"{name}, input {key!r}", one, found.opened)
    for one in written:
        check_device(f"{name}, {one.label}", one, found.opened)
    for key, table in tables.items():
        check_device(f"{name}, gather array {key!r}", table.stream(found.opened), found.opened)
    _check_types(name, found)
    found.fields = _fields(name, found, single)
    return found


def _find_function(name: str, text: WgslText, wanted: str | None) -> Function:
    functions = text.functions()
    known = ", ".join(one.name for one in functions)
    if wanted is None and len(functions) > 1:
        raise TypeError(f"{name}: its source has the functions {known}; choose one by function=")
    for one in functions:
        if wanted in (None, one.name):
            return one
    missing = "has no function" if wanted is None else f"has no function {wanted!r}"
    raise TypeError(f"{name}: its source {missing}" + (f"; it has {known}" if known else ""))


def _check_text(name: str, text: WgslText) -> None:
    """Refuse what only the generated code may declare."""
    for pattern, what in (
        (r"@(?:vertex|fragment|compute)\b", "is an entry point; declare a plain function"),
        (r"@(?:group|binding)\b", "binds a resource; declare inputs, gathers or constants"),
        (rf"\b{PREFIX}\w*", f"is a name that begins with {PREFIX!r}, which is reserved"),
        (r"\bfn\s+cover\b", "is the name of the vertex program; choose another"),
    ):
        match = text.first(pattern)
        if match:
            raise ValueError(f"{name}, line {text.line_of(match.start())}: {match[0]} {what}")


def _check_names(name: str, found: Declarations) -> None:
    declared = [*found.inputs, *found.gathers, *found.constants]
    for key in declared:
        if declared.count(key) > 1:
            raise TypeError(f"{name}: {key!r} is declared twice")
        if not _NAME.fullmatch(str(key)):
            raise TypeError(f"{name}: {key!r} is not a name in WGSL")
    parameters = [one.name for one in found.function.parameters]
    for key in parameters:
        if key in found.gathers:
            raise TypeError(
                f"{name}: the gather array {key!r} is a parameter; call it as a function instead"
            )
        if key not in declared:
            raise TypeError(f"{name}: the parameter {key!r} is not an input or constant")
    for key in (*found.inputs, *found.constants):
        if key not in parameters:
            raise TypeError(f"{name}: the function has no parameter {key!r}")
    for key in found.gathers:
        if not found.text.first(rf"\b{key}\s*\("):
            raise TypeError(f"{name}: the source does not call the gather array {key!r}")
        if found.text.first(rf"\b(?:fn|struct|alias|const|override)\s+{key}\b"):
            raise TypeError(f"{name}: the source declares {key!r}, the name of a gather array")


def _expected(_: str, value: object) -> str:
    kind = type(value)
    where = kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
    return f"expected a Stream of raystream.graphics.streams, got {where}"


def _check_types(name: str, found: Declarations) -> None:
    """Compare parameters with records; unknown names of types are left to the compiler."""
    for parameter in found.function.parameters:
        key, given = parameter
        if key in found.constants:
            if given not in CONSTANT_TYPES:
                raise TypeError(
                    f"{name}, constant {key!r}: is declared as {given}; constants are f32, i32, "
                    "u32 or vectors of them"
                )
            found.types[key] = given
            constant_words(f"{name}, constant {key!r}", given, found.constants[key])
        elif found.inputs[key] is INDEX:
            if given not in ("i32", "u32"):
                raise TypeError(f"{name}, input {key!r}: INDEX is i32 or u32, not {given}")
        else:
            _compare(f"{name}, input {key!r}", parameter, found.inputs[key])


def _compare(label: str, given: Member, stream: Stream) -> None:
    wanted = type_of(stream.dtype, stream.component_count)
    if given.type in CONSTANT_TYPES and given.type != wanted:
        raise TypeError(f"{label}: is declared as {given.type}, but {stream.label} has {wanted}")


def _fields(name: str, found: Declarations, single: bool) -> tuple[str, ...]:
    """The members of the structure that the function returns."""
    returned = found.function.returned
    if not returned:
        raise TypeError(f"{name}: the function returns nothing; it must return a record")
    structure = found.text.structure(returned)
    if structure is None:
        if not single and len(found.outputs) > 1:
            raise TypeError(
                f"{name}: has {len(found.outputs)} outputs, but the function returns {returned}; "
                "return a structure with a member for each"
            )
        _compare(f"{name}, its result", Member("", returned), found.outputs[0])
        return ()
    if len(structure.members) != len(found.outputs):
        raise TypeError(
            f"{name}: has {len(found.outputs)} outputs, but {returned} has "
            f"{len(structure.members)} members"
        )
    for member, stream in zip(structure.members, found.outputs, strict=True):
        _compare(f"{name}, {returned}.{member.name}", member, stream)
    return tuple(member.name for member in structure.members)
