"""Options: values are checked against the annotations, and converted."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from raystream.core.options import Options, Range


@dataclass(frozen=True, kw_only=True)
class Made(Options):
    name = "made"
    kind: Literal["round", "square"] = "square"
    size: Annotated[int, Range(1, 32)] = 4
    share: Annotated[float, Range(1e-6, 1e6)] = 1.0
    depth: Annotated[int | None, Range(0)] = None
    is_open: bool = False
    other: Any = None


def test_values_are_converted():
    made = Made(size=np.int64(7), share=2, depth=np.uint8(3), is_open=1)  # type: ignore[arg-type]
    assert [type(value) for value in dataclasses.astuple(made)[1:5]] == [int, float, int, bool]
    assert made == Made(size=7, share=2.0, depth=3, is_open=True)


def test_what_differs_from_the_defaults():
    assert Made().given() == {}
    assert Made(size=4, share=2.0, kind="round").given() == {"kind": "round", "share": 2.0}
    assert Made.names() == ("kind", "size", "share", "depth", "is_open", "other")


def test_choices_begin_with_the_default():
    assert Made.choices("kind") == ("square", "round")
    assert Made.choices("size") == Made.choices("nothing") == ()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"kind": "flat"}, ValueError, "kind: expected one of 'round', 'square', got 'flat'"),
        ({"kind": ["round"]}, ValueError, r"kind: expected one of .*, got \['round'\]"),
        ({"kind": None}, ValueError, "kind: expected one of"),
        ({"size": 0}, ValueError, "^size: expected 1 to 32, got 0"),
        ({"size": 33}, ValueError, "^size: expected 1 to 32, got 33"),
        ({"size": 4.0}, TypeError, "^size: 'float' object cannot"),
        ({"size": None}, TypeError, "^size: "),
        ({"share": 0}, ValueError, "^share: expected 1e-6 to 1e6, got 0.0"),
        ({"share": float("nan")}, ValueError, "^share: expected 1e-6 to 1e6, got nan"),
        ({"share": "much"}, ValueError, "^share: could not convert"),
        ({"depth": -1}, ValueError, "^depth: expected at least 0, got -1"),
        ({"length": 3}, TypeError, "length"),
    ],
)
def test_what_is_not_allowed_is_named(options, error, words):
    with pytest.raises(error, match=words):
        Made(**options)


def test_json_holds_all_of_them():
    made = Made(kind="round", depth=5)
    assert Made.from_json(json.loads(json.dumps(made.as_json()))) == made


@pytest.mark.parametrize(
    "change",
    [
        {"size": 0},
        {"size": "4"},
        {"share": 10**400},
        {"kind": {}},
        {"more": 1},
    ],
)
def test_bad_json_is_a_value_error(change):
    with pytest.raises(ValueError, match=":"):
        Made.from_json({**Made().as_json(), **change})


@pytest.mark.parametrize("values", [None, [], {}, "size", {"size": 4}])
def test_json_of_something_else_is_a_value_error(values):
    with pytest.raises(ValueError, match="invalid options: expected kind, size"):
        Made.from_json(values)
