import enum
import math
from types import SimpleNamespace

import numpy as np
import pytest

from raystream.jit import cpu
from raystream.jit.cpu import device
from raystream.jit.fingerprint import fingerprint


def define(text, name="f", **names):
    """A function from text, as from some user's module."""
    namespace = {"__name__": "users", **names}
    exec(text, namespace)
    return namespace[name]


SCALE = "def f(x):\n    return x * scale"


def test_it_is_the_same_for_the_same_code_wherever_it_stands():
    assert fingerprint(define(SCALE, scale=2)) == fingerprint(define("\n\n" + SCALE, scale=2))
    often = define(SCALE, scale=2)
    for _ in range(1000):  # Python adapts the code of what runs often
        often(1)
    assert fingerprint(often) == fingerprint(define(SCALE, scale=2))
    assert len(fingerprint(often)) == 32


@pytest.mark.parametrize(
    "other",
    [
        define("def f(x):\n    return x + scale", scale=2),
        define("def f(y):\n    return y * scale", scale=2),
        define("def f(x, y=1):\n    return x * scale", scale=2),
        define("def f(x):\n    return x * scale * 3", scale=2),
        define(SCALE, scale=2.0),
        define(SCALE, scale=np.float32(2)),
        define(SCALE, scale=(2, 3)),
        define(SCALE, scale=np.arange(3)),
        define(SCALE, scale=np.arange(3.0)),
        define(SCALE, scale=np),
        define(SCALE, scale=math.sin),
        define(SCALE, scale=np.sin),
        define(SCALE, scale=np.float32),
    ],
)
def test_any_difference_shows(other):
    assert fingerprint(other) not in (None, fingerprint(define(SCALE, scale=2)))


CALLER = "def f(x):\n    return g(x)"


def test_called_functions_count(monkeypatch):
    first = device(define("def g(x):\n    return x + h(x)", "g", h=device(lambda x: x)))
    second = device(define("def g(x):\n    return x + h(x)", "g", h=device(lambda x: -x)))
    found = {fingerprint(define(CALLER, g=g)) for g in (first, second)}
    assert len(found) == 2
    monkeypatch.setitem(cpu.FLAGS, "fastmath", True)
    fast = device(first.py_func)
    assert fingerprint(define(CALLER, g=fast)) != fingerprint(define(CALLER, g=first))


def test_names_inside_of_inner_code_count():
    inner = "def f(x):\n    def g(y):\n        return y * scale\n    return g(x)"
    assert fingerprint(define(inner, scale=1)) != fingerprint(define(inner, scale=2))


def closure(value):
    return lambda x: x + value


class Colour(enum.IntEnum):
    RED = 1


def test_variables_from_outside_count():
    assert fingerprint(closure(1)) == fingerprint(closure(1))
    assert len({fingerprint(closure(v)) for v in (1, 2, 1.0, Colour.RED, "a", None)}) == 6


def test_functions_that_call_themselves():
    text = "def f(x):\n    return f(x - 1) if x > 0 else 0"
    assert fingerprint(define(text)) == fingerprint(define(text))


@pytest.mark.parametrize(
    "value", [object(), SimpleNamespace(a=1), SimpleNamespace, enum, np.array([None]), {1: 2}]
)
def test_what_cannot_be_told_is_not_kept(value):
    assert fingerprint(define(SCALE, scale=value)) is None


def test_a_missing_name_is_not_kept():
    assert fingerprint(define(SCALE)) is None
