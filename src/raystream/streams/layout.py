"""Layouts: the type of a record, and the code that reads and writes it."""

from __future__ import annotations

import keyword
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Most components of a vector: a loop has a variable for each.
MAX_COMPONENTS = 16

#: Bytes of a word, the unit in which memory traffic is counted.
WORD_BYTES = 4

#: Numbers that kernels compute with.
_NUMBERS = frozenset(
    ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")
    + ("float32", "float64", "complex64", "complex128")
)


@dataclass(frozen=True)
class Layout:
    """The type of one record of an array.

    Attributes
    ----------
    dtype : dtype
        The dtype of the array.
    component_count : int
        Length of a vector; 0 for numbers and for records with fields.
    """

    dtype: np.dtype[Any]
    component_count: int = 0

    @property
    def word_count(self) -> int:
        """Words of 4 bytes of a record, rounded up."""
        return -(-self.dtype.itemsize * max(1, self.component_count) // WORD_BYTES)

    @property
    def record(self) -> Any:
        """The named tuple of a record with fields; None for other records."""
        return None if self.dtype.names is None else _record_class(self.dtype.names)

    @property
    def shape(self) -> Any:
        """The types of a record: a dtype's name, or a tuple of them for its parts."""
        if self.dtype.names is None:
            if self.component_count:
                return (self.dtype.name,) * self.component_count
            return self.dtype.name
        return tuple(_field_shape(self.dtype[name]) for name in self.dtype.names)

    def load(self, array: str, index: Sequence[str], record: str) -> str:
        """The expression for one record.

        Parameters
        ----------
        array : str
            Name of the array.
        index : sequence of str
            Expressions, one for each dimension.
        record : str
            Name of the named tuple.
        """
        at = ", ".join(index)
        if self.component_count:
            return _tuple([f"{array}[{at}, {k}]" for k in range(self.component_count)])
        if self.dtype.names is None:
            return f"{array}[{at}]"
        fields = [_load_field(f"{array}[{at}]", name, self.dtype) for name in self.dtype.names]
        return f"{record}({', '.join(fields)})"

    def store(self, array: str, index: str, value: str) -> list[str]:
        """The statements that write one record."""
        if self.component_count:
            return [f"{array}[{index}, {k}] = {value}[{k}]" for k in range(self.component_count)]
        if self.dtype.names is None:
            return [f"{array}[{index}] = {value}"]
        lines = []
        for k, name in enumerate(self.dtype.names):
            place, length = f"{array}[{index}][{name!r}]", _length(self.dtype[name])
            if length:
                lines += [f"{place}[{j}] = {value}[{k}][{j}]" for j in range(length)]
            else:
                lines.append(f"{place} = {value}[{k}]")
        return lines

    def copy(self, target: str, source: str, index: str) -> list[str]:
        """The statements that copy one record from another array of this layout."""
        if self.component_count:
            return [
                f"{target}[{index}, {k}] = {source}[{index}, {k}]"
                for k in range(self.component_count)
            ]
        return [f"{target}[{index}] = {source}[{index}]"]


def native_array(name: str, values: Any, dtype: Any = None) -> NDArray[Any]:
    """View values as a plain array in the machine's byte order.

    Raises
    ------
    TypeError
        If they cannot be read as an array.
    """
    try:
        array = np.asarray(values, dtype)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: cannot be read as an array ({error})") from error
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def find_layout(name: str, array: NDArray[Any], vectors: bool) -> Layout:
    """The layout of an array's records.

    Parameters
    ----------
    name : str
        For errors.
    array : ndarray
    vectors : bool
        Whether the last axis holds the components of vectors.

    Raises
    ------
    TypeError
        If kernels cannot compute with the dtype.
    ValueError
        If vectors are too long or empty, or a field's name is not an identifier.
    """
    names = array.dtype.names
    if names is None:
        _check_number(name, array.dtype)
    else:
        for field in names:
            _check_field(name, field, array.dtype[field])
    if not vectors:
        return Layout(array.dtype)
    if names is not None:
        raise TypeError(f"{name}: records with fields cannot be components of a vector")
    return Layout(array.dtype, _check_length(name, array.shape[-1]))


def _check_number(name: str, dtype: np.dtype[Any]) -> None:
    if dtype.name not in _NUMBERS:
        raise TypeError(
            f"{name}: kernels do not compute with dtype {dtype}; use bool, integers, float32, "
            "float64, complex64 or complex128"
        )


def _check_field(name: str, field: str, dtype: np.dtype[Any]) -> None:
    if not field.isidentifier() or keyword.iskeyword(field) or field.startswith("_"):
        raise ValueError(f"{name}: the field {field!r} needs a name that can follow a dot")
    if dtype.names is not None or len(dtype.shape) > 1:
        raise TypeError(f"{name}: the field {field!r} must be a number or a vector")
    _check_number(f"{name}, field {field!r}", dtype.base)
    if dtype.shape:
        _check_length(f"{name}, field {field!r}", dtype.shape[0])


def _check_length(name: str, length: int) -> int:
    if not 1 <= length <= MAX_COMPONENTS:
        raise ValueError(
            f"{name}: expected vectors of 1 to {MAX_COMPONENTS} components, got {length}"
        )
    return length


def _length(field: np.dtype[Any]) -> int:
    return field.shape[0] if field.shape else 0


def _field_shape(field: np.dtype[Any]) -> Any:
    return (field.base.name,) * field.shape[0] if field.shape else field.name


def _load_field(place: str, name: str, dtype: np.dtype[Any]) -> str:
    length = _length(dtype[name])
    if length:
        return _tuple([f"{place}[{name!r}][{k}]" for k in range(length)])
    return f"{place}[{name!r}]"


def _tuple(parts: Sequence[str]) -> str:
    return f"({', '.join(parts)},)"


@cache
def _record_class(names: tuple[str, ...]) -> Any:
    """One class for each set of names, so that kernels share compiled code."""
    return namedtuple("Record", names)
