"""The fragment program of a kernel: its source, and the code around it."""

from __future__ import annotations

import math
from typing import NamedTuple

from raystream.graphics.pipelines import Layout
from raystream.graphics.shader_source import shader_source
from raystream.graphics.streams.declarations import PREFIX, Declarations
from raystream.graphics.streams.gather import GatherArray
from raystream.graphics.streams.stream import Stream
from raystream.graphics.streams.wgsl_text import Member
from raystream.graphics.streams.wgsl_types import CONSTANT_TYPES, of_components, type_of
from raystream.graphics.textures import sampled
from raystream.streams import INDEX
from raystream.streams.condition import Condition

#: Counters of one kind: records share one with those of the same remainder, so that few wait.
COUNTER_SLOTS = 64

#: WGSL's scalar types, by the kind of a texture's format.
_SCALARS = {"float": "f32", "sint": "i32", "uint": "u32"}

_SWIZZLES = {1: ".x", 2: ".xy", 3: ".xyz", 4: ""}


class KernelProgram(NamedTuple):
    """A fragment program in WGSL, and what it reads and writes.

    Attributes
    ----------
    source : str
        The kernel's own source comes first, so that its lines keep their numbers.
    layout : Layout
        Of its one bind group: the uniform if there is one, counters if any, textures.
    reads : tuple of Stream
        In the order of the textures.
    groups : tuple of tuple of int
        Numbers of the outputs that one draw writes, with entry point ``raystream_draw_0`` ...
    may_reject : bool
        Whether a record may keep its old value.
    uniform : tuple of str
        Keys of the constants in the uniform; ``""`` is the condition's number.
    counter_kinds : int
        Kinds of counters, of `COUNTER_SLOTS` words each: records written, records that the
        function ran on, reads of each gather array, reads out of range of each. 0 if the number
        of records written is known beforehand, and nothing is counted.
    """

    source: str
    layout: Layout
    reads: tuple[Stream, ...]
    groups: tuple[tuple[int, ...], ...]
    may_reject: bool
    uniform: tuple[str, ...]
    counter_kinds: int

    def entry(self, group: int) -> str:
        """The entry point of a group of outputs."""
        return f"{PREFIX}draw_{group}"


def make_program(
    declared: Declarations, condition: Condition | None, is_counted: bool
) -> KernelProgram:
    """The program of a kernel.

    Parameters
    ----------
    declared : Declarations
    condition : Condition or None
        Of a stream on the device.
    is_counted : bool
        Whether reads of gather arrays are counted and checked.
    """
    may_reject = condition is not None or declared.text.has_word("discard")
    kinds = 2 + 2 * len(declared.gathers) if is_counted else int(may_reject)
    reads = reads_of(declared, condition)
    constants = (*declared.constants, *([""] if condition is not None else []))
    groups = _groups(declared)
    layout = ["uniform"] if constants else []
    layout += ["scatter"] if kinds else []
    lines = [*_resources(len(constants), kinds, reads, len(layout)), *_counting(kinds)]
    places = {id(stream): number for number, stream in enumerate(reads)}
    for number, (key, table) in enumerate(declared.gathers.items()):
        stream = table.stream(declared.opened)
        lines += _gather(key, table, stream, places[id(stream)], number, declared, is_counted)
    for number, group in enumerate(groups):
        lines += _entry(declared, condition, places, number, group, kinds)
    own = declared.text.with_word("discard", f"{PREFIX}reject()")
    return KernelProgram(
        "\n".join([own, "", *lines, shader_source("fullscreen.wgsl")]),
        (*layout, *(sampled(stream.format) for stream in reads)),
        reads,
        groups,
        may_reject,
        constants,
        kinds,
    )


def reads_of(declared: Declarations, condition: Condition | None = None) -> tuple[Stream, ...]:
    """Streams that a kernel reads, each once; a condition's own stream is the last."""
    streams: list[Stream] = [one for one in declared.inputs.values() if one is not INDEX]
    streams += [table.stream(declared.opened) for table in declared.gathers.values()]
    if condition is not None:
        assert isinstance(condition.stream, Stream)
        streams.append(condition.stream)
    return tuple({id(one): one for one in streams}.values())


def _groups(declared: Declarations) -> tuple[tuple[int, ...], ...]:
    """Outputs that one draw can write: adapters limit their number, and the bytes per pixel."""
    limits = declared.opened.limits
    most = limits["max-color-attachments"]
    room = limits["max-color-attachment-bytes-per-sample"]
    groups: list[list[int]] = [[]]
    taken = 0
    for number, stream in enumerate(declared.outputs):
        size = 4 * _channels(stream)
        if groups[-1] and (taken + size > room or len(groups[-1]) == most):
            groups.append([])
            taken = 0
        groups[-1].append(number)
        taken += size
    return tuple(map(tuple, groups))


def _channels(stream: Stream) -> int:
    return len(stream.format.partition("32")[0])


def _scalar(stream: Stream) -> str:
    return _SCALARS[sampled(stream.format)]


def _resources(constants: int, kinds: int, reads: tuple[Stream, ...], binding: int) -> list[str]:
    lines = []
    if constants:
        # Words: translators to other languages keep no padding of a structure's members.
        lines.append(
            f"@group(0) @binding(0) var<uniform> {PREFIX}constants: array<vec4u, {constants}>;"
        )
    if kinds:
        lines.append(
            f"@group(0) @binding({binding - 1}) var<storage, read_write> {PREFIX}counters: "
            f"array<atomic<u32>, {COUNTER_SLOTS * kinds}>;"
        )
    lines += [
        f"@group(0) @binding({binding + number}) var {PREFIX}texture_{number}: "
        f"texture_2d<{_scalar(stream)}>;"
        for number, stream in enumerate(reads)
    ]
    return lines


def _constant(place: int, type_: str) -> str:
    """The expression for a constant in the uniform."""
    components, _ = CONSTANT_TYPES[type_]
    return f"bitcast<{type_}>({PREFIX}constants[{place}]{_SWIZZLES[components]})"


def _counting(kinds: int) -> list[str]:
    """What the function's own code calls: rejection, and counters of the first draw."""
    lines = [
        f"var<private> {PREFIX}is_rejected: bool;",
        f"fn {PREFIX}reject() {{ {PREFIX}is_rejected = true; }}",
    ]
    if kinds:
        lines += [
            f"var<private> {PREFIX}is_counted: bool;",
            f"var<private> {PREFIX}slot: u32;",
            f"fn {PREFIX}count(kind: u32) {{",
            f"    if {PREFIX}is_counted {{",
            f"        atomicAdd(&{PREFIX}counters[kind * {COUNTER_SLOTS}u + {PREFIX}slot], 1u);",
            "    }",
            "}",
        ]
    return lines


def _gather(
    key: str,
    table: GatherArray,
    stream: Stream,
    place: int,
    number: int,
    declared: Declarations,
    is_counted: bool,
) -> list[str]:
    """The function of a gather array, and its shape."""
    axes = range(len(table.shape))
    lengths = ", ".join(str(length) for length in table.shape)
    given = ", ".join(f"given_{axis}: i32" for axis in axes)
    record = type_of(stream.dtype, stream.component_count)
    lines = [
        f"const {key}_shape = array<i32, {len(table.shape)}>({lengths});",
        f"fn {key}({given}) -> {record} {{",
    ]
    lines += [
        f"    let i_{axis} = given_{axis} + select(0, {table.shape[axis]}, given_{axis} < 0);"
        for axis in axes
    ]
    if is_counted:
        inside = " && ".join(f"i_{axis} >= 0 && i_{axis} < {table.shape[axis]}" for axis in axes)
        wrong = 2 + len(declared.gathers) + number
        lines += [
            f"    {PREFIX}count({2 + number}u);",
            f"    if !({inside}) {{ {PREFIX}count({wrong}u); }}",
        ]
    steps = [math.prod(table.shape[axis + 1 :]) for axis in axes]
    terms = [f"i_{axis} * {step}" for axis, step in zip(axes, steps, strict=True)]
    lines += [
        f"    let flat = {' + '.join(terms)};",
        f"    let at = vec2i(flat & {stream.size[0] - 1}, flat >> {_shift(stream)}u);",
        f"    return {_load(place, 'at', stream)};",
        "}",
    ]
    return lines


def _entry(
    declared: Declarations,
    condition: Condition | None,
    places: dict[int, int],
    number: int,
    group: tuple[int, ...],
    kinds: int,
) -> list[str]:
    """The entry point that draws a group of outputs.

    The draw covers whole rows, so that the last one may have texels of no record. Names have the
    prefix, as others could hide the function.
    """
    first = declared.outputs[0]
    at, i, result = f"{PREFIX}at", f"{PREFIX}i", f"{PREFIX}result"
    targets = f"{PREFIX}Targets_{number}"
    lines = [f"struct {targets} {{"]
    for place, output in enumerate(group):
        stream = declared.outputs[output]
        type_ = of_components(_scalar(stream), _channels(stream))
        lines.append(f"    @location({place}) target_{place}: {type_},")
    lines += [
        "}",
        "@fragment",
        f"fn {PREFIX}draw_{number}(@builtin(position) {PREFIX}texel: vec4f) -> {targets} {{",
        f"    let {at} = vec2i({PREFIX}texel.xy);",
        f"    let {i} = ({at}.y << {_shift(first)}u) | {at}.x;",
        f"    if {i} >= {len(first)} {{ discard; }}",
    ]
    if condition is not None:
        assert isinstance(condition.stream, Stream)
        value = _load(places[id(condition.stream)], at, condition.stream)
        compared = _constant(len(declared.constants), type_of(condition.stream.dtype, 1))
        lines.append(f"    if !({value} {condition.operation} {compared}) {{ discard; }}")
    if kinds:
        lines += [
            f"    {PREFIX}is_counted = {'false' if number else 'true'};",
            f"    {PREFIX}slot = u32({i}) & {COUNTER_SLOTS - 1}u;",
        ]
    if kinds > 1:
        lines.append(f"    {PREFIX}count(1u);")
    arguments = [_argument(declared, one, places) for one in declared.function.parameters]
    lines.append(f"    let {result} = {declared.function.name}({', '.join(arguments)});")
    counted = f"else {{ {PREFIX}count(0u); }}" if kinds else ""
    lines.append(f"    if {PREFIX}is_rejected {{ discard; }} {counted}")
    values = [_target(declared, output, result) for output in group]
    return [*lines, f"    return {targets}({', '.join(values)});", "}"]


def _shift(stream: Stream) -> int:
    """The binary logarithm of its texture's width."""
    return stream.size[0].bit_length() - 1


def _argument(declared: Declarations, parameter: Member, places: dict[int, int]) -> str:
    """The expression for a parameter of the function."""
    if parameter.name in declared.constants:
        return _constant([*declared.constants].index(parameter.name), parameter.type)
    stream = declared.inputs[parameter.name]
    if stream is INDEX:
        return f"{parameter.type}({PREFIX}i)"
    return _load(places[id(stream)], f"{PREFIX}at", stream)


def _load(place: int, at: str, stream: Stream) -> str:
    """The expression for a record of a stream."""
    return f"textureLoad({PREFIX}texture_{place}, {at}, 0){_SWIZZLES[stream.component_count]}"


def _target(declared: Declarations, output: int, result: str) -> str:
    """The texel of an output: records of three numbers get a fourth."""
    stream = declared.outputs[output]
    value = f"{result}.{declared.fields[output]}" if declared.fields else result
    if stream.component_count == _channels(stream):
        return value
    return f"{of_components(_scalar(stream), 4)}({value}, {_scalar(stream)}())"
