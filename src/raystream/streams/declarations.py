"""The streams, gather arrays and constants of a kernel, checked against its function."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from raystream.streams.constants import as_constant
from raystream.streams.gather import GatherArray
from raystream.streams.layout import Layout
from raystream.streams.record_stream import RecordStream
from raystream.streams.source import KernelSource
from raystream.streams.stream import Stream


class _Index:
    def __repr__(self) -> str:
        return "INDEX"


#: As an input: the position of the record, an int64.
INDEX = _Index()


@dataclass
class Declarations:
    """A kernel's streams, gather arrays and constants.

    Attributes
    ----------
    inputs : dict of str to Stream or INDEX
    outputs : list of Stream
    is_single : bool
        Whether the function returns one record, not a tuple with one for each output.
    gathers : dict of str to GatherArray
        With members of named tuples, as ``"table.member"``.
    constants : dict of str to number or tuple
        Likewise.
    bindings : list of (str, str)
        Parameters of the function, and the loop's expressions for them.
    groups : list of (tuple of str, type)
        Fields and class of the named tuples.
    """

    inputs: dict[str, Any]
    outputs: list[Stream]
    is_single: bool
    gathers: dict[str, GatherArray] = field(default_factory=dict)
    constants: dict[str, Any] = field(default_factory=dict)
    bindings: list[tuple[str, str]] = field(default_factory=list)
    groups: list[tuple[tuple[str, ...], type]] = field(default_factory=list)

    def streams(self) -> list[Stream]:
        """Inputs and outputs, each once."""
        streams = {id(one): one for one in self.inputs.values() if isinstance(one, Stream)}
        streams.update({id(one): one for one in self.outputs})
        return list(streams.values())

    def source(self) -> KernelSource:
        """The source of the loop."""
        streams = self.streams()
        place = {id(stream): k for k, stream in enumerate(streams)}
        gathered = {id(gather.stream) for gather in self.gathers.values()}
        return KernelSource(
            tuple(stream.layout for stream in streams),
            tuple((key, place.get(id(stream))) for key, stream in self.inputs.items()),
            tuple((place[id(stream)], id(stream) in gathered) for stream in self.outputs),
            tuple((key, gather.layout, len(gather.shape)) for key, gather in self.gathers.items()),
            len(self.constants),
            tuple(self.bindings),
            tuple(self.groups),
            self.is_single,
        )

    def name_of(self, stream: RecordStream) -> str | None:
        """The stream's own name, else that of the parameter that reads it."""
        keys = [key for key, one in self.inputs.items() if one is stream]
        return stream.name or (keys[0] if keys else None)

    def layout_of(self, gather: GatherArray) -> Layout:
        """Records of a gather array."""
        return gather.layout

    def add_gather(self, name: str, key: str, value: Any) -> None:
        """Declare a gather array, or a named tuple of gather arrays and constants."""
        fields = getattr(value, "_fields", None)
        if fields is None:
            self.bindings.append((key, self._gather(key, value)))
            return
        members = []
        for member, part in zip(fields, value, strict=True):
            place = f"{key}.{member}"
            if isinstance(part, np.ndarray | Stream | GatherArray):
                members.append(self._gather(place, part))
            else:
                members.append(self._constant(f"{name}, {place}", place, part))
        self.bindings.append((key, f"Group_{len(self.groups)}({', '.join(members)})"))
        self.groups.append((fields, type(value)))

    def add_constant(self, name: str, key: str, value: Any) -> None:
        """Declare a constant."""
        self.bindings.append((key, self._constant(f"{name}, constant {key!r}", key, value)))

    def _gather(self, key: str, value: Any) -> str:
        self.gathers[key] = value if isinstance(value, GatherArray) else GatherArray(value)
        return f"gather_{len(self.gathers) - 1}"

    def _constant(self, label: str, key: str, value: Any) -> str:
        self.constants[key] = as_constant(label, value)
        return f"constant_{len(self.constants) - 1}"


def declare(
    name: str,
    function: Callable[..., Any],
    inputs: Mapping[str, Any] | None,
    outputs: Stream | Sequence[Stream],
    gathers: Mapping[str, Any] | None,
    constants: Mapping[str, Any] | None,
) -> Declarations:
    """Check the arguments of `Kernel`.

    Raises
    ------
    TypeError, ValueError
        See `Kernel`.
    """
    written = [outputs] if isinstance(outputs, Stream) else list(outputs)
    declared = Declarations(dict(inputs or {}), written, isinstance(outputs, Stream))
    _check_parameters(name, function, [*(inputs or {}), *(gathers or {}), *(constants or {})])
    for key, value in (gathers or {}).items():
        declared.add_gather(name, key, value)
    for key, value in (constants or {}).items():
        declared.add_constant(name, key, value)
    check_streams(name, declared.inputs, declared.outputs, Stream, _expected)
    for key, gather in declared.gathers.items():
        if gather.stream is None and any(s.shares_memory(gather.array) for s in written):
            raise ValueError(
                f"{name}, gather array {key!r}: is the array of a stream that the kernel "
                "writes; give it the stream instead"
            )
    return declared


def check_streams(
    name: str,
    inputs: Mapping[str, Any],
    outputs: Sequence[Any],
    kind: type[RecordStream],
    wrong: Callable[[str, object], str],
) -> None:
    """Check the streams of a kernel, on any device.

    Parameters
    ----------
    name : str
        Of the kernel.
    inputs : mapping of str to stream or INDEX
    outputs : sequence of stream
    kind : type
        The device's streams.
    wrong : callable
        Says what was expected and what is there instead.

    Raises
    ------
    TypeError, ValueError
        See `Kernel`.
    """
    for key, stream in inputs.items():
        if stream is not INDEX and not isinstance(stream, kind):
            raise TypeError(f"{name}, input {key!r}: {wrong('a Stream', stream)}")
    if not outputs:
        raise ValueError(f"{name}: a kernel writes at least one stream")
    for stream in outputs:
        if not isinstance(stream, kind):
            raise TypeError(f"{name}, outputs: {wrong('streams', stream)}")
    if len({id(stream) for stream in outputs}) < len(outputs):
        raise ValueError(f"{name}: writes a stream twice")
    streams = [*inputs.values(), *outputs]
    lengths = {len(stream) for stream in streams if stream is not INDEX}
    if len(lengths) > 1:
        found = ", ".join(f"{length:,}" for length in sorted(lengths))
        raise ValueError(f"{name}: its streams differ in length: {found} records")


def _check_parameters(name: str, function: Callable[..., Any], declared: list[str]) -> None:
    for key in declared:
        if declared.count(key) > 1:
            raise TypeError(f"{name}: {key!r} is declared twice")
    python = getattr(function, "py_func", function)
    if not inspect.isfunction(python):
        raise TypeError(f"{name}: expected a Python function, got {python!r:.60}")
    parameters = inspect.signature(python).parameters
    for key, parameter in parameters.items():
        if parameter.kind is not inspect.Parameter.POSITIONAL_OR_KEYWORD:
            raise TypeError(f"{name}: the parameter {parameter} must have a plain name")
        if parameter.default is inspect.Parameter.empty and key not in declared:
            raise TypeError(f"{name}: parameter {key!r} is not an input, gather array or constant")
    for key in declared:
        if key not in parameters:
            raise TypeError(f"{name}: the function has no parameter {key!r}")


def _expected(wanted: str, value: object) -> str:
    kind = type(value)
    is_elsewhere = isinstance(value, RecordStream)  # of another device
    got = f"a {kind.__name__} of {kind.__module__}" if is_elsewhere else kind.__name__
    return f"expected {wanted}, got {got}"
