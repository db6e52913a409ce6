"""PLY values: the numbers of each element, from text or binary data."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.ply_layout import Element
from raystream.scene.io.text import Lines, parse_floats, plain_text, shown


@dataclass
class Values:
    """The values of one element.

    Attributes
    ----------
    scalars : dict of str to ndarray of shape (count,)
        By property.
    lists : dict of str to (counts, values)
        The length of each row's list, and all lists concatenated.
    """

    scalars: dict[str, NDArray[Any]] = field(default_factory=dict)
    lists: dict[str, tuple[NDArray[np.int64], NDArray[Any]]] = field(default_factory=dict)


def read_values(
    path: Path, content: bytes, encoding: str, elements: list[Element], start: int
) -> dict[str, Values]:
    """Read all elements; the last of elements with the same name counts.

    Parameters
    ----------
    path : Path
        The file, for messages.
    content : bytes
        The whole file.
    encoding, elements, start
        From `read_header`.

    Returns
    -------
    dict of str to Values
        By element.

    Raises
    ------
    FileFormatError
        If the file has less than the header declares, or a value is not a number.

    Warns
    -----
    RaystreamWarning
        For numbers of text, and records of binary data, that the header does not declare.
    """
    if encoding != "ascii":
        binary = _Binary(path, content, start, encoding)
        found = _read_all(path, binary, elements)
        if elements and binary.remaining() >= max(_least_size(binary, elements[-1]), 1):
            warn_partial(
                path, f"dropped: {binary.remaining():,} bytes that the header does not declare"
            )
        return found
    text = _Text(path, plain_text(content[start:]))
    fault = FileFormatError(path, "is damaged: its rows have more numbers than the header declares")
    try:
        found = _read_all(path, text, elements)
        if not text.remaining():
            return found
    except FileFormatError as error:
        fault = error
    rows = text.read_rows(elements)
    if rows is None:
        raise fault
    return rows


def _read_all(path: Path, reader: _Text | _Binary, elements: list[Element]) -> dict[str, Values]:
    found = {}
    for element in elements:
        if element.properties and element.count:
            if element.count > reader.remaining() // _least_size(reader, element):
                raise _truncated(path, element)
            found[element.name] = reader.read(element)
        else:
            found[element.name] = _no_values(element)
    return found


def _least_size(reader: _Text | _Binary, element: Element) -> int:
    """The size of a record whose lists are empty."""
    return sum(reader.size(prop.count_type or prop.value_type) for prop in element.properties)


def _no_values(element: Element) -> Values:
    none, no_counts = np.empty(0), np.empty(0, np.int64)
    return Values(
        {prop.name: none for prop in element.properties if not prop.count_type},
        {prop.name: (no_counts, none) for prop in element.properties if prop.count_type},
    )


def _truncated(path: Path, element: Element) -> FileFormatError:
    return FileFormatError(
        path,
        f"is truncated: the header declares {element.count:,} of element "
        f"{shown(element.name.encode())}, which the file is too small to hold",
    )


class _Text:
    """Values as words; positions count words."""

    def __init__(self, path: Path, text: bytes) -> None:
        self.path, self.text = path, text
        self.position = 0
        try:
            self.numbers = parse_floats(text, len(text.split()))
        except ValueError:
            raise FileFormatError(path, "a value is not a number") from None

    def size(self, value_type: str) -> int:
        del value_type
        return 1

    def remaining(self) -> int:
        return len(self.numbers) - self.position

    def read(self, element: Element) -> Values:
        """Read an element: in one step if the lists of all rows are as long as the first's."""
        counts, width = self._first_row(element)
        if width * element.count <= self.remaining():
            stop = self.position + width * element.count
            table = self.numbers[self.position : stop].reshape(element.count, width)
            values = _columns(element, table, counts)
            if values is not None:
                self.position = stop
                return values
        return self._walk(element)

    def _first_row(self, element: Element) -> tuple[list[int], int]:
        counts, position = [], self.position
        for prop in element.properties:
            count = 0
            if prop.count_type and position < len(self.numbers):
                count = _list_count(self.path, self.numbers[position], self.remaining())
            counts.append(count)
            position += 1 + count if prop.count_type else 1
        return counts, position - self.position

    def _walk(self, element: Element) -> Values:
        numbers, position, limit = self.numbers, self.position, len(self.numbers)
        lists: dict[str, tuple[list[int], list[NDArray[Any]]]] = {
            prop.name: ([], []) for prop in element.properties if prop.count_type
        }
        places: dict[str, list[int]] = {
            prop.name: [] for prop in element.properties if not prop.count_type
        }
        for _ in range(element.count):
            for prop in element.properties:
                if position >= limit:
                    raise _truncated(self.path, element)
                if prop.count_type:
                    count = _list_count(self.path, numbers[position], limit)
                    lists[prop.name][0].append(count)
                    lists[prop.name][1].append(numbers[position + 1 : position + 1 + count])
                    position += count
                else:
                    places[prop.name].append(position)
                position += 1
        if position > limit:
            raise _truncated(self.path, element)
        self.position = position
        return Values(
            {name: numbers[found] for name, found in places.items()},
            {
                name: (np.asarray(counts, np.int64), np.concatenate(parts))
                for name, (counts, parts) in lists.items()
            },
        )

    def read_rows(self, elements: list[Element]) -> dict[str, Values] | None:
        """Read all elements with one row per line, and warn of numbers that are left over.

        Returns None unless each row has its line, with enough numbers.
        """
        counts = Lines(self.text).word_counts
        stops = np.cumsum(counts[counts > 0])
        found, first, extra = {}, 0, 0
        for element in elements:
            if not (element.properties and element.count):
                found[element.name] = _no_values(element)
                continue
            ends = stops[first : first + element.count]
            places = np.concatenate([[stops[first - 1] if first else 0], ends[:-1]])
            if len(ends) < element.count:
                return None
            values = Values()
            for prop in element.properties:
                if (places >= ends).any():
                    return None
                numbers = self.numbers[places]
                places = places + 1
                if not prop.count_type:
                    values.scalars[prop.name] = numbers
                    continue
                is_whole = numbers == np.floor(numbers)
                if not (is_whole & (numbers >= 0) & (numbers <= ends - places)).all():
                    return None
                lengths = numbers.astype(np.int64)
                values.lists[prop.name] = (lengths, self.numbers[_runs(places, lengths)])
                places = places + lengths
            found[element.name] = values
            extra += int((ends - places).sum())
            first += element.count
        extra += len(self.numbers) - int(stops[first - 1] if first else 0)
        warn_partial(self.path, f"dropped: {extra:,} numbers that the header does not declare")
        return found


def _runs(
    starts: NDArray[np.int64], lengths: NDArray[np.int64], step: int = 1
) -> NDArray[np.int64]:
    """The positions of lists, one after the other."""
    within = np.arange(int(lengths.sum())) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.repeat(starts, lengths) + within * step


def _list_count(path: Path, value: float, limit: int) -> int:
    if not 0 <= value <= limit or value != int(value):
        raise FileFormatError(path, f"invalid list length {value:g}")
    return int(value)


def _columns(element: Element, table: NDArray[Any], counts: list[int]) -> Values | None:
    """Split a table into properties; None if a list is not as long as in the first row."""
    values = Values()
    column = 0
    for prop, count in zip(element.properties, counts, strict=True):
        if prop.count_type:
            if not (table[:, column] == count).all():
                return None
            entries = table[:, column + 1 : column + 1 + count]
            values.lists[prop.name] = (np.full(len(table), count, np.int64), entries.reshape(-1))
            column += count
        else:
            values.scalars[prop.name] = table[:, column]
        column += 1
    return values


class _Binary:
    """Values as bytes; positions count bytes."""

    def __init__(self, path: Path, content: bytes, start: int, order: str) -> None:
        self.path = path
        self.content = content
        self.position = start
        self.order = order

    def size(self, value_type: str) -> int:
        return np.dtype(value_type).itemsize

    def remaining(self) -> int:
        return max(0, len(self.content) - self.position)

    def read(self, element: Element) -> Values:
        """Read an element: in one step if the lists of all rows are as long as the first's."""
        row = self._row_type(element)
        if row is not None and row.itemsize * element.count <= self.remaining():
            table = np.frombuffer(self.content, row, element.count, self.position)
            values = _fields(element, table)
            if values is not None:
                self.position += row.itemsize * element.count
                return values
        return self._walk(element)

    def _row_type(self, element: Element) -> np.dtype[Any] | None:
        """Describe the first row; None if its lists exceed the file."""
        fields: list[Any] = []
        position = self.position
        for index, prop in enumerate(element.properties):
            value_type = np.dtype(self.order + prop.value_type)
            if not prop.count_type:
                fields.append((f"{index}", value_type))
                position += value_type.itemsize
                continue
            count_type = np.dtype(self.order + prop.count_type)
            if position + count_type.itemsize > len(self.content):
                return None
            count = int(np.frombuffer(self.content, count_type, 1, position)[0])
            position += count_type.itemsize + count * value_type.itemsize
            if count < 0 or position > len(self.content) or count > 1 << 20:
                return None
            fields += [(f"{index}n", count_type), (f"{index}", value_type, (count,))]
        return np.dtype(fields)

    def _walk(self, element: Element) -> Values:
        content, position = self.content, self.position
        byte_order = "little" if self.order == "<" else "big"
        layout = [
            (
                self.size(p.count_type) if p.count_type else 0,
                p.count_type.startswith("i"),
                self.size(p.value_type),
                p.name,
            )
            for p in element.properties
        ]
        rows: dict[str, tuple[list[int], list[int]]] = {
            p.name: ([], []) for p in element.properties
        }
        for _ in range(element.count):
            for count_size, signed, value_size, name in layout:
                if count_size == 0:
                    rows[name][1].append(position)
                    position += value_size
                    continue
                raw = content[position : position + count_size]
                count = int.from_bytes(raw, byte_order, signed=signed)  # type: ignore[arg-type]
                if count < 0:
                    raise FileFormatError(self.path, f"invalid list length {count}")
                rows[name][0].append(count)
                rows[name][1].append(position + count_size)
                position += count_size + count * value_size
            if position > len(content):
                raise _truncated(self.path, element)
        self.position = position
        values = Values()
        for prop in element.properties:
            counts, starts = (np.asarray(column, np.int64) for column in rows[prop.name])
            if prop.count_type:
                values.lists[prop.name] = (counts, self._gather(counts, starts, prop.value_type))
            else:
                once = np.ones(len(starts), np.int64)
                values.scalars[prop.name] = self._gather(once, starts, prop.value_type)
        return values

    def _gather(
        self, counts: NDArray[np.int64], starts: NDArray[np.int64], value_type: str
    ) -> NDArray[Any]:
        """Gather lists at any offsets into one array."""
        size = self.size(value_type)
        places = _runs(starts, counts, size)
        letters = np.frombuffer(self.content, np.uint8)
        taken = letters[places[:, None] + np.arange(size)]
        return np.frombuffer(taken.tobytes(), self.order + value_type)


def _fields(element: Element, table: NDArray[Any]) -> Values | None:
    """Split a record array into properties; None if the lists differ in length."""
    values = Values()
    for index, prop in enumerate(element.properties):
        column = table[f"{index}"]
        if not prop.count_type:
            values.scalars[prop.name] = column
            continue
        counts = table[f"{index}n"]
        if not (counts == column.shape[1]).all():
            return None
        values.lists[prop.name] = (counts.astype(np.int64), column.reshape(-1))
    return values
