"""Reductions of a stream's records to one.

Records are folded in blocks of a fixed length, and the blocks' results in order, so that the
result does not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import parallel_for
from raystream.streams.source import compile_fold

if TYPE_CHECKING:
    from raystream.streams.record_stream import RecordStream

#: Records in a block. Sums of floats depend on it: another length rounds differently.
BLOCK = 1 << 14


def add_up(stream: RecordStream) -> Any:
    """See `Stream.sum`."""
    kinds = {"b": np.int64, "i": np.int64, "u": np.uint64, "f": np.float64, "c": np.complex128}
    dtype = kinds[_numbers(stream, "sum").dtype.kind]
    return _reduce(stream, lambda block: np.add.reduce(block, axis=0, dtype=dtype), np.add)


def least(stream: RecordStream) -> Any:
    """See `Stream.min`."""
    return _max_coordinate(stream, "min", np.minimum)


def greatest(stream: RecordStream) -> Any:
    """See `Stream.max`."""
    return _max_coordinate(stream, "max", np.maximum)


def count_nonzero(stream: RecordStream) -> Any:
    """See `Stream.count`."""
    _numbers(stream, "count")
    return _reduce(stream, lambda block: np.count_nonzero(block, axis=0), np.add)


def fold(stream: RecordStream, function: Callable[..., Any], initial: Any = None) -> Any:
    """See `Stream.reduce`."""
    loop = compile_fold(function, stream.layout)
    records = stream.array
    if initial is not None:
        first = np.empty_like(records, shape=(1, *records.shape[1:]))
        first[0] = initial
    if not len(records):
        if initial is None:
            raise ValueError(f"{stream.label}: is empty, and there is no initial record")
        return first[0]
    folds = _folds(loop, records, BLOCK)
    folds = _folds(loop, folds, len(folds))
    if initial is not None:
        folds = _folds(loop, np.concatenate([first, folds]), 2)
    return folds[0]


def _folds(loop: Callable[..., Any], records: NDArray[Any], block: int) -> NDArray[Any]:
    """Fold each block into one record."""
    count = -(-len(records) // block)
    folds = np.empty_like(records, shape=(count, *records.shape[1:]))
    parallel_for(lambda begin, end: loop(begin, end, block, records, folds), count, 1)
    return folds


def _max_coordinate(stream: RecordStream, name: str, choose: np.ufunc) -> Any:
    records = _numbers(stream, name)
    if not len(records):
        raise ValueError(f"{stream.label}: an empty stream has no {name}")
    return _reduce(stream, lambda block: choose.reduce(block, axis=0), choose)


def _reduce(stream: RecordStream, of_block: Callable[[NDArray[Any]], Any], join: np.ufunc) -> Any:
    """Reduce each block by NumPy, which releases the interpreter lock, and join the results."""
    records = stream.array
    if not len(records):
        return of_block(records)
    count = -(-len(records) // BLOCK)
    parts: list[Any] = [None] * count

    def run(begin: int, end: int) -> None:
        for k in range(begin, end):
            parts[k] = of_block(records[k * BLOCK : (k + 1) * BLOCK])

    parallel_for(run, count, 4)
    total = parts[0]
    for part in parts[1:]:
        total = join(total, part)
    return total


def _numbers(stream: RecordStream, name: str) -> NDArray[Any]:
    if stream.record is not None:
        raise TypeError(f"{stream.label}: {name} is not for records with fields; use reduce")
    return stream.array
