"""Mistakes in users' kernels are one clear error, with the kernel's name and the line."""

from __future__ import annotations

import numpy as np
import pytest

from raystream import streams as cpu
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.streams import INDEX, GatherArray, Kernel, Stream

COPY = "fn copy(x: f32) -> f32 { return x; }"


@pytest.fixture(autouse=True)
def device(opened: OpenDevice) -> OpenDevice:
    return opened


@pytest.fixture
def x() -> Stream:
    return Stream(np.zeros(4, np.float32), name="mine")


# Sources


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("fn f(x: f32) -> f32 {\n\n    let y: u32 = 1.5;\n    return x;\n}", "kernel f, line 3: "),
        (
            "// one\nfn f(x: f32) -> f32 {\n    return y;\n}",
            "kernel f, line 3: no definition .*`y`",
        ),
        ("fn f(x: f32) -> f32 {\n    if x > 0.0 { return x; }\n}", "kernel f, line 1: .*return"),
        ("fn f(x: f32) -> f32 { return x }", "kernel f, line 1: expected"),
        ("fn f(x: f32) -> f32 { return 1.0 / 0.0; }", "kernel f, line 1: Divide"),
        ("fn f(x: f32) -> f32 { return f(x); }", "kernel f, line 1: .*recursive"),
        ("alias T = u32;\nfn f(x: T) -> f32 { return f32(x); }", "kernel f: .*meets streams"),
    ],
)
def test_a_source_that_does_not_compile(x, capfd, source, message):
    with pytest.raises(GraphicsError, match=message) as caught:
        Kernel(source, inputs={"x": x}, outputs=x)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
    assert Kernel(COPY, inputs={"x": x}, outputs=x).execute() == 4  # the device still works


@pytest.mark.parametrize(
    ("source", "error", "message"),
    [
        (3, TypeError, "kernel: expected a source in WGSL, got 3"),
        ("const a = 1;", TypeError, "kernel: its source has no function"),
        (f"{COPY}\nfn other() {{}}", TypeError, "has the functions copy, other; choose one"),
        (
            "\n@fragment fn main(x: f32) -> f32 {}",
            ValueError,
            "main, line 2: @fragment is an entry",
        ),
        (f"@group(0) var<storage> a: f32;{COPY}", ValueError, "copy, line 1: @group binds"),
        (
            f"{COPY}\nconst raystream_i = 1;",
            ValueError,
            "line 2: raystream_i is a name that begins",
        ),
        ("fn cover(x: f32) -> f32 { return x; }", ValueError, "fn cover is the name of the vertex"),
        ("fn f(x: f32) {}", TypeError, "f: the function returns nothing"),
        (f"\n{'(' * 9999}", ValueError, "kernel, line 2: brackets are nested over 100 deep"),
        (
            "fn f(x: f32, y: f32) -> f32 {}",
            TypeError,
            "the parameter 'y' is not an input or constant",
        ),
        ("fn f() -> f32 { return 1.0; }", TypeError, "f: the function has no parameter 'x'"),
        ("fn f(x: vec2<f32>) -> f32 {}", TypeError, "input 'x': is declared as vec2f, .* has f32"),
        ("fn f(x: f32) -> u32 {}", TypeError, "f, its result: is declared as u32, but .* has f32"),
        (
            "struct R { a: f32, b: f32 } fn f(x: f32) -> R {}",
            TypeError,
            "1 outputs, but R has 2 members",
        ),
        ("struct R { a: i32 } fn f(x: f32) -> R {}", TypeError, "R.a: is declared as i32"),
    ],
)
def test_a_function_that_does_not_fit(x, source, error, message):
    with pytest.raises(error, match=message) as caught:
        Kernel(source, inputs={"x": x}, outputs=x)
    assert "\n" not in str(caught.value)


def test_a_function_that_the_source_does_not_have(x):
    with pytest.raises(TypeError, match="mine: its source has no function 'paste'; it has copy"):
        Kernel(COPY, "paste", inputs={"x": x}, outputs=x, name="mine")


# Streams, gather arrays, constants


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"inputs": {"x": [1.0]}}, TypeError, "input 'x': expected a Stream of .*, got list"),
        (
            {"inputs": {"x": cpu.Stream.zeros(4)}},
            TypeError,
            "expected a Stream of raystream.graphics.streams, got raystream.streams.stream.Stream",
        ),
        ({"outputs": []}, ValueError, "copy: a kernel writes at least one stream"),
        ({"outputs": [3]}, TypeError, "copy, outputs: expected a Stream .*, got int"),
        ({"constants": {"x": 1}}, TypeError, "copy: 'x' is declared twice"),
        ({"constants": {"step": 1}}, TypeError, "copy: the function has no parameter 'step'"),
        ({"gathers": {"table": [1.0]}}, TypeError, "does not call the gather array 'table'"),
        ({"gathers": {"copy": [1.0]}}, TypeError, "does not call|declares 'copy'"),
        ({"gathers": {"a b": [1.0]}}, TypeError, "'a b' is not a name in WGSL"),
        ({"where": [1, 2, 3, 4]}, TypeError, "copy, where: expected a comparison .*int64"),
        ({"where": [True]}, ValueError, "copy, where: stream 'where' has 1 records, .* have 4"),
        ({"where": cpu.Stream.zeros(4) == 0}, TypeError, "compares stream, which is on the CPU"),
    ],
)
def test_what_does_not_fit_a_kernel(x, change, error, message):
    with pytest.raises(error, match=message):
        Kernel(COPY, **{"inputs": {"x": x}, "outputs": x, **change})


def test_streams_of_different_lengths(x):
    with pytest.raises(ValueError, match="copy: its streams differ in length: 3, 4 records"):
        Kernel(COPY, inputs={"x": x}, outputs=Stream.zeros(3))
    with pytest.raises(ValueError, match="writes a stream twice"):
        Kernel(COPY, inputs={"x": x}, outputs=[x, x])
    with pytest.raises(TypeError, match="has 2 outputs, but the function returns f32"):
        Kernel(COPY, inputs={"x": x}, outputs=[x, Stream.zeros(4)])


def test_types_of_index_constants_and_conditions(x):
    with pytest.raises(TypeError, match="input 'x': INDEX is i32 or u32, not f32"):
        Kernel(COPY, inputs={"x": INDEX}, outputs=x)
    with pytest.raises(TypeError, match="constant 'x': is declared as bool; constants are f32"):
        Kernel("fn f(x: bool) -> f32 {}", outputs=x, constants={"x": True})
    with pytest.raises(TypeError, match="constant 'x': f32 cannot hold '1'"):
        Kernel(COPY, outputs=x, constants={"x": "1"})
    with pytest.raises(TypeError, match="the gather array 'x' is a parameter; call it"):
        Kernel(COPY, outputs=x, gathers={"x": x})
    counts = Stream.zeros(4, np.int32)
    with pytest.raises(TypeError, match=r"copy, where: i32 cannot hold 0\.5"):
        Kernel(COPY, inputs={"x": x}, outputs=x, where=counts < 0.5)


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        (np.zeros(3), TypeError, "do not compute with dtype float64; use float32, int32 or uint32"),
        ([True], TypeError, "dtype bool"),
        (np.zeros(2, [("a", "f4")]), TypeError, "dtype"),
        (np.zeros((2, 1), "f4"), ValueError, r"\(N, 2\) to \(N, 4\), got \(2, 1\)"),
        (np.zeros((2, 5), "f4"), ValueError, r"got \(2, 5\)"),
        (np.zeros((2, 2, 2), "f4"), ValueError, r"got \(2, 2, 2\)"),
    ],
)
def test_what_is_no_stream(values, error, message):
    with pytest.raises(error, match=f"stream 'mine': .*{message}"):
        Stream(values, name="mine")


def test_what_is_no_gather_array(x):
    with pytest.raises(ValueError, match=r"4 records cannot have shape \(2, 3\)"):
        GatherArray(x, (2, 3))
    with pytest.raises(ValueError, match=r"gather array 'a': expected at least 2 dimension"):
        GatherArray([1.0], vectors=True, name="a")
    with pytest.raises(TypeError, match="is a stream of another device"):
        GatherArray(cpu.Stream.zeros(4))
    with pytest.raises(TypeError, match="do not compute with dtype float64"):
        Kernel(
            "fn f(i: i32) -> f32 { return t(i); }",
            inputs={"i": INDEX},
            outputs=x,
            gathers={"t": [1.0]},
        )


def test_the_cpus_kernels_take_no_streams_of_this_device(x):
    with pytest.raises(TypeError, match=r"expected a Stream, got a Stream of raystream\.graphics"):
        cpu.Kernel(lambda x: x, inputs={"x": x}, outputs=cpu.Stream.zeros(4))
    with pytest.raises(TypeError, match="outputs: expected streams, got a Stream of raystream"):
        cpu.Kernel(lambda x: x, inputs={"x": cpu.Stream.zeros(4)}, outputs=[x])


# Devices


def test_streams_that_do_not_fit(opened, monkeypatch):
    monkeypatch.setitem(opened.limits, "max-texture-dimension-2d", 64)
    assert len(Stream.zeros(64 * 64)) == 64 * 64
    with pytest.raises(GraphicsError, match="stream 'big': 64 x 65 texels are more than the 64"):
        Stream.zeros(64 * 64 + 1, name="big")


def test_more_streams_than_a_program_can_read(opened, monkeypatch, x):
    monkeypatch.setitem(opened.limits, "max-sampled-textures-per-shader-stage", 1)
    source = "fn f(x: f32, y: f32) -> f32 { return x + y; }"
    with pytest.raises(GraphicsError, match=r"kernel f: reads 2 streams .* allows 1"):
        Kernel(source, inputs={"x": x, "y": Stream.zeros(4)}, outputs=x)


def test_a_lost_device_is_said_and_new_streams_open_another(fresh, capfd):
    old = Stream.zeros(4)
    kernel = Kernel(COPY, inputs={"x": old}, outputs=old)
    fresh.device.destroy()
    capfd.readouterr()
    for call in (kernel.execute, lambda: old.array, lambda: old.assign(1)):
        with pytest.raises(GraphicsError, match=r"was lost .*; make a new tracer or new streams"):
            call()
    assert capfd.readouterr() == ("", "")
    new = Stream.zeros(4)
    assert Kernel(COPY, inputs={"x": new}, outputs=new).execute() == 4
    with pytest.raises(GraphicsError, match=r"copy, input 'x': is on .*opened at another time"):
        Kernel(COPY, inputs={"x": new}, outputs=[old])
