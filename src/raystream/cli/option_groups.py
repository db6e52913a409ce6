"""Groups of options: dataclasses that Typer sees as one option per field."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any


def expand_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Let a command take groups of options.

    A group is a parameter whose type is a dataclass. Its fields are options, spelled as for
    Typer, or groups themselves. Typer sees all options in order, and the command gets each
    group as one value.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters = [one for given in signature.parameters.values() for one in _options(given)]

    @functools.wraps(command)
    def with_groups(**options: Any) -> None:
        values = signature.parameters.values()
        command(**{one.name: _assembled(one, options) for one in values})

    with_groups.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    with_groups.__annotations__ = {one.name: one.annotation for one in parameters}
    return with_groups


def options_given(group: Any) -> dict[str, Any]:
    """Return the options of a group that differ from their defaults, by name."""
    given: dict[str, Any] = {}
    for field in _fields(group.__class__):
        value = getattr(group, field.name)
        if _is_group(value):
            given |= options_given(value)
        elif value != field.default:
            given[field.name] = value
    return given


def _is_group(value: Any) -> bool:
    return dataclasses.is_dataclass(value)


@functools.cache
def _fields(group: Any) -> tuple[inspect.Parameter, ...]:
    """Return the fields of a group as parameters."""
    types = typing.get_type_hints(group, include_extras=True)
    return tuple(
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty
            if field.default is dataclasses.MISSING
            else field.default,
            annotation=types[field.name],
        )
        for field in dataclasses.fields(group)
    )


def _options(parameter: inspect.Parameter) -> Iterator[inspect.Parameter]:
    """Iterate over the options that a parameter stands for."""
    if _is_group(parameter.annotation):
        for field in _fields(parameter.annotation):
            yield from _options(field)
    else:
        yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)


def _assembled(parameter: inspect.Parameter, options: Mapping[str, Any]) -> Any:
    """Return a parameter's value: an option, or a group of them."""
    group = parameter.annotation
    if not _is_group(group):
        return options[parameter.name]
    return group(**{field.name: _assembled(field, options) for field in _fields(group)})
