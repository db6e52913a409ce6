"""Compile a traversal kernel for one record: state in, state out."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.inspect import Code, assume, compile_code
from raystream.kernels.hits import HitAddresses
from raystream.machines.ray_streams import declared_as
from raystream.machines.records import FOUND, RAY, WANTED, StepArguments
from raystream.machines.steps import Steps
from raystream.machines.steps.base import StepKernel
from raystream.streams import Stream
from raystream.streams.declarations import declare

__all__ = ["RecordCode", "compile_record", "compile_steps", "first_hit_query", "make_streams"]

#: Numbers of structures that select a traversal.
_CHOICES = ("traversal",)

#: Numbers of a query that do.
_QUERY_CHOICES = ("surfaces", "shades", "tallies", "runs", "steps", "tests")

_NOWHERE = np.uint64(0)
_ONE = np.uint64(1)


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
        True,
        HitAddresses(*(_NOWHERE,) * 4) if hits is None else hits,
        _NOWHERE,
        _NOWHERE,
        np.uint64(stacks),
        np.uint64(stack_bytes),
        _ONE,
        _ONE,
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
    is_general: bool = False,
    is_in_place: bool = True,
) -> RecordCode:
    """Compile a kernel of a traversal for one record, for first hits.

    Function, inputs and outputs are those of the multipass machine's kernel; the loop over records
    and its condition are omitted, as in a program of graphics hardware.

    Parameters
    ----------
    steps : Steps
    number : int
        Index of the kernel.
    is_looping : bool
        Keep the number of steps per pass variable, so that the code has the loop over steps; else
        compile one step.
    is_general : bool
        Keep all numbers variable, as the machine does, which compiles a kernel once for all queries
        and traversals, with or without counters. Else the numbers that select between these are
        constants "placed within the kernel code" (Purcell 2002, section 3.1), and the code of other
        choices, such as counting, is removed.
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
    query = first_hit_query()
    open_ = _QUERY_CHOICES[-2:] if is_looping else ()
    return compile_record(
        one.name,
        one.function,
        declared_as(steps, query, number, streams, written),
        None if is_general else {"query": tuple(set(_QUERY_CHOICES) - {*open_}), "tree": _CHOICES},
        () if is_general else _facts(steps, one),
    )


def _facts(steps: Steps, one: StepKernel) -> list[str]:
    """Known facts of a ray's place: in a one-level grid it has no outer cell."""
    reads_place = "place" in inspect.signature(one.function).parameters
    has_one_level = getattr(steps.tree, "children", None) == _NOWHERE
    return ["place.outer == -1"] if reads_place and has_one_level else []


def compile_record(
    name: str,
    function: Any,
    given: Mapping[str, Any],
    constants: Mapping[str, tuple[str, ...]] | None,
    facts: Sequence[str] = (),
) -> RecordCode:
    """Compile a kernel's function for one record.

    Parameters
    ----------
    name : str
    function : callable
    given : mapping
        ``inputs``, ``outputs`` and ``constants`` of a `streams.Kernel`.
    constants : mapping of str to tuple of str, optional
        For constants that are named tuples, the members to compile in; of addresses, only whether
        they are 0. Without it all stay variable.
    facts : sequence of str
        Known facts of its input records, as Python expressions.
    """
    declared = declare(name, function, given["inputs"], given["outputs"], None, given["constants"])
    source = declared.source()
    known: dict[str, Any] = {"function": function, "assume": assume, "uint64": np.uint64}
    known |= source.names()
    lines: list[str] = []
    call = []
    for key, value in declared.constants.items():
        shown = dict(declared.bindings)[key]
        if constants is not None:
            shown = _frozen(key, shown, value, constants.get(key, ()), known, lines)
        call.append(f"{key}={shown}")
    for argument in source.arguments()[: len(source.inputs)]:
        key, _, record = argument.partition("=")
        lines.append(f"{key} = {record}")
        call.append(f"{key}={key}")
    lines += [f"assume({fact})" for fact in facts]
    parameters = ["i", *source.parameters()[2:]]
    text = [
        f"def one_record({', '.join(parameters)}):",
        *(f"    {line}" for line in lines),
        f"    result = function({', '.join(call)})",
        *(f"    {line}" for line in source.stores()),
    ]
    exec("\n".join(text) + "\n", known)
    streams = declared.streams()
    values = [np.uint64(0), *(one.array for one in streams), *declared.constants.values()]
    names = {f"stream_{k}": str(one.name) for k, one in enumerate(streams)}
    for key, value in declared.constants.items():
        names |= _members(dict(declared.bindings)[key], key, value)
    return RecordCode(compile_code(known["one_record"], values), names)


def _frozen(
    key: str,
    shown: str,
    value: Any,
    members: tuple[str, ...],
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
