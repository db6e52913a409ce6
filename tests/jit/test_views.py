"""Typed views: fields are read and written where NumPy has them."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from raystream.jit.cpu import device, kernel
from raystream.jit.fingerprint import fingerprint
from raystream.jit.simd import address, f32x8, i32x4, reduce_max
from raystream.jit.views import address_of, view

INNER = np.dtype([("low", "f4", 3), ("count", "u4")])
RECORD = np.dtype(
    [
        ("flag", "u1"),
        ("unused", "V3"),
        ("number", "i4"),
        ("long", "f8"),
        ("three", "f4", 3),
        ("one", "f4", (1,)),
        ("eight", "f4", 8),
        ("rows", "f4", (3, 2, 4)),
        ("each", "i4", (4, 1)),
        ("inner", INNER),
    ]
)
Record = view(RECORD)
Pair = view([("a", "f4"), ("b", "f4")])
Swapped = view([("b", "f4"), ("a", "f4")])

ONE, TWO = np.uint64(1), np.uint64(2)


@kernel
def read_all(memory, row, out):
    record = Record(address(memory), np.uint64(row))
    x, y, z = record.three
    out[0], out[1] = record.flag, record.number
    out[2], out[3] = record.long, record.one
    out[4], out[5], out[6] = x, y, z
    out[7] = reduce_max(record.eight)
    out[8] = reduce_max(record.rows[TWO, ONE])
    out[9] = record.each[TWO]
    _, _, high = record.inner.low
    out[10], out[11] = high, record.inner.count


@kernel
def write_all(memory, row):
    record = Record(address(memory), np.uint64(row))
    record.flag, record.number, record.long = np.uint8(7), np.int32(-3), np.float64(0.1)
    record.three = np.float32(1), np.float32(2), np.float32(3)
    record.one = np.float32(4)
    record.eight = f32x8(np.float32(5))
    record.rows[ONE, ONE] = record.rows[ONE, ONE] + record.rows[TWO, ONE]
    record.each[ONE] = np.int32(6)
    inner = record.inner
    inner.low = np.float32(8), np.float32(9), np.float32(10)
    inner.count = np.uint32(2**32 - 1)


def filled(count, rng):
    records = np.zeros(count, RECORD)
    for name in ("number", "long", "three", "one", "eight", "rows", "each"):
        records[name] = rng.integers(-99, 99, records[name].shape)
    records["flag"] = rng.integers(0, 255, count)
    records["inner"]["low"] = rng.normal(size=(count, 3))
    records["inner"]["count"] = rng.integers(0, 2**32, count)
    return records


def test_fields_are_read_where_numpy_has_them(rng):
    records = filled(5, rng)
    for row, one in enumerate(records):
        out = np.zeros(12)
        read_all(records.view(np.uint8), row, out)
        expected = [one["flag"], one["number"], one["long"], one["one"][0], *one["three"]]
        expected += [one["eight"].max(), one["rows"][2, 1].max(), one["each"][2, 0]]
        expected += [one["inner"]["low"][2], one["inner"]["count"]]
        np.testing.assert_array_equal(out, np.array(expected, np.float64))


def test_fields_are_written_where_numpy_has_them_and_nothing_else_is(rng):
    records = filled(3, rng)
    expected = records.copy()
    write_all(records.view(np.uint8), 1)
    one = expected[1:2]
    one["flag"], one["number"], one["long"], one["one"] = 7, -3, 0.1, 4
    one["three"], one["eight"] = [1, 2, 3], 5
    one["rows"][:, 1, 1] += one["rows"][:, 2, 1]
    one["each"][:, 1] = 6
    one["inner"]["low"], one["inner"]["count"] = [8, 9, 10], 2**32 - 1
    assert records.tobytes() == expected.tobytes()


@kernel
def first_of(memory):
    return Pair(address(memory)).a


@kernel
def first_of_swapped(memory):
    return Swapped(address(memory)).a


def test_records_with_other_fields_are_other_code():
    numbers = np.array([1, 2], np.float32)
    assert (first_of(numbers), first_of_swapped(numbers)) == (1, 2)
    assert fingerprint(first_of.py_func) != fingerprint(first_of_swapped.py_func)


@device
def moved(record):
    return address_of(record)


@kernel
def offsets(memory, out):
    at = address(memory)
    record = Record(at, ONE)
    out[0] = np.int64(moved(record) - at)
    out[1] = np.int64(address_of(record.inner) - at)
    out[2] = np.int64(address_of(record.rows) - at)


def test_views_have_addresses():
    out = np.zeros(3, np.int64)
    offsets(np.zeros(2, RECORD).view(np.uint8), out)
    places = [RECORD.itemsize + RECORD.fields[name][1] for name in ("inner", "rows")]
    assert out.tolist() == [RECORD.itemsize, *places]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (np.dtype([("a", "u1"), ("b", "f4")]), r"field 'b': not aligned to 4 bytes"),
        (np.dtype([("a", "f8"), ("b", "f4")]), r"field 'a': not aligned to 8 bytes"),
        (np.dtype([("a", INNER, 2)]), r"field 'a': rows of records are not supported"),
    ],
)
def test_what_cannot_be_a_view(fields, message):
    with pytest.raises(ValueError, match=message):
        view(fields)


def _signed_row(memory):
    return Record(address(memory), 1).number


def _no_such_field(memory):
    return Record(address(memory)).size


def _too_few_indices(memory):
    return reduce_max(Record(address(memory)).rows[ONE])


def _other_vector(memory):
    Record(address(memory)).eight = i32x4(np.int32(1))


def _whole_rows(memory):
    Record(address(memory)).rows = np.float32(1)


@pytest.mark.parametrize(
    "function", [_signed_row, _no_such_field, _too_few_indices, _other_vector, _whole_rows]
)
def test_mistakes_do_not_compile(function):
    with pytest.raises((TypingError, NotImplementedError)):
        kernel(function)(np.zeros(1, RECORD).view(np.uint8))
