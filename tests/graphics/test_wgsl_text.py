"""Reading a kernel's source: functions, structures, comments, lines."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from raystream.graphics.streams.wgsl_text import Function, Member, Structure, WgslText


def test_functions_with_parameters_and_results():
    text = WgslText(
        "const A = 3;\n"
        "fn half(x: f32) -> f32 { return 0.5 * x; }\n"
        "\n"
        "fn step(  a : vec2 < f32 > ,\n b: array<vec3<u32>, 4>,) -> Records { return f(a, b); }\n"
        "fn nothing() {}\n"
    )
    assert text.functions() == [
        Function("half", 2, (Member("x", "f32"),), "f32"),
        Function("step", 4, (Member("a", "vec2f"), Member("b", "array<vec3u,4>")), "Records"),
        Function("nothing", 6, (), ""),
    ]


def test_comments_are_not_read():
    text = WgslText(
        "// fn a(x: f32) -> f32 { /* discard;\n"
        "/* fn b() /* nested */ discard; // */ fn c(x /* : i32 */ : f32) -> f32 {\n"
        "  return x; // discard\n"
        "}\n"
    )
    assert [one.name for one in text.functions()] == ["c"]
    assert text.functions()[0] == Function("c", 2, (Member("x", "f32"),), "f32")
    assert not text.has_word("discard")
    assert text.with_word("discard", "no") == text.text


def test_words_are_replaced_outside_comments_only():
    text = WgslText("discard; /* discard */ discards; discard // discard\ndiscard;")
    assert text.has_word("discard")
    assert text.with_word("discard", "no()") == (
        "no(); /* discard */ discards; no() // discard\nno();"
    )


def test_structures_by_name():
    text = WgslText(
        "struct A { x: f32, @align(16) y: u32 } struct Both { n: i32, at: vec4<f32>, };"
    )
    both = text.structure("Both")
    assert both is not None
    assert both.members == (Member("n", "i32"), Member("at", "vec4f"))
    assert text.structure("C") is None


@pytest.mark.parametrize(
    ("text", "functions", "structure"),
    [
        ("", [], None),
        ("fn", [], None),
        ("fn a(", [Function("a", 1, (), "")], None),
        ("fn a(x: f32", [Function("a", 1, (Member("x", "f32"),), "")], None),
        ("struct A {", [], Structure("A", ())),
        ("/*", [], None),
        ("fn a)(", [], None),
    ],
)
def test_incomplete_sources_are_read_as_far_as_they_go(text, functions, structure):
    assert WgslText(text).functions() == functions
    assert WgslText(text).structure("A") == structure


@given(st.text(alphabet="fn ab/*\n(){}<>,:->;@é", max_size=200))
def test_any_text_keeps_its_length_and_lines(text):
    read = WgslText(text)
    assert len(read.bare) == len(text)
    assert [i for i, letter in enumerate(text) if letter == "\n"] == [
        i for i, letter in enumerate(read.bare) if letter == "\n"
    ]
    read.functions()
    assert read.with_word("a", "a") == text


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("x" * 4_000 + ";" + "y " * 4_000 + "{" * 100 + "}" * 100, None),
        ("\n" + "x" * 4_001 + ";", (2, "a statement has more than 4,000 characters")),
        ("y " * 4_001, (1, "a statement has more than 4,000 characters")),
        ("\n\n" + "(" * 101, (3, "brackets are nested over 100 deep")),
        ("/*" + "(" * 5_000 + "*/", None),
        ("fn a() {}" * 1000, None),
        (
            "fn a() {}" * 1000 + "\nelse",
            (2, "the source has more than 1,000 declarations and branches"),
        ),
        (";" * 100_001, (1, "the source has more than 100,000 characters")),
    ],
)
def test_sources_that_would_exhaust_the_compiler(text, found):
    assert WgslText(text).too_large() == found


def test_a_long_source_takes_linear_time():
    text = "fn a(x: f32) -> f32 { return x; }\n" + "/* // ( { < */ b(c);\n" * 20_000
    assert len(WgslText(text).functions()) == 1
