import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from raystream.jit.threads import set_thread_count
from raystream.streams import GatherArray, Stream
from raystream.streams.reductions import BLOCK

NUMBERS = ["bool", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8", "c8", "c16"]
PARTICLE = np.dtype([("position", "f4", 3), ("mass", "f8"), ("alive", "?")])


@pytest.fixture(autouse=True)
def default_threads():
    yield
    set_thread_count(None)


@pytest.mark.parametrize("dtype", NUMBERS)
def test_numbers_come_back_as_they_went_in(dtype):
    values = np.arange(5).astype(dtype)
    stream = Stream(values)
    assert stream.dtype == dtype
    assert len(stream) == 5
    np.testing.assert_array_equal(np.asarray(stream), values)
    assert stream.record is None


def test_values_are_copied():
    values = np.zeros(3)
    stream = Stream(values)
    stream.array[0] = 1
    assert values[0] == 0
    assert np.array(stream) is not stream.array


def test_vectors_and_records():
    assert Stream(np.zeros((4, 3), "f4")).layout.word_count == 3
    assert Stream.zeros(4, ("f4", 3)).array.shape == (4, 3)
    stream = Stream(np.zeros(4, PARTICLE), name="particles")
    assert stream.record._fields == ("position", "mass", "alive")
    assert stream.layout.word_count == 6  # 21 bytes
    assert repr(stream).startswith("<Stream 'particles': 4 x ")
    assert repr(Stream.zeros(4, ("f4", 3))) == "<Stream: 4 x float32 x 3>"


@pytest.mark.parametrize("dtype", [">f4", ">i2", [("a", ">f8")]])
def test_foreign_byte_orders_become_native(dtype):
    values = np.ones(3, dtype)
    stream = Stream(values)
    assert stream.dtype.isnative
    np.testing.assert_array_equal(stream.array, values)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        (np.array(["a"]), TypeError, "do not compute with dtype <U1"),
        (np.array([None]), TypeError, "dtype object"),
        (np.zeros(2, "f2"), TypeError, "float16"),
        (np.zeros(2, "M8[s]"), TypeError, "datetime"),
        (np.float64(1), ValueError, r"shape \(N,\)"),
        (np.zeros((2, 2, 2)), ValueError, r"got \(2, 2, 2\)"),
        (np.zeros((2, 0)), ValueError, "1 to 16 components, got 0"),
        (np.zeros((2, 17)), ValueError, "got 17"),
        (np.zeros((2, 2), PARTICLE), TypeError, "cannot be components"),
        (np.zeros(2, [("a b", "f4")]), ValueError, "'a b'"),
        (np.zeros(2, [("_a", "f4")]), ValueError, "'_a'"),
        (np.zeros(2, [("class", "f4")]), ValueError, "'class'"),
        (np.zeros(2, [("a", "f4", (2, 2))]), TypeError, "number or a vector"),
        (np.zeros(2, [("a", [("b", "f4")])]), TypeError, "number or a vector"),
        (np.zeros(2, [("a", "S4")]), TypeError, "field 'a'"),
        ([[1], [2, 3]], TypeError, "cannot be read as an array"),
    ],
)
def test_what_is_no_stream_is_said(values, error, message):
    with pytest.raises(error, match=message) as caught:
        Stream(values, name="mine")
    assert "stream 'mine'" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_assign():
    stream = Stream.zeros(3, np.int32)
    stream.assign(7)
    assert (stream == 7).all()
    stream.assign([1, 2, 3])
    np.testing.assert_array_equal(stream.array, [1, 2, 3])
    with pytest.raises(TypeError, match="stream"):
        stream.assign(0.5)
    with pytest.raises(ValueError, match="stream"):
        stream.assign([1, 2])


def test_conditions_follow_the_stream():
    state = Stream(np.array([0, 1, 2, 2], np.uint8), name="state")
    waiting = state == 2
    assert waiting.count() == 2
    state.assign(2)
    assert waiting.all()
    assert not (state < 2).any()
    assert (state >= 2).count() == 4
    assert (state != 300).all()
    assert (state > -1).all()
    assert repr(state <= 1) == "<Condition stream 'state' <= 1>"


def test_a_condition_is_no_bool():
    state = Stream.zeros(2, np.int8)
    with pytest.raises(TypeError, match=r"any\(\) or all\(\)"):
        bool(state == 0)
    with pytest.raises(TypeError, match="expected a number"):
        state == "0"  # noqa: B015
    with pytest.raises(TypeError, match="expected a number"):
        state == Stream.zeros(2)  # noqa: B015
    with pytest.raises(TypeError, match="stream of numbers"):
        Stream.zeros(2, ("f4", 3)) == 0  # noqa: B015
    assert len({state, state}) == 1


def test_gather_arrays():
    stream = Stream(np.arange(6.0))
    assert GatherArray(stream, (2, 3)).array.tolist() == [[0, 1, 2], [3, 4, 5]]
    stream.assign(1)
    assert GatherArray(stream).array.tolist() == [1] * 6
    assert GatherArray(np.zeros((5, 3)), vectors=True).shape == (5,)
    assert GatherArray(np.zeros((5, 3))).shape == (5, 3)
    values = np.zeros(3)
    assert np.shares_memory(GatherArray(values).array, values)
    with pytest.raises(ValueError, match="6 records cannot have shape"):
        GatherArray(stream, (2, 2))
    with pytest.raises(ValueError, match="at least 1"):
        GatherArray(1.0)
    with pytest.raises(ValueError, match="at least 2"):
        GatherArray([1.0], vectors=True)
    with pytest.raises(TypeError, match="gather array 'table'"):
        GatherArray(["a"], name="table")


# Reductions


@given(
    hnp.arrays(
        st.sampled_from(["bool", "i1", "u2", "i4", "i8", "u8"]),
        hnp.array_shapes(min_dims=1, max_dims=2, min_side=1, max_side=12),
    )
)
def test_reductions_of_integers_are_numpys(values):
    stream = Stream(values)
    kind = np.uint64 if values.dtype.kind == "u" else np.int64
    np.testing.assert_array_equal(stream.sum(), values.sum(axis=0, dtype=kind))
    np.testing.assert_array_equal(stream.min(), values.min(axis=0))
    np.testing.assert_array_equal(stream.max(), values.max(axis=0))
    np.testing.assert_array_equal(stream.count(), np.count_nonzero(values, axis=0))
    np.testing.assert_array_equal(stream.any(), values.any(axis=0))
    np.testing.assert_array_equal(stream.all(), values.all(axis=0))


@pytest.mark.parametrize("shape", [3 * BLOCK + 5, (2 * BLOCK + 1, 3), BLOCK, 1])
def test_reductions_over_many_blocks_do_not_depend_on_threads(rng, shape):
    values = rng.normal(size=shape).astype(np.float32)
    stream = Stream(values)
    found = []
    for threads in (1, 2, 5):
        set_thread_count(threads)
        found.append(
            [stream.sum(), stream.min(), stream.max(), stream.count(), stream.reduce(add_records)]
            if stream.array.ndim == 1
            else [stream.sum(), stream.min(), stream.max(), stream.count()]
        )
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    np.testing.assert_allclose(found[0][0], values.sum(axis=0, dtype=np.float64), rtol=1e-9)
    np.testing.assert_array_equal(found[0][1], values.min(axis=0))
    np.testing.assert_array_equal(found[0][2], values.max(axis=0))
    assert np.asarray(found[0][0]).dtype == np.float64


def add_records(a, b):
    return a + b


def keep_first(a, b):
    return a


def join(a, b):
    """Of intervals one after another: not commutative, but associative."""
    return a.low, b.high, a.length + b.length


def larger_norm(a, b):
    return a if a[0] * a[0] + a[1] * a[1] >= b[0] * b[0] + b[1] * b[1] else b


@given(st.lists(st.integers(-100, 100), max_size=30), st.integers(-5, 5))
def test_a_fold_of_ones_own(values, initial):
    stream = Stream(np.array(values, np.int64))
    assert stream.reduce(add_records, initial) == sum(values, initial)
    if values:
        assert stream.reduce(add_records) == sum(values)


def test_a_fold_keeps_the_order():
    count = 2 * BLOCK + 3
    intervals = np.zeros(count, [("low", "i8"), ("high", "i8"), ("length", "i8")])
    intervals["low"] = np.arange(count)
    intervals["high"] = np.arange(count) + 1
    intervals["length"] = 1
    total = Stream(intervals).reduce(join)
    assert (total["low"], total["high"], total["length"]) == (0, count, count)
    assert Stream(np.arange(count)).reduce(keep_first) == 0
    vectors = np.array([[1, 2], [-5, 1], [3, 3]], np.float32)
    assert Stream(vectors).reduce(larger_norm).tolist() == [-5, 1]


def test_reductions_of_floats_keep_nan():
    stream = Stream([1.0, np.nan, 3.0])
    assert np.isnan(stream.sum())
    assert np.isnan(stream.min())
    assert np.isnan(stream.max())
    assert stream.count() == 3


def test_empty_streams():
    empty = Stream(np.zeros(0))
    assert empty.sum() == 0
    assert empty.count() == 0
    assert not empty.any()
    assert empty.all()
    assert empty.reduce(add_records, 4.0) == 4
    for reduce in (empty.min, empty.max, lambda: empty.reduce(add_records)):
        with pytest.raises(ValueError, match="empty"):
            reduce()


def test_what_cannot_be_reduced_is_said():
    particles = Stream.zeros(2, PARTICLE)
    with pytest.raises(TypeError, match="use reduce"):
        particles.sum()
    with pytest.raises(TypeError, match="takes two records"):
        Stream.zeros(2).reduce(lambda a: a)
    with pytest.raises(TypeError, match="never returns a record"):
        Stream.zeros(2).reduce(lambda a, b: None)
    with pytest.raises(TypeError, match="returns float64, and the stream takes int64"):
        Stream.zeros(2, np.int64).reduce(lambda a, b: a / 2)
