"""Edits of the sources: kernels that are recompiled, and no kernel that is ever stale."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import raystream
from conftest import child_environment

PACKAGE = Path(raystream.__file__).parent

#: Fingerprints of all kernels, and which functions each of them reaches: found by walking what
#: their names stand for, which is not how fingerprints are made.
KEYS = """
import dis, importlib, json, pkgutil
import raystream
from numba.core.dispatcher import Dispatcher
from raystream.jit.cache import KERNELS
from raystream.jit.fingerprint import fingerprint

for room in ("kernels", "structures", "rendering", "physics", "machines"):
    for found in pkgutil.walk_packages([f"{raystream.__path__[0]}/{room}"], f"raystream.{room}."):
        importlib.import_module(found.name)

def reach(dispatcher, met):
    # Functions that another one makes have the same name.
    function = dispatcher.py_func
    if dispatcher not in met:
        met[dispatcher] = f"{function.__module__}.{function.__qualname__}"
        steps = dis.get_instructions(function)
        used = [function.__globals__.get(s.argval) for s in steps if s.opname == "LOAD_GLOBAL"]
        used += [cell.cell_contents for cell in function.__closure__ or ()]
        for value in used:
            if isinstance(value, Dispatcher):
                reach(value, met)
    return met

keys = {name: fingerprint(kernel) for name, kernel in KERNELS.items()}
reached = {name: sorted(reach(kernel, {}).values()) for name, kernel in KERNELS.items()}
print(json.dumps([keys, reached]))
"""

#: A query and an image: the number of kernels requested, and those compiled.
PROGRAM = """
import json
import raystream as rs
from raystream.jit.cache import KERNELS
scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
for structure in ("brute", "grid"):
    tracer = rs.Tracer(scene, structure)
    assert tracer.first_hit([0.2, 0.2, 1], [0, 0, -1]).t == 1
asked = {name for name, kernel in KERNELS.items() if kernel.overloads}
compiled = {name for name, kernel in KERNELS.items() if sum(kernel.stats.cache_misses.values())}
print(json.dumps([sorted(asked), sorted(compiled)]))
"""


@pytest.fixture
def source(tmp_path):
    """A copy of the package, to be edited."""
    package = tmp_path / "src" / "raystream"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    return package


def run(program: str, package: Path):
    environment = {
        **child_environment(),
        "PYTHONPATH": str(package.parent),
        "RAYSTREAM_CACHE_DIR": str(package.parents[1] / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def edit(package: Path, place: str, old: str, new: str) -> None:
    file = package / place
    text = file.read_text()
    assert text.count(old) == 1, (place, text.count(old))
    file.write_text(text.replace(old, new))


#: A module's and a function's docstring, a comment that moves all lines, a help text, a constant
#: of the host; and docstrings of what runs at compile time.
HARMLESS = [
    ("kernels/slab.py", '"""', '"""Edited. '),
    ("jit/intrinsics.py", '"""', '"""Edited. '),
    ("jit/simd/types.py", 'class VectorType(types.Type):\n    """', None),
    ("structures/grid/build.py", "from __future__", "# A comment.\n\n\nfrom __future__"),
    ("jit/simd/lanes.py", "from __future__", "# A comment.\n\n\nfrom __future__"),
    ("cli/query.py", "With .zarr:", "With a store:"),
]


#: The slab test, and one line of it.
SLAB_FUNCTION = "raystream.kernels.slab.box_interval"
SLAB = ("kernels/slab.py", "fma(low_x, ray.inv_x, ray.near_x)", "fma(low_x, ray.inv_x, ray.far_x)")


def test_an_edit_recompiles_what_depends_on_it_and_nothing_else(source):
    keys, reached = run(KEYS, source)
    assert len(keys) > 80
    assert None not in keys.values()
    asked, compiled = run(PROGRAM, source)
    assert asked == compiled
    assert len(asked) >= 3
    for place, old, new in HARMLESS:
        file = source / place
        text = file.read_text()
        new = old + "Edited. " if new is None else new
        assert old in text, place
        file.write_text(text.replace(old, new, 1))
    assert run(KEYS, source)[0] == keys
    assert run(PROGRAM, source) == [asked, []]
    # One line of the slab test.
    edit(source, *SLAB)
    after = run(KEYS, source)[0]
    users = {name for name, functions in reached.items() if SLAB_FUNCTION in functions}
    assert {name for name in keys if after[name] != keys[name]} == users
    assert 10 < len(users) < len(keys)
    assert run(PROGRAM, source) == [asked, sorted(users & set(asked))]


#: Modules with everything that code can depend on; the numbers in ⟨⟩ are drawn.
MODULES = {
    "kernels/mutant_deep.py": """
from raystream.jit.cpu import device
SCALE = ⟨scale⟩
TABLE = (⟨first⟩, ⟨second⟩)
@device
def deepest(x):
    return x * SCALE + TABLE[0] - TABLE[1]
""",
    "kernels/mutant_middle.py": """
import enum
from raystream.jit.cpu import device
from raystream.jit.mutant_intrinsic import mixed
from raystream.kernels import mutant_constants
from raystream.kernels.mutant_deep import deepest
class Kind(enum.IntEnum):
    ONE = ⟨kind⟩
@device
def middle(x):
    return deepest(x) ⟨operator⟩ mixed(x, ⟨added⟩)
@device
def named(⟨arguments⟩, more=⟨default⟩):
    return 100 * one + other + 7 * more + mutant_constants.FAR + 11 * Kind.ONE
""",
    "kernels/mutant_constants.py": """
FAR = ⟨far⟩
""",
    "jit/mutant_intrinsic.py": """
from numba import types
from numba.extending import intrinsic
def _extra():
    return ⟨extra⟩
@intrinsic
def mixed(typing_context, x, y):
    def generate(context, builder, signature, arguments):
        found = builder.⟨instruction⟩(arguments[0], arguments[1])
        return builder.add(found, context.get_constant(types.int64, _extra()))
    return types.int64(types.int64, types.int64), generate
""",
    "kernels/mutant.py": """
from typing import NamedTuple
import numpy as np
from raystream.jit.cpu import device, kernel
from raystream.kernels.mutant_middle import middle, named
class Pair(NamedTuple):
    ⟨field⟩: int
    ⟨other_field⟩: int
ARRAY = np.array([⟨element⟩, 5])
def _made(number, inner):
    @kernel
    def closed(x, pair):
        made = Pair(2 * x, 3 * x)
        return number * inner(x) + pair.left + made.right + ARRAY[0]
    return closed
@device
def _inside(x):
    return middle(x) + named(⟨positions⟩)
closed = _made(⟨number⟩, _inside)
""",
}

START = {
    "scale": 3, "first": 5, "second": 2, "kind": 1, "operator": "+", "added": 4, "default": 1,
    "arguments": "one, other", "far": 9, "extra": 6, "instruction": "add", "field": "left",
    "other_field": "right", "element": 8, "number": 2, "positions": "1, 2",
}  # fmt: skip

OPERATORS = {"+": int.__add__, "-": int.__sub__, "*": int.__mul__}
INSTRUCTIONS = {"add": int.__add__, "sub": int.__sub__, "mul": int.__mul__}


def answer_of(state, x=13) -> int:
    """The kernel's expected result, in plain Python."""
    deepest = x * state["scale"] + state["first"] - state["second"]
    mixed = INSTRUCTIONS[state["instruction"]](x, state["added"]) + state["extra"]
    middle = OPERATORS[state["operator"]](deepest, mixed)
    one, other = (1, 2) if state["arguments"] == "one, other" else (2, 1)
    if state["positions"] == "2, 1":
        one, other = other, one
    named = 100 * one + other + 7 * state["default"] + state["far"] + 11 * state["kind"]
    is_left_first = state["field"] == "left"
    left = 1000 if is_left_first else 2000  # of Pair(1000, 2000)
    right = 3 * x if is_left_first else 2 * x
    return state["number"] * (middle + named) + left + right + state["element"]


def mutated(state, rng: random.Random):
    """The state with one thing changed, such that the answer changes."""
    while True:
        new = dict(state)
        what = rng.choice(sorted(set(START) - {"other_field"}))
        if what == "operator":
            new[what] = rng.choice(sorted(OPERATORS))
        elif what == "instruction":
            new[what] = rng.choice(sorted(INSTRUCTIONS))
        elif what == "arguments":
            new[what] = {"one, other": "other, one", "other, one": "one, other"}[state[what]]
        elif what == "positions":
            new[what] = {"1, 2": "2, 1", "2, 1": "1, 2"}[state[what]]
        elif what == "field":
            new["field"], new["other_field"] = state["other_field"], state["field"]
        else:
            new[what] = rng.randrange(1, 50)
        if answer_of(new) != answer_of(state):
            return new


#: The parent imports Numba once; each state is read by a fork of it that has read no other.
WALK = """
import json, os, sys
from pathlib import Path
import numba, raystream.jit.cpu
package = Path(raystream.jit.cpu.__file__).parents[1]
for line in sys.stdin:
    for place, text in json.loads(line).items():
        (package / place).write_text(text)
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        from raystream.kernels.mutant import Pair, closed
        found = int(closed(13, Pair(1000, 2000)))
        print(json.dumps([found, sum(closed.stats.cache_misses.values())]), flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""


def texts_of(state) -> dict[str, str]:
    texts = dict(MODULES)
    for name, value in state.items():
        texts = {place: text.replace(f"⟨{name}⟩", str(value)) for place, text in texts.items()}
    assert not any("⟨" in text for text in texts.values())
    return texts


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that fork")
def test_nothing_is_stale_after_fifty_mutations(source, tmp_path):
    """All states share one cache; each has its own answer, also when it comes back."""
    rng = random.Random(2002)
    states = [START]
    while len(states) < 51:
        states.append(mutated(states[-1], rng))
    again = rng.sample(states, 8)
    lines = [json.dumps(texts_of(state)) for state in [*states, *again]]
    environment = {
        **child_environment(),
        "PYTHONPATH": str(source.parent),
        "RAYSTREAM_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", WALK],
        input="\n".join(lines),
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert [answer for answer, _ in found] == [answer_of(s) for s in [*states, *again]], done.stderr
    distinct = len({json.dumps(texts_of(state)) for state in states})
    assert sum(compiled for _, compiled in found[:51]) == distinct
    assert sum(compiled for _, compiled in found[51:]) == 0  # they are all still there
