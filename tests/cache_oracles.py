"""Caches in the plainest Python, as references for the simulator."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator

#: A reference: address, length in bytes, kind.
Reference = tuple[int, int, int]


def lines_of(references: Iterable[Reference], line_size: int) -> Iterator[tuple[int, int]]:
    """Each access of a trace: line and kind."""
    for address, length, kind in references:
        for line in sorted({byte // line_size for byte in range(address, address + length)}):
            yield line, kind


def lru_misses(references, size: int, line_size: int, ways: int | None) -> Counter[int]:
    """Misses by kind of a cache that drops the least recently used line of a set."""
    line_count = size // line_size
    ways = ways or line_count
    sets = [OrderedDict() for _ in range(line_count // ways)]
    misses: Counter[int] = Counter()
    for line, kind in lines_of(references, line_size):
        lines = sets[line % len(sets)]
        if line in lines:
            lines.move_to_end(line)
            continue
        misses[kind] += 1
        lines[line] = None
        if len(lines) > ways:
            lines.popitem(last=False)
    return misses


def direct_misses(references, size: int, line_size: int) -> Counter[int]:
    """Misses by kind of a direct-mapped cache."""
    held: dict[int, int] = {}
    misses: Counter[int] = Counter()
    for line, kind in lines_of(references, line_size):
        place = line % (size // line_size)
        misses[kind] += held.get(place) != line
        held[place] = line
    return misses


def stack_distances(references, line_size: int) -> tuple[Counter[tuple[int, int]], Counter[int]]:
    """Number of accesses by (kind, distance), and of first accesses by kind."""
    stack: list[int] = []  # the latest line last
    distances: Counter[tuple[int, int]] = Counter()
    first: Counter[int] = Counter()
    for line, kind in lines_of(references, line_size):
        if line in stack:
            place = stack.index(line)
            distances[kind, len(stack) - 1 - place] += 1
            del stack[place]
        else:
            first[kind] += 1
        stack.append(line)
    return distances, first
