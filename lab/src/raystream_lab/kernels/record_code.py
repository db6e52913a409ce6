"""Compile a traversal kernel for one record: state in, state out."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.inspect import Code, assume, compile_code
from raystream.kernels.hits import HitAddresses
from raystream.machines.ray_streams import declared_as
from raystream.machines.records import FOUND, RAY, SHADE_HITS, WANTED, StepArguments
from raystream.machines.steps import Steps
from raystream.streams import Stream
from raystream.streams.declarations import declare

#: Numbers of a query that select what is compiled.
_QUERY_CHOICES = {"surfaces", "shaded_hits", "tallies", "runs", "steps", "tests"}

_NOWHERE = np.uint64(0)


class RecordCode(NamedTuple):
    """A kernel compiled for one record.

    Attributes
    ----------
    code : Code
    names : dict of str to str
        Our names of the compiler's arguments: ``"ray"``, ``"wanted"``, ``"found"``, ``"place"`` and
        ``"state"`` for streams, and such as ``"tree.corners"`` and ``"query.hits.t"`` for numbers.
    """

    code: Code
    names: dict[str, str]


def first_hit_query(
    max_coordinate: float = 1.0,
    hits: HitAddresses | None = None,
    stacks: int = 0,
    stack_bytes: int = 0,
) -> StepArguments:
    """The multipass machine's arguments to kernels for first hits without counters.

    Parameters
    ----------
    max_coordinate : float
        See `kernels.ray.prepare_ray`.
    hits : HitAddresses, optional
        Without it, kernels can be compiled but not run.
    stacks, stack_bytes : int
        See `StepArguments`.
    """
    return StepArguments(
        np.float32(max_coordinate),
        False,
        SHADE_HITS,
        HitAddresses(*(_NOWHERE,) * 4) if hits is None else hits,
        _NOWHERE,
        _NOWHERE,
        np.uint64(stacks),
        np.uint64(stack_bytes),
        ONE_U64,
        ONE_U64,
    )


def make_streams(steps: Steps, count: int) -> dict[str, Stream]:
    """Streams of zeros for the ray state of a traversal."""
    dtypes = {"ray": RAY, "wanted": WANTED, "found": FOUND, "place": steps.place}
    streams = {name: Stream.zeros(count, dtype, name=name) for name, dtype in dtypes.items()}
    streams["state"] = Stream.zeros(count, np.uint8, name="state")
    return streams


def compile_steps(
    steps: Steps,
    number: int,
    *,
    is_looping: bool = False,
    is_in_place: bool = True,
) -> RecordCode:
    """Compile a kernel of a traversal for one record, for first hits.

    Function, inputs and outputs are those of the multipass machine's kernel; the loop over records
    and its condition are omitted, as in a program of graphics hardware. Numbers that select a
    query, a traversal or counting are constants "placed within the kernel code" (Purcell 2002,
    section 3.1), so that the code of other choices is removed.

    Parameters
    ----------
    steps : Steps
    number : int
        Index of the kernel.
    is_looping : bool
        Keep the number of steps per pass variable, so that the code has the loop over steps; else
        compile one step.
    is_in_place : bool
        Write the streams that it reads, as the machine does: unchanged fields are then neither read
        nor written. Else write other streams of the same kind.

    Returns
    -------
    RecordCode
    """
    one = steps.kernels[number]
    streams = make_streams(steps, 1)
    written = streams if is_in_place else make_streams(steps, 1)
    given = declared_as(steps, first_hit_query(), number, streams, written)
    declared = declare(
        one.name, one.function, given["inputs"], given["outputs"], None, given["constants"]
    )
    source = declared.source()
    variable: set[str] = {"steps", "tests"} if is_looping else set()
    literals = {"query": _QUERY_CHOICES - variable, "tree": {"traversal"}}
    known: dict[str, Any] = {"function": one.function, "assume": assume, "uint64": np.uint64}
    known |= source.names()
    lines: list[str] = []
    call = []
    for key, value in declared.constants.items():
        shown = dict(declared.bindings)[key]
        shown = _frozen(key, shown, value, literals.get(key, set()), known, lines)
        call.append(f"{key}={shown}")
    for argument in source.arguments()[: len(source.inputs)]:
        key, _, record = argument.partition("=")
        lines.append(f"{key} = {record}")
        call.append(f"{key}={key}")
    has_one_level = getattr(steps.tree, "children", None) == _NOWHERE
    if has_one_level and "place=place" in call:
        lines.append("assume(place.outer == -1)")  # a one-level grid has no outer cells
    parameters = ["i", *source.parameters()[2:]]
    text = [
        f"def one_record({', '.join(parameters)}):",
        *(f"    {line}" for line in lines),
        f"    result = function({', '.join(call)})",
        *(f"    {line}" for line in source.stores()),
    ]
    exec("\n".join(text) + "\n", known)
    arguments = declared.streams()
    values = [np.uint64(0), *(stream.array for stream in arguments), *declared.constants.values()]
    names = {f"stream_{k}": str(stream.name) for k, stream in enumerate(arguments)}
    for key, value in declared.constants.items():
        names |= _members(dict(declared.bindings)[key], key, value)
    return RecordCode(compile_code(known["one_record"], values), names)


def _frozen(
    key: str,
    shown: str,
    value: Any,
    members: set[str],
    known: dict[str, Any],
    lines: list[str],
) -> str:
    """An expression for a constant with `members`, and a tree's zeros, as literals."""
    if not hasattr(value, "_fields"):
        return f"uint64({int(value)})"
    known[f"Made_{key}"] = type(value)
    parts = []
    for field, part in zip(value._fields, value, strict=True):
        place = f"{shown}.{field}"
        is_number = isinstance(part, bool | np.uint64)
        if is_number and (field in members or (key == "tree" and part == 0)):
            parts.append(f"uint64({int(part)})" if isinstance(part, np.uint64) else str(part))
            continue
        if isinstance(part, np.uint64) and key == "tree":
            lines.append(f"assume({place} != uint64(0))")
        parts.append(place)
    return f"Made_{key}({', '.join(parts)})"


def _members(shown: str, name: str, value: Any) -> dict[str, str]:
    """The compiler's names of a flattened constant's numbers."""
    if not isinstance(value, tuple):
        return {shown: name}
    fields = getattr(value, "_fields", range(len(value)))
    names: dict[str, str] = {}
    for k, (field, part) in enumerate(zip(fields, value, strict=True)):
        names |= _members(f"{shown}.{k}", f"{name}.{field}", part)
    return names
