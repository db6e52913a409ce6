import enum
import importlib
import math
import pkgutil
from collections import namedtuple
from types import ModuleType, SimpleNamespace

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import raystream
from raystream.core import rays
from raystream.jit import cpu
from raystream.jit.cache import KernelCache
from raystream.jit.cpu import device
from raystream.jit.fingerprint import _Reader, fingerprint, type_name


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


INNER = "def f(x):\n    def g(y):\n        '''{}.'''\n        return y\n    return g(x)"


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("def f(x):\n    '''One.'''\n    return x", "def f(x):\n    '''Two.'''\n    return x"),
        ("def f(x):\n    return x", "def f(x):\n    # A comment.\n\n    return x"),
        (INNER.format("One"), INNER.format("Two")),
    ],
)
def test_docstrings_and_comments_do_not_count(one, other):
    assert fingerprint(define(one)) == fingerprint(define(other)) is not None


def test_a_string_that_is_returned_counts_also_where_it_is_the_docstring():
    for text in ("def f():\n    '{0}'\n    return '{0}'", "def f():\n    return '{0}'"):
        assert fingerprint(define(text.format("a"))) != fingerprint(define(text.format("b")))


def pair(*numbers):
    """Two functions that call each other."""
    text = "def f(x):\n    return g(x - 1) if x > 0 else 0\ndef g(x):\n    return f(x - {}) + {}"
    namespace = {"__name__": "users"}
    exec(text.format(*numbers), namespace)
    return namespace["f"], namespace["g"]


def test_functions_that_call_each_other():
    """Whichever of them is met first."""
    first, second, third, other = pair(1, 2), pair(1, 2), pair(1, 2), pair(1, 3)
    assert fingerprint(first[0]) == fingerprint(second[0])
    assert fingerprint(first[1]) == fingerprint(second[1])
    assert fingerprint(third[1]) == fingerprint(first[1])
    assert fingerprint(third[0]) == fingerprint(first[0])
    assert fingerprint(other[0]) != fingerprint(first[0])
    assert fingerprint(other[1]) != fingerprint(first[1])


def test_what_is_read_of_our_modules_counts(monkeypatch):
    found = set()
    for limit in (1, 2):
        monkeypatch.setattr(rays, "LIMIT", limit, raising=False)
        found.add(fingerprint(define("def f(x):\n    return x + rays.LIMIT", rays=rays)))
    assert len(found) == 2
    assert None not in found


def test_names_of_modules_are_those_that_the_code_reads():
    """Not those that happen to be imported already, nor fields of the same name."""
    inner = ModuleType("raystream.late.inner")
    inner.LIMIT = 1
    package = ModuleType("raystream.late")
    package.__getattr__ = SimpleNamespace(Late=7, inner=inner).__getattribute__
    text = "def f(x):\n    return x.thickness + late.Late + late.inner.LIMIT"
    function = define(text, late=package)
    before = fingerprint(function)
    package.Late, package.thickness = 7, object()
    assert fingerprint(define(text, late=package)) == before is not None
    inner.LIMIT = 2
    assert fingerprint(define(text, late=package)) != before
    assert fingerprint(define("def f(x):\n    return late", late=package)) is None
    assert fingerprint(define("def f(x):\n    return late.none", late=package)) is None


def test_types_of_named_tuples_have_their_fields():
    """Two classes of one name, with the same types in another order: Numba names them alike."""
    made = [namedtuple("Found", fields)(1, 2) for fields in (("t", "count"), ("count", "t"))]
    for wrap in (lambda one: one, lambda one: (one, 1.0)):
        types = [numba.typeof(wrap(one)) for one in made]
        assert str(types[0]) == str(types[1])
        assert type_name(types[0]) != type_name(types[1])


def test_types_of_functions_say_what_these_do():
    functions = [device(closure(value)) for value in (1, 2, 1, object())]
    names = [type_name(numba.typeof(function)) for function in functions]
    assert names[0] == names[2] != names[1]
    assert names[3] is None


def test_every_kernel_of_ours_has_a_fingerprint():
    """Otherwise it would be compiled in every process."""
    rooms = ("kernels", "structures", "machines", "rendering", "physics", "programs", "jit", "lab")
    kernels = set()
    for found in pkgutil.walk_packages(raystream.__path__, "raystream."):
        if found.name.split(".")[1] in rooms and not found.name.startswith("raystream.jit.cuda"):
            values = vars(importlib.import_module(found.name)).values()
            kernels |= {
                value
                for value in values
                if isinstance(value, Dispatcher) and isinstance(value._cache, KernelCache)
            }
    assert len(kernels) > 80
    assert [kernel for kernel in kernels if fingerprint(kernel) is None] == []


def test_of_numpy_only_the_minor_version_counts():
    def described(name, version):
        module = ModuleType(name)
        module.__version__ = version
        return _Reader().describe(module)

    for name in ("numpy", "numpy.linalg"):
        assert described(name, "2.4.6") == described(name, "2.4.7")
        assert described(name, "2.4.6") != described(name, "2.5.0")
    assert described("numba", "0.68.1") != described("numba", "0.68.2")
