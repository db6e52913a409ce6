"""Conditions: the records that a kernel runs on, as by a stencil test."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from raystream.streams.record_stream import RecordStream

_OPERATIONS = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class Condition:
    """A comparison of a stream's records with a number, evaluated at each use.

    ``state == 2`` makes one. It takes no memory, and follows the stream's changes.

    Parameters
    ----------
    stream : Stream
        Of numbers.
    operation : str
        One of ``== != < <= > >=``.
    value : number
    """

    def __init__(self, stream: RecordStream, operation: str, value: Any) -> None:
        if stream.layout.shape != stream.dtype.name:
            raise TypeError(f"{stream.label}: only a stream of numbers can be compared")
        self.stream = stream
        self.operation = operation
        self.value = _number(stream, value)

    @property
    def array(self) -> NDArray[np.bool_]:
        """The current result for each record."""
        return _OPERATIONS[self.operation](self.stream.array, self.value)

    def count(self) -> int:
        """Number of records for which it holds."""
        return int(np.count_nonzero(self.array))

    def any(self) -> bool:
        """Whether it holds for some record."""
        return bool(self.array.any())

    def all(self) -> bool:
        """Whether it holds for every record."""
        return bool(self.array.all())

    def __bool__(self) -> NoReturn:
        raise TypeError("a condition has a value for each record: use any() or all()")

    def __repr__(self) -> str:
        return f"<Condition {self.stream.label} {self.operation} {self.value!r}>"


def _number(stream: RecordStream, value: Any) -> Any:
    """The value as one of few types, since a loop is compiled for each."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value) if -(2**63) <= value < 2**63 else np.uint64(value)
    if isinstance(value, float | np.floating):
        return float(value)
    raise TypeError(f"{stream.label}: compared with {type(value).__name__}; expected a number")
