import operator
import re
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from conftest import child_environment
from raystream.core.errors import LoopLimitError, RaystreamError
from raystream.jit.threads import set_thread_count
from raystream.streams import INDEX, Counters, GatherArray, Kernel, Stream, device
from raystream.streams.kernel import CHUNK

FLOATS = st.floats(-100, 100, width=32)
PARTICLE = np.dtype([("position", "f4", 3), ("mass", "f8"), ("alive", "?")])


@pytest.fixture(autouse=True)
def default_threads():
    yield
    set_thread_count(None)


def count_up(value, step):
    value += step
    if value >= 1.0:
        return None
    return value


def keep_positive(x):
    return x if x > 0 else None


def add_one(x):
    return x + 1


def add_two(x, y):
    return x + y


def left_neighbour(i, table):
    return table[i - 1]


def sum_at(i, index, table):
    total = 0.0
    for k in range(index):
        total += table[(i + k) % len(table)]
    if index == 0:
        return None
    return total


def drift(particle, step):
    x, y, z = particle.position
    if not particle.alive:
        return None
    return (x + step[0], y + step[1], z + step[2]), particle.mass * 2, particle.mass < 2


def split(x):
    if x < 0:
        return None
    return x // 2, (x, x + 1)


@device
def square(x):
    return x * x


def use_square(x):
    return square(x) + np.float32(1)


# What is written


def test_christens_demo(rng):
    values = rng.random(1000).astype(np.float32)
    stream = Stream(values)
    kernel = Kernel(
        count_up,
        inputs={"value": stream},
        outputs=stream,
        constants={"step": np.float32(0.01)},
    )
    calls = kernel.loop()
    expected, expected_calls = values.copy(), 0
    while True:
        expected_calls += 1
        new = expected + np.float32(0.01)
        written = new < 1
        expected[written] = new[written]
        if not written.any():
            break
    assert calls == expected_calls
    np.testing.assert_array_equal(stream.array, expected)
    assert kernel.execute() == 0
    assert kernel.loop() == 1


@given(hnp.arrays(np.float32, st.integers(0, 40), elements=FLOATS))
def test_the_count_is_that_of_records_not_rejected(values):
    source, target = Stream(values), Stream.zeros(len(values), np.float32)
    kernel = Kernel(keep_positive, inputs={"x": source}, outputs=target)
    assert kernel.execute() == np.count_nonzero(values > 0)
    np.testing.assert_array_equal(target.array, np.where(values > 0, values, 0))
    np.testing.assert_array_equal(source.array, values)


@given(
    hnp.arrays(np.int8, st.integers(0, 40), elements=st.integers(-2, 3)),
    st.sampled_from([operator.eq, operator.ne, operator.lt, operator.le, operator.gt, operator.ge]),
    st.sampled_from([-1, 2, 300, 0.5]),
)
def test_where_runs_only_where_it_holds(values, compare, number):
    target = Stream.zeros(len(values), np.int64)
    kernel = Kernel(add_one, inputs={"x": INDEX}, outputs=target)
    holds = compare(values.astype(float), number)
    assert kernel.execute(where=compare(Stream(values), number)) == np.count_nonzero(holds)
    np.testing.assert_array_equal(target.array, np.where(holds, np.arange(1, len(values) + 1), 0))


def test_where_may_be_booleans_or_the_kernels_own():
    target = Stream.zeros(4, np.int32)
    kernel = Kernel(add_one, inputs={"x": target}, outputs=target, where=[True, False, True, True])
    assert kernel.execute() == 3
    alive = Stream([False, False, True, False])
    assert kernel.execute(where=alive) == 1
    assert target.array.tolist() == [1, 0, 2, 1]
    with pytest.raises(ValueError, match="3 records, but the kernel's streams have 4"):
        kernel.execute(where=Stream.zeros(3) == 0)
    with pytest.raises(TypeError, match=r"where: expected a comparison"):
        kernel.execute(where=np.zeros(4))


def test_where_is_looked_at_in_each_call_of_a_loop():
    state = Stream(np.array([0, 1, 2, 3], np.int8))
    kernel = Kernel(add_one, inputs={"x": state}, outputs=state, where=state < 3)
    assert kernel.loop() == 4
    assert (state == 3).all()


def test_vectors_fields_and_several_outputs():
    values = np.zeros(3, PARTICLE)
    values["mass"] = [1, 2, 3]
    values["alive"] = [True, True, False]
    particles = Stream(values)
    kernel = Kernel(
        drift,
        inputs={"particle": particles},
        outputs=particles,
        constants={"step": (1.0, 0.5, -1.0)},
    )
    assert kernel.execute() == 2
    assert particles.array["position"].tolist() == [[1, 0.5, -1], [1, 0.5, -1], [0, 0, 0]]
    assert particles.array["mass"].tolist() == [2, 4, 3]
    assert particles.array["alive"].tolist() == [True, False, False]

    halves, pairs = Stream.zeros(3, np.int16), Stream.zeros(3, (np.float64, 2))
    kernel = Kernel(split, inputs={"x": Stream([5, -1, 8])}, outputs=[halves, pairs])
    assert kernel.execute() == 2
    assert halves.array.tolist() == [2, 0, 4]
    assert pairs.array.tolist() == [[5, 6], [0, 0], [8, 9]]


def test_functions_call_compiled_functions():
    stream = Stream(np.array([1, 2, 3], np.float32))
    assert Kernel(use_square, inputs={"x": stream}, outputs=stream).execute() == 3
    assert stream.array.tolist() == [2, 5, 10]
    assert Kernel(square, inputs={"x": stream}, outputs=stream).execute() == 3
    assert stream.array.tolist() == [4, 25, 100]


def test_defaults_of_parameters_are_constants():
    stream = Stream.zeros(2)
    Kernel(lambda x, step=3.0: x + step, inputs={"x": stream}, outputs=stream).execute()
    assert stream.array.tolist() == [3, 3]


# Double buffering


@given(hnp.arrays(np.int64, st.integers(1, 50)))
def test_a_kernel_that_gathers_from_what_it_writes_sees_the_old_values(values):
    stream = Stream(values)
    kernel = Kernel(left_neighbour, inputs={"i": INDEX}, outputs=stream, gathers={"table": stream})
    for shift in range(1, 4):
        assert kernel.execute() == len(values)
        np.testing.assert_array_equal(stream.array, np.roll(values, shift))


@pytest.mark.ci
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_rejected_and_masked_records_keep_their_value_in_both_buffers(rng, threads):
    set_thread_count(threads)
    count = 3 * CHUNK + 11
    values = rng.integers(0, 100, count)
    stream = Stream(values)
    mask = rng.random(count) < 0.5
    kernel = Kernel(
        lambda i, x, table: None if x % 3 == 0 else table[i - 1] + 1,
        inputs={"i": INDEX, "x": stream},
        outputs=stream,
        gathers={"table": stream},
        where=mask,
    )
    expected = values.copy()
    for _ in range(3):
        changed = mask & (expected % 3 != 0)
        assert kernel.execute() == np.count_nonzero(changed)
        expected = np.where(changed, np.roll(expected, 1) + 1, expected)
        np.testing.assert_array_equal(stream.array, expected)


@pytest.mark.ci
def test_vectors_and_records_are_double_buffered_too():
    vectors = Stream(np.arange(6.0).reshape(3, 2))
    kernel = Kernel(
        lambda i, table: None if i == 1 else table[i - 1],
        inputs={"i": INDEX},
        outputs=vectors,
        gathers={"table": vectors},
    )
    assert kernel.execute() == 2
    assert vectors.array.tolist() == [[4, 5], [2, 3], [2, 3]]
    values = np.zeros(3, PARTICLE)
    values["mass"] = [1, 2, 3]
    values["position"][:, 1] = [4, 5, 6]
    records = Stream(values)
    kernel = Kernel(
        lambda i, table: None if i == 1 else table[i - 1],
        inputs={"i": INDEX},
        outputs=records,
        gathers={"table": records},
    )
    assert kernel.execute() == 2
    assert records.array["mass"].tolist() == [3, 2, 2]
    assert records.array["position"][:, 1].tolist() == [6, 5, 5]


def test_a_streams_own_array_cannot_be_gathered_behind_its_back():
    stream = Stream.zeros(3)
    with pytest.raises(ValueError, match="give it the stream instead"):
        Kernel(
            left_neighbour,
            inputs={"i": INDEX},
            outputs=stream,
            gathers={"table": stream.array},
        )


@pytest.mark.ci
def test_gather_arrays_of_several_dimensions():
    table = np.arange(24.0).reshape(2, 3, 4)
    target = Stream.zeros(2)
    kernel = Kernel(
        lambda i, t: t[i, 2, -1] + t.shape[1],
        inputs={"i": INDEX},
        outputs=target,
        gathers={"t": table},
    )
    kernel.execute()
    assert target.array.tolist() == [14, 26]
    triples = Stream.zeros(2, ("f8", 4))
    kernel = Kernel(
        lambda i, t: t[i, 1],
        inputs={"i": INDEX},
        outputs=triples,
        gathers={"t": GatherArray(table, vectors=True)},
    )
    kernel.execute()
    np.testing.assert_array_equal(triples.array, table[:, 1])


class Rows(NamedTuple):
    """Rows of unlike length, one after another."""

    splits: np.ndarray
    values: np.ndarray
    scale: float


def sum_row(i, rows):
    return _sum_row(rows, i)


@device
def _sum_row(rows, i):
    total = 0.0
    for k in range(rows.splits[i], rows.splits[i + 1]):
        total += rows.values[k, 0] * rows.scale
    return total


@pytest.mark.ci
def test_a_named_tuple_of_arrays_is_one_parameter():
    rows = Rows(np.array([0, 2, 2, 3]), np.array([[1.0], [2.0], [4.0]]), 10.0)
    target = Stream.zeros(3)
    kernel = Kernel(sum_row, inputs={"i": INDEX}, outputs=target, gathers={"rows": rows})
    assert kernel.execute() == 3
    assert target.array.tolist() == [30, 0, 40]
    counters = Counters()
    kernel.execute(counters=counters)
    assert counters.words_read == {"rows.splits": 12, "rows.values": 6}
    with pytest.raises(TypeError, match=r"sum_row, rows.scale: expected a number"):
        Kernel(
            sum_row,
            inputs={"i": INDEX},
            outputs=target,
            gathers={"rows": rows._replace(scale="a")},
        )


@pytest.mark.ci
@pytest.mark.parametrize(
    "change",
    [
        np.ascontiguousarray,
        np.asfortranarray,
        lambda table: np.repeat(table, 2, axis=0)[::2],
        lambda table: table.astype(">f8"),
        np.ndarray.tolist,
        lambda table: np.frombuffer(table.tobytes()).reshape(table.shape),  # read-only
    ],
)
def test_any_memory_layout_can_be_gathered_from(change):
    table = np.arange(12.0).reshape(4, 3)
    target = Stream.zeros(4)
    kernel = Kernel(
        lambda i, t: t[i, 2] - t[-1, i % 3],
        inputs={"i": INDEX},
        outputs=target,
        gathers={"t": change(table)},
    )
    for counters in (None, Counters()):
        assert kernel.execute(counters=counters) == 4
        np.testing.assert_array_equal(target.array, table[:, 2] - table[-1, np.arange(4) % 3])


def test_an_error_that_the_function_raises_arrives():
    def check(x):
        if x > 2:
            raise ValueError("too large")
        return x

    stream = Stream(np.arange(4))
    with pytest.raises(ValueError, match="too large"):
        Kernel(check, inputs={"x": stream}, outputs=stream).execute()


# Constants


@pytest.mark.ci
def test_constants_change_without_a_new_compilation():
    stream = Stream.zeros(2)
    kernel = Kernel(
        lambda x, step, more: x + step + more[1],
        inputs={"x": stream},
        outputs=stream,
        constants={"step": 1.0, "more": (1, 2)},
    )
    kernel.execute()
    loop = kernel._loop()
    compiled = len(loop._dispatcher.overloads)
    kernel.set_constants(step=2, more=(0, 10))
    assert type(kernel.constants["step"]) is float
    kernel.execute()
    assert stream.array.tolist() == [15, 15]
    assert len(loop._dispatcher.overloads) == compiled == 1
    with pytest.raises(TypeError, match="has no constant 'stop'"):
        kernel.set_constants(stop=1)
    with pytest.raises(TypeError, match="not of type int"):
        kernel.set_constants(more=(0.5, 1))
    with pytest.raises(TypeError, match="tuple of 2"):
        kernel.set_constants(more=1)
    with pytest.raises(TypeError):
        kernel.constants["step"] = 1


class Line(NamedTuple):
    """A slope, and an offset or None."""

    slope: float
    offset: float | None


@device
def _plus(number, more):
    return number if more is None else number + more


@pytest.mark.ci
def test_none_in_a_constant_is_left_out():
    for offset, expected in ((None, [0, 2]), (1.0, [1, 3])):
        stream = Stream(np.arange(2.0))
        kernel = Kernel(
            lambda x, line: _plus(x * line.slope, line.offset),
            inputs={"x": stream},
            outputs=stream,
            constants={"line": Line(2.0, offset)},
        )
        kernel.execute()
        assert stream.array.tolist() == expected
    kernel.set_constants(line=(3.0, 0.0))
    with pytest.raises(TypeError):
        kernel.set_constants(line=(3.0, None))
    with pytest.raises(TypeError, match="expected a number"):
        Kernel(
            lambda x, more: x,
            inputs={"x": stream},
            outputs=stream,
            constants={"more": None},
        )


@pytest.mark.ci
def test_a_number_cannot_take_the_place_of_none():
    stream = Stream.zeros(1)
    line = Line(2.0, None)
    kernel = Kernel(
        lambda x, line: x * line.slope,
        inputs={"x": stream},
        outputs=stream,
        constants={"line": line},
    )
    kernel.set_constants(line=Line(3.0, None))
    with pytest.raises(TypeError, match="cannot replace None"):
        kernel.set_constants(line=Line(3.0, 1.0))


STEP = 1


def add_step(x):
    return x + STEP


def test_a_new_kernel_sees_what_names_stand_for_now(monkeypatch):
    stream = Stream.zeros(1)
    Kernel(add_step, inputs={"x": stream}, outputs=stream).execute()
    monkeypatch.setattr(sys.modules[__name__], "STEP", 10)
    Kernel(add_step, inputs={"x": stream}, outputs=stream).execute()
    assert stream.array.tolist() == [11]


@pytest.mark.ci
def test_equal_functions_and_types_share_compiled_code():
    loops = [
        Kernel(add_one, inputs={"x": stream}, outputs=stream)._loop()
        for stream in (Stream.zeros(3), Stream.zeros(5))
    ]
    assert loops[0] is loops[1]


# Loops


def test_an_endless_loop_is_an_error():
    stream = Stream.zeros(5, np.int64)
    kernel = Kernel(add_one, inputs={"x": stream}, outputs=stream, name="forever")
    with pytest.raises(LoopLimitError, match="forever: still wrote 5 records in round 10;") as e:
        kernel.loop(limit=10)
    assert isinstance(e.value, RaystreamError)
    assert e.value.limit == 10
    assert (stream == 10).all()
    with pytest.raises(ValueError, match="at least 1 round"):
        kernel.loop(limit=0)


def test_the_last_call_allowed_may_be_the_one_that_writes_none():
    stream = Stream(np.array([0.0, 0.9]))
    kernel = Kernel(count_up, inputs={"value": stream}, outputs=stream, constants={"step": 0.25})
    assert kernel.loop(limit=4) == 4


def test_progress_of_a_loop_and_of_a_call():
    stream = Stream(np.linspace(0, 1, 5))
    kernel = Kernel(count_up, inputs={"value": stream}, outputs=stream, constants={"step": 0.25})
    seen = []
    kernel.loop(progress=lambda done, total: seen.append((done, total)))
    assert seen == [(2, 5), (3, 5), (4, 5), (5, 5)]
    seen.clear()
    kernel.execute(progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (5, 5)


INTERRUPTED = """
import os, signal, threading, time
import numpy as np
from raystream.streams import Kernel, Stream, INDEX

stream = Stream.zeros(10_000_000)
def slow(i, old):
    x = old[i] + 1.0
    for _ in range(2000):
        x = x * 0.999 + 1.0
    return x
kernel = Kernel(slow, inputs={"i": INDEX}, outputs=stream, gathers={"old": stream})
small = Stream.zeros(1)
Kernel(slow, inputs={"i": INDEX}, outputs=small, gathers={"old": small}).execute()
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
started = time.perf_counter()
try:
    kernel.execute()
except KeyboardInterrupt:
    print("interrupted", time.perf_counter() - started)
print(stream.any())
def forever(x):
    return x + 1
kernel = Kernel(forever, inputs={"x": small}, outputs=small)
kernel.execute()
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    kernel.loop(limit=10**9)
except KeyboardInterrupt:
    print("interrupted", small.array[0] > 10)
"""


@pytest.mark.ci
def test_ctrl_c_ends_calls_and_loops():
    run = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        capture_output=True,
        text=True,
        timeout=120,
        env=child_environment(RAYSTREAM_THREADS="2"),
        check=False,
    )
    assert run.returncode == 0, run.stderr
    first, second, third = run.stdout.splitlines()
    assert float(first.removeprefix("interrupted ")) < 10
    assert second == "False"  # the old values, all of them
    assert third == "interrupted True"


# The same for every number of threads


@pytest.mark.ci
def test_results_do_not_depend_on_the_number_of_threads(rng):
    count = 5 * CHUNK + 3
    values = rng.integers(0, 6, count).astype(np.int8)
    table = rng.random(count)
    found = []
    for threads in (1, 2, 7):
        set_thread_count(threads)
        target = Stream.zeros(count)
        kernel = Kernel(
            sum_at,
            inputs={"i": INDEX, "index": Stream(values)},
            outputs=target,
            gathers={"table": table},
        )
        counters = Counters()
        written = kernel.execute()
        assert kernel.execute(counters=counters) == written == np.count_nonzero(values)
        found.append((target.array.tobytes(), counters.passes))
    assert found[0] == found[1] == found[2]


# Counters


@pytest.mark.ci
@given(
    hnp.arrays(np.int8, st.integers(1, 30), elements=st.integers(0, 5)),
    st.integers(0, 5),
)
def test_counters_are_exact(values, most):
    index = Stream(values, name="index")
    target = Stream.zeros(len(values))
    table = np.arange(len(values), dtype=np.float64)
    kernel = Kernel(
        sum_at,
        inputs={"i": INDEX, "index": index},
        outputs=target,
        gathers={"table": table},
    )
    plain = kernel.execute(where=index <= most)
    before = target.array.copy()
    counters = Counters()
    assert kernel.execute(where=index <= most, counters=counters) == plain
    np.testing.assert_array_equal(target.array, before)
    run = np.count_nonzero(values <= most)
    (one,) = counters.passes
    assert (one.kernel, one.record_count, one.run_count) == ("sum_at", len(values), run)
    assert one.written_count == np.count_nonzero((values <= most) & (values > 0))
    reads = int(values[values <= most].sum())
    assert one.words_read == {"index": run + len(values), "table": 2 * reads}
    assert one.words_written == {"output 0": 2 * one.written_count}


@pytest.mark.ci
def test_words_of_vectors_and_records():
    particles = Stream.zeros(4, PARTICLE, name="particles")
    vectors = Stream.zeros(4, ("f4", 3))
    kernel = Kernel(
        lambda v, i, table, other: (v[0] + table[i].mass, v[1], other[i, 0] + other[0, i]),
        inputs={"v": vectors, "i": INDEX},
        outputs=vectors,
        gathers={"table": particles, "other": np.zeros((4, 4), np.float32)},
    )
    counters = Counters()
    kernel.execute(counters=counters)
    kernel.execute(counters=counters)
    assert counters.words_read == {"v": 24, "particles": 48, "other": 16}
    assert counters.words_written == {"v": 24}
    assert counters.pass_count == 2
    assert counters.run_count == counters.written_count == 8
    assert counters.of("nothing").pass_count == 0
    lines = str(counters).splitlines()
    assert re.fullmatch(r"<lambda> +2 +8 +8", lines[1])
    assert re.fullmatch(r"particles +48 +0", lines[-2])
    counters.clear()
    assert counters.pass_count == 0


@pytest.mark.ci
def test_counted_passes_check_indices():
    target = Stream.zeros(3)
    kernel = Kernel(
        lambda i, table: table[i + 1],
        inputs={"i": INDEX},
        outputs=target,
        gathers={"table": np.arange(3.0)},
    )
    with pytest.raises(IndexError, match="gather array 'table': index out of range"):
        kernel.execute(counters=Counters())
    assert kernel.execute(where=[True, True, False], counters=Counters()) == 2


def test_nothing_is_counted_unless_asked():
    stream = Stream.zeros(3)
    kernel = Kernel(add_one, inputs={"x": stream}, outputs=stream)
    kernel.execute()
    assert "counts" not in kernel._source.text()
    assert list(kernel._loops) == [(None, None, False)]


# Errors


def declare(function=add_one, **changes):
    return Kernel(function, **{"inputs": {"x": Stream.zeros(3)}, "outputs": STREAM, **changes})


STREAM = Stream.zeros(3)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"inputs": {}}, TypeError, "parameter 'x' is not an input, gather array or constant"),
        ({"inputs": {"x": STREAM, "y": STREAM}}, TypeError, "has no parameter 'y'"),
        ({"inputs": {"x": [1, 2, 3]}}, TypeError, "input 'x': expected a Stream, got list"),
        ({"constants": {"x": 1}}, TypeError, "'x' is declared twice"),
        (
            {"function": add_two, "constants": {"y": [1]}},
            TypeError,
            "constant 'y': expected a number",
        ),
        (
            {"function": add_two, "constants": {"y": "a"}},
            TypeError,
            "constant 'y': expected a number",
        ),
        ({"outputs": []}, ValueError, "at least one stream"),
        ({"outputs": [np.zeros(3)]}, TypeError, "expected streams, got ndarray"),
        ({"outputs": [STREAM, STREAM]}, ValueError, "writes a stream twice"),
        ({"outputs": Stream.zeros(4)}, ValueError, "differ in length: 3, 4 records"),
        ({"where": Stream.zeros(4) == 0}, ValueError, "4 records"),
        ({"function": add_two, "gathers": {"y": ["a"]}}, TypeError, "gather array"),
        ({"function": np.sin}, TypeError, "expected a Python function"),
        ({"function": lambda *x: x}, TypeError, "plain name"),
        ({"function": lambda *, x: x}, TypeError, "plain name"),
    ],
)
def test_wrong_declarations_are_said(changes, error, message):
    with pytest.raises(error, match=message) as caught:
        declare(**changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: None, "never returns a record"),
        (lambda x: (x, x), "takes float64"),
        (lambda x: 1j, "it returns complex128, and its output takes float64"),
        (lambda x: x.foo, r"Unknown attribute 'foo' of type float64 \(.*, line \d+\)"),
        (lambda x: not_there, "name 'not_there' is not defined"),  # noqa: F821
        (lambda x: (x, x) if x else (x, x, x), "Cannot unify"),
    ],
)
def test_what_cannot_be_compiled_is_said(function, message):
    kernel = declare(function)
    with pytest.raises(TypeError, match=message) as caught:
        kernel.execute()
    assert "\n" not in str(caught.value)


def test_wrong_results_are_said():
    vectors = Stream.zeros(3, ("f4", 3))
    index = {"i": INDEX}
    for function, message in [
        (lambda i: i, "takes a tuple of 3"),
        (lambda i: (i, i), "it returns a tuple of 2, and its output takes a tuple of 3"),
    ]:
        with pytest.raises(TypeError, match=message):
            Kernel(function, inputs=index, outputs=vectors).execute()
    with pytest.raises(TypeError, match="returns float64, and its output takes int8"):
        Kernel(lambda i: i / 2, inputs=index, outputs=Stream.zeros(3, np.int8)).execute()
    with pytest.raises(TypeError, match="takes bool"):
        Kernel(lambda i: i, inputs=index, outputs=Stream.zeros(3, bool)).execute()


def test_gather_arrays_are_read_one_record_at_a_time():
    for function in (lambda i, t: t[i], lambda i, t: t[i, 0, 0], lambda i, t: t[i, 0:2][0]):
        kernel = Kernel(
            function,
            inputs={"i": INDEX},
            outputs=Stream.zeros(3),
            gathers={"t": np.zeros((3, 3))},
        )
        with pytest.raises(TypeError, match=r"read at 2 integer\(s\)"):
            kernel.execute()
