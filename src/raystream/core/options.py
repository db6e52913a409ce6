"""Options: frozen dataclasses whose annotations declare the allowed values."""

from __future__ import annotations

import math
import operator
import types
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Self,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)


class Range(NamedTuple):
    """Limits of a number, both included; for an annotation, as ``Annotated[int, Range(1, 32)]``.

    Attributes
    ----------
    least, most : float
    """

    least: float
    most: float = math.inf

    def check(self, name: str, number: float) -> None:
        """Raise ValueError if a number is outside, or NaN."""
        if self.least <= number <= self.most:
            return
        if self.most == math.inf:
            raise ValueError(f"{name}: expected at least {_text(self.least)}, got {number}")
        raise ValueError(
            f"{name}: expected {_text(self.least)} to {_text(self.most)}, got {number}"
        )


@dataclass(frozen=True, kw_only=True)
class Options:
    """Named values with defaults, checked when they are given.

    A subclass is a frozen dataclass with only keyword arguments. Values of ``Literal[...]`` must
    be one of its names, those of ``int``, ``float`` and ``bool`` are converted and must lie in
    the `Range` that ``Annotated`` gives; ``| None`` allows None. Other annotations are for the
    subclass to check, in ``__post_init__``.

    Attributes
    ----------
    name : str
        Name of the choice that has these options; a class attribute.

    Raises
    ------
    ValueError
        If a value is out of range or not one of the names.
    TypeError
        If a value is not a number, or not an integer where one is needed.
    """

    name: ClassVar[str]

    def __post_init__(self) -> None:
        for name, rule in _rules(cast("Any", type(self))).items():
            object.__setattr__(self, name, rule.checked(name, getattr(self, name)))

    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        usual = {field.name: field.default for field in fields(self)}
        return {name: value for name, value in values.items() if value != usual[name]}

    def as_json(self) -> dict[str, Any]:
        """All options, as JSON values; `from_json` reads them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Read the options that `as_json` returned.

        Raises
        ------
        ValueError
            If they are not options of this class, or out of range.
        """
        if not isinstance(values, Mapping) or set(values) != set(cls.names()):
            raise ValueError(f"invalid options: expected {', '.join(cls.names()) or 'none'}")
        try:
            return cls(**values)
        except (TypeError, OverflowError) as error:
            raise ValueError(f"invalid options: {error}") from None

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The names of the options."""
        return tuple(field.name for field in fields(cls))

    @classmethod
    def choices(cls, name: str) -> tuple[str, ...]:
        """The names that an option takes as values, the default first; empty if it takes none."""
        rule = _rules(cast("Any", cls)).get(name)
        if rule is None or not rule.choices:
            return ()
        usual: Any = next(field.default for field in fields(cls) if field.name == name)
        return (usual, *(one for one in rule.choices if one != usual))


class _Rule(NamedTuple):
    """The values that an annotation allows: names, or numbers of a type within a range."""

    choices: tuple[str, ...] = ()
    kind: type | None = None
    range: Range | None = None
    may_be_none: bool = False

    def checked(self, name: str, value: Any) -> Any:
        if value is None and self.may_be_none:
            return None
        if self.choices:
            if not isinstance(value, str | int) or value not in self.choices:
                known = ", ".join(map(repr, self.choices))
                raise ValueError(f"{name}: expected one of {known}, got {value!r:.80}")
            return value
        if self.kind is None:
            return value
        try:
            number = operator.index(value) if self.kind is int else self.kind(value)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name}: {error}") from None
        if self.range is not None:
            self.range.check(name, number)
        return number


@cache
def _rules(options: Any) -> dict[str, _Rule]:
    hints = get_type_hints(options, include_extras=True)
    return {field.name: _rule_of(hints[field.name]) for field in fields(options)}


def _rule_of(hint: Any) -> _Rule:
    limits = None
    if get_origin(hint) is Annotated:
        hint, *extras = get_args(hint)
        limits = next((one for one in extras if isinstance(one, Range)), None)
    kinds = set(get_args(hint)) if get_origin(hint) in (Union, types.UnionType) else {hint}
    may_be_none = type(None) in kinds
    kinds.discard(type(None))
    if len(kinds) != 1:
        return _Rule()
    (kind,) = kinds
    if get_origin(kind) is Literal:
        return _Rule(choices=get_args(kind), may_be_none=may_be_none)
    if kind in (bool, int, float):
        return _Rule(kind=kind, range=limits, may_be_none=may_be_none)
    return _Rule()


def _text(limit: float) -> str:
    """A limit in short form: 32, 0.5, 1e-6."""
    if isinstance(limit, int):
        return f"{limit}"
    return f"{limit:g}".replace("e-0", "e-").replace("e+0", "e")
