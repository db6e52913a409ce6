"""Users' kernels in WGSL: the model of `raystream.streams`, with its results."""

from __future__ import annotations

import operator
import runpy
from pathlib import Path

import numpy as np
import pytest

from raystream import streams as cpu
from raystream.core.errors import LoopLimitError
from raystream.graphics import streams as gpu
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.streams import INDEX, Count, Counters, GatherArray, Kernel, Stream, While

EXAMPLE = runpy.run_path(
    str(Path(__file__).resolve().parents[2] / "examples" / "streams" / "reaction_diffusion.py")
)

COUNT_UP = """
fn count_up(value: f32, step: f32) -> f32 {
    if value + step >= 1.0 { discard; }
    return value + step;
}
"""

RULE_90 = """
fn rule_90(i: i32) -> u32 {
    return cells(i - 1) ^ cells((i + 1) % cells_shape[0]);
}
"""

ADD_ONE = "fn add_one(x: i32) -> i32 { return x + 1; }"

COLLATZ = """
struct Records { n: i32, length: i32 }

fn halve(n: i32, length: i32) -> Records {
    if n % 2 == 1 { discard; }
    return Records(n / 2, length + 1);
}

fn triple(n: i32, length: i32) -> Records {
    if n % 2 == 0 || n == 1 { discard; }
    return Records(3 * n + 1, length + 1);
}
"""


@pytest.fixture(autouse=True)
def device(opened: OpenDevice) -> OpenDevice:
    return opened


def count_up(value, step):
    value += step
    return None if value >= np.float32(1) else value


def rule_90(i, cells):
    return cells[i - 1] ^ cells[(i + 1) % len(cells)]


def halve(n, length):
    return None if n % 2 == 1 else (n // 2, length + 1)


def triple(n, length):
    return None if n % 2 == 0 or n == 1 else (3 * n + 1, length + 1)


# As on the CPU


def test_christens_demo_counts_and_writes_as_on_the_cpu(rng):
    """Listing 4.4: the same calls, the same number written in each, the same bits."""
    values = rng.random(3000).astype(np.float32)
    step = np.float32(1 / 128)  # sums are exact, so that no compiler can round another way
    values = np.round(values * 1024) / np.float32(1024)
    found = []
    for module, source in ((cpu, count_up), (gpu, COUNT_UP)):
        stream, counters = module.Stream(values), Counters()
        kernel = module.Kernel(
            source, inputs={"value": stream}, outputs=stream, constants={"step": step}
        )
        calls = kernel.loop(counters=counters)
        assert kernel.execute() == 0
        assert kernel.loop() == 1
        found.append((calls, counters.passes, stream.array.tobytes()))
    assert found[0] == found[1]
    assert found[0][0] > 100


def test_a_kernel_that_gathers_what_it_writes_sees_the_old_records(rng):
    cells = rng.integers(0, 2, 700).astype(np.uint32)
    streams = []
    for module, source in ((cpu, rule_90), (gpu, RULE_90)):
        row = module.Stream(cells)
        kernel = module.Kernel(source, inputs={"i": INDEX}, outputs=row, gathers={"cells": row})
        assert [kernel.execute() for _ in range(5)] == [700] * 5
        streams.append(row.array)
    np.testing.assert_array_equal(*streams)


def test_chains_of_kernels_with_several_outputs_as_on_the_cpu():
    counts, results = [], []
    for module, sources in (
        (cpu, ((halve,), (triple,))),
        (gpu, ((COLLATZ, "halve"), (COLLATZ, "triple"))),
    ):
        numbers = module.Stream(np.arange(1, 200, dtype=np.int32))
        lengths = module.Stream.zeros(199, np.int32)
        even, odd = (
            module.Kernel(
                *source, inputs={"n": numbers, "length": lengths}, outputs=[numbers, lengths]
            )
            for source in sources
        )
        counts.append(module.While(module.While(even), module.While(odd), idle="all").run())
        results.append((numbers.array.tolist(), lengths.array.tolist()))
    assert counts[0] == counts[1]
    assert results[0] == results[1]
    assert results[0][0] == [1] * 199


def react(at, i, spread, feed, kill, field):
    height, width = field.shape
    row, column = i // width, i % width
    result = (
        field[(row + 1) % height, column],
        field[row - 1, column],
        field[row, (column + 1) % width],
        field[row, column - 1],
    )
    first = result[0][0] + result[1][0] + result[2][0] + result[3][0]
    second = result[0][1] + result[1][1] + result[2][1] + result[3][1]
    reaction = at[0] * at[1] * at[1]
    change = feed * (1.0 - at[0]) - reaction, reaction - (feed + kill) * at[1]
    return (
        at[0] + spread[0] * (first - 4.0 * at[0]) + change[0],
        at[1] + spread[1] * (second - 4.0 * at[1]) + change[1],
    )


def test_reaction_and_diffusion_as_on_the_cpu(rng):
    """The example's kernel: the CPU's is written in another language, and nothing else differs."""
    start = rng.random((24, 40, 2)).astype(np.float32).reshape(-1, 2)
    fields = []
    for module, source in ((cpu, react), (gpu, EXAMPLE["REACT"])):
        field = module.Stream(start)
        kernel = module.Kernel(
            source,
            inputs={"at": field, "i": INDEX},
            outputs=field,
            gathers={"field": module.GatherArray(field, (24, 40))},
            constants={"spread": (0.2, 0.1), "feed": 0.037, "kill": 0.06},
        )
        assert module.Repeat(60, kernel).run() == Count(60, 60, 57600, (Count(60, 60, 57600),))
        fields.append(field.array)
    np.testing.assert_allclose(*fields, atol=2e-6)
    assert np.ptp(fields[0][:, 1]) > 0.01


# Records


@pytest.mark.parametrize("dtype", [np.float32, np.int32, np.uint32])
@pytest.mark.parametrize("components", [1, 2, 3, 4])
@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 4097])
def test_records_of_every_type_come_back(rng, dtype, components, count):
    shape = (count,) if components == 1 else (count, components)
    values = rng.integers(0, 1000, shape).astype(dtype)
    stream = Stream(values)
    np.testing.assert_array_equal(stream.array, values)
    scalar = {"float32": "f32", "int32": "i32", "uint32": "u32"}[stream.dtype.name]
    record = scalar if components == 1 else f"vec{components}<{scalar}>"
    target = Stream(np.zeros_like(values))
    source = f"fn twice(x: {record}) -> {record} {{ return x + x; }}"
    assert Kernel(source, inputs={"x": stream}, outputs=target).execute() == count
    np.testing.assert_array_equal(target.array, 2 * values)
    assert target.array.dtype == dtype
    assert target.array.shape == shape
    np.testing.assert_array_equal(stream.array, values)


def test_a_stream_as_its_cpu_counterpart():
    values = np.array([3, 1, 2], np.int32)
    stream = Stream(values, name="mine")
    assert (len(stream), stream.dtype, stream.record) == (3, np.int32, None)
    assert repr(stream) == "<Stream 'mine': 3 x int32>"
    assert repr(Stream.zeros(4, ("f4", 3))) == "<Stream: 4 x float32 x 3>"
    assert (stream.sum(), stream.min(), stream.max(), stream.count()) == (6, 1, 3, 3)
    assert stream.any()
    assert stream.all()
    assert stream.reduce(lambda a, b: a * b, 2) == 12
    assert (stream >= 2).count() == 2
    stream.assign([1, 2, 5])
    assert np.asarray(stream).tolist() == [1, 2, 5]
    stream.assign(7)
    assert stream.array.tolist() == [7, 7, 7]
    with pytest.raises(ValueError, match="read-only"):
        stream.array[0] = 1
    with pytest.raises(TypeError, match="stream 'mine'"):
        stream.assign(0.5)
    with pytest.raises(ValueError, match="stream 'mine'"):
        stream.assign([1, 2])
    assert stream.array.tolist() == [7, 7, 7]


def test_array_follows_kernels_and_copies_stay():
    stream = Stream(np.arange(3, dtype=np.int32))
    kernel = Kernel(ADD_ONE, inputs={"x": stream}, outputs=stream)
    before = stream.array
    kernel.execute()
    assert stream.array.tolist() == [1, 2, 3]
    assert before.tolist() == [0, 1, 2]
    assert stream.array is stream.array


def test_rejected_records_keep_their_value_in_both_textures(rng):
    values = rng.integers(0, 100, 5000).astype(np.int32)
    mask = rng.random(5000) < 0.5
    stream = Stream(values)
    kernel = Kernel(
        """
        fn step(i: i32, x: i32) -> i32 {
            if x % 3 == 0 { discard; }
            return table(i - 1) + 1;
        }
        """,
        inputs={"i": INDEX, "x": stream},
        outputs=stream,
        gathers={"table": stream},
        where=mask,
    )
    expected = values.copy()
    for _ in range(4):
        changed = mask & (expected % 3 != 0)
        assert kernel.execute() == np.count_nonzero(changed)
        expected = np.where(changed, np.roll(expected, 1) + 1, expected)
        np.testing.assert_array_equal(stream.array, expected)


def test_statements_after_a_rejection_still_run_and_nothing_is_written():
    """As WGSL says of `discard`; also in a function that the kernel's calls."""
    stream = Stream(np.array([1.0, -1.0, 4.0], np.float32))
    source = """
        fn check(x: f32) { if x < 0.0 { discard; } }
        fn root(x: f32) -> f32 { check(x); return sqrt(abs(x)); }
    """
    assert Kernel(source, "root", inputs={"x": stream}, outputs=stream).execute() == 2
    np.testing.assert_allclose(stream.array, [1, -1, 2])


@pytest.mark.parametrize("room", [16, 20, 32])
def test_more_outputs_than_one_draw_can_write(opened, monkeypatch, room):
    """The function runs once for each group of outputs, and reads old records each time."""
    monkeypatch.setitem(opened.limits, "max-color-attachment-bytes-per-sample", room)
    n, at, seen = (
        Stream(np.arange(100, dtype=np.int32)),
        Stream(np.ones((100, 4), np.float32)),
        Stream(np.zeros((100, 2), np.uint32)),
    )
    source = """
        struct All { n: i32, at: vec4f, seen: vec2u }
        fn step(n: i32, at: vec4f, seen: vec2u) -> All {
            if n % 2 == 0 { discard; }
            return All(n + 1, at * f32(n), seen + vec2u(u32(n), 1u));
        }
    """
    kernel = Kernel(
        source, inputs={"n": n, "at": at, "seen": seen}, outputs=[n, at, seen], name="step"
    )
    counters = Counters()
    assert kernel.execute(counters=counters) == 50
    assert counters.run_count == 100
    odd = np.arange(100) % 2 == 1
    np.testing.assert_array_equal(n.array, np.arange(100) + odd)
    np.testing.assert_array_equal(at.array[:, 2], np.where(odd, np.arange(100), 1))
    np.testing.assert_array_equal(seen.array[odd], np.c_[np.arange(1, 100, 2), np.ones(50)])
    assert not seen.array[~odd].any()
    groups = {16: 3, 20: 2, 32: 1}
    assert kernel.wgsl.count("@fragment") == groups[room]


# Gather arrays


def test_gather_arrays_of_several_dimensions(rng):
    table = rng.integers(0, 100, (3, 5, 70)).astype(np.int32)
    target = Stream.zeros(70, np.int32)
    source = "fn look(i: i32) -> i32 { return t(i % 3, -2, -1 - i) + t_shape[1] * t_shape[2]; }"
    Kernel(source, inputs={"i": INDEX}, outputs=target, gathers={"t": table}).execute()
    i = np.arange(70)
    np.testing.assert_array_equal(target.array, table[i % 3, -2, -1 - i] + 350)


def test_vectors_and_streams_as_gather_arrays():
    points = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    grid = Stream(np.arange(6, dtype=np.uint32))
    target = Stream.zeros(2, (np.float32, 3))
    source = """
        fn look(i: u32) -> vec3f {
            return points(i32(i), 1) + f32(grid(1, i32(i)));
        }
    """
    kernel = Kernel(
        source,
        inputs={"i": INDEX},
        outputs=target,
        gathers={"points": GatherArray(points, vectors=True), "grid": GatherArray(grid, (2, 3))},
    )
    kernel.execute()
    np.testing.assert_array_equal(target.array, points[:, 1] + [[3], [4]])


# Conditions and constants


@pytest.mark.parametrize(
    "compare", [operator.eq, operator.ne, operator.lt, operator.le, operator.gt, operator.ge]
)
@pytest.mark.parametrize("dtype", [np.int32, np.float32])
def test_where_runs_only_where_it_holds(rng, compare, dtype):
    values = rng.integers(-2, 3, 100).astype(dtype)
    target = Stream.zeros(100, np.int32)
    kernel = Kernel("fn f(i: i32) -> i32 { return i + 1; }", inputs={"i": INDEX}, outputs=target)
    holds = compare(values, 1)
    assert kernel.execute(where=compare(Stream(values), 1)) == np.count_nonzero(holds)
    np.testing.assert_array_equal(target.array, np.where(holds, np.arange(1, 101), 0))


def test_where_may_be_booleans_the_kernels_own_or_its_output():
    target = Stream.zeros(4, np.int32)
    kernel = Kernel(ADD_ONE, inputs={"x": target}, outputs=target, where=[True, False, True, True])
    assert kernel.execute() == 3
    assert kernel.execute(where=target == 0) == 1
    assert target.array.tolist() == [1, 1, 1, 1]
    assert kernel.loop(where=target < 5) == 5
    assert (target == 5).all()


def test_a_condition_of_another_stream_takes_no_new_program(opened, monkeypatch):
    target = Stream.zeros(4, np.int32)
    kernel = Kernel(ADD_ONE, inputs={"x": target}, outputs=target)
    for number in range(3):
        mask = Stream(np.arange(4, dtype=np.int32))
        assert kernel.execute(where=mask == number) == 1
    assert len(kernel._programs) == 2  # without a condition, and with it


def test_constants_change_without_a_new_compilation():
    target = Stream.zeros(2, np.float32)
    source = """
        fn f(x: f32, step: f32, more: vec2<i32>, last: u32) -> f32 {
            return x + step + f32(more.y) + f32(last & 1u);
        }
    """
    constants = {"step": 1, "more": (1, -2), "last": 2**32 - 1}
    kernel = Kernel(source, inputs={"x": target}, outputs=target, constants=constants)
    kernel.execute()
    assert target.array.tolist() == [0, 0]
    kernel.set_constants(step=np.float32(0.5), more=[0, 10])
    assert kernel.constants["more"] == [0, 10]
    kernel.execute()
    assert target.array.tolist() == [11.5, 11.5]
    assert len(kernel._programs) == 1
    for wrong, error, message in (
        ({"stop": 1}, TypeError, "f: has no constant 'stop'"),
        ({"more": (0.5, 1)}, TypeError, "constant 'more': vec2i cannot hold 0.5"),
        ({"more": 1}, TypeError, "vec2i takes 2 numbers, not 1"),
        ({"step": (1,)}, TypeError, "f32 takes a number"),
        ({"step": True}, TypeError, "f32 cannot hold True"),
        ({"last": -1}, ValueError, "-1 is out of the range of u32"),
        ({"step": 1e300}, ValueError, "out of the range of f32"),
    ):
        with pytest.raises(error, match=message):
            kernel.set_constants(**wrong)
    assert kernel.constants["step"] == 0.5


# Counts and loops


def test_counted_passes_as_on_the_cpu(rng):
    cells = rng.integers(0, 2, 300).astype(np.uint32)
    passes = []
    for module, source in ((cpu, rule_90), (gpu, RULE_90)):
        row, state = module.Stream(cells, name="row"), module.Stream(cells, name="state")
        counters = Counters()
        kernel = module.Kernel(
            source,
            inputs={"i": INDEX},
            outputs=row,
            gathers={"cells": row},
            where=state == 1,
            name="rule",
        )
        kernel.execute(counters=counters)
        kernel.execute(counters=counters)
        passes.append(counters.passes)
    assert passes[0] == passes[1]


def test_a_counted_pass_checks_indices():
    stream = Stream(np.arange(4, dtype=np.int32))
    source = "fn f(i: i32) -> i32 { return table(i + 2); }"
    kernel = Kernel(source, inputs={"i": INDEX}, outputs=stream, gathers={"table": stream})
    with pytest.raises(IndexError, match="f, gather array 'table': 2 indices out of range"):
        kernel.execute(counters=Counters())
    assert stream.array.tolist() == [0, 1, 2, 3]
    assert kernel.execute() == 4  # reads some record or 0, and does no harm


def test_an_endless_loop_is_an_error():
    stream = Stream.zeros(5, np.int32)
    kernel = Kernel(ADD_ONE, inputs={"x": stream}, outputs=stream, name="forever")
    with pytest.raises(LoopLimitError, match="forever: still wrote 5 records in round 10;"):
        kernel.loop(limit=10)
    assert (stream == 10).all()
    with pytest.raises(LoopLimitError):
        While(kernel, limit=3).run()
    with pytest.raises(ValueError, match="at least 1 round"):
        kernel.loop(limit=0)


def test_empty_streams():
    stream = Stream(np.zeros(0, np.int32))
    kernel = Kernel(ADD_ONE, inputs={"x": stream}, outputs=stream)
    counters = Counters()
    assert kernel.execute(counters=counters) == 0
    assert kernel.loop() == 1
    assert counters.passes[0].record_count == 0
    assert kernel.run() == Count(1, 1, 0)


def test_two_kernels_may_be_alike_and_names_may_be_any():
    """Names of the source do not meet those of the code around it."""
    stream = Stream(np.ones(3, np.float32))
    source = """
        struct i { at: f32 }
        const targets = 2.0;
        fn flat(at: f32) -> i { return i(at * targets); }
    """
    kernels = [Kernel(source, inputs={"at": stream}, outputs=stream) for _ in range(2)]
    for kernel in kernels:
        assert kernel.execute() == 3
    assert stream.array.tolist() == [4, 4, 4]
    assert repr(kernels[0]) == "<Kernel 'flat': 3 records>"
