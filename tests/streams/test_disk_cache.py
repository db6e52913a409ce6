"""Loops around users' functions are cached on disk, and recompiled when anything changes."""

from pathlib import Path

import raystream
from forks import run_fresh

SOURCE = Path(raystream.__file__).parents[1]

HELPER = """
from raystream.streams import device

FACTOR = 2.0

@device
def scaled(x):
    return x * FACTOR
"""

PROGRAM = """
import helper
import numpy as np
from helper import scaled
from raystream.streams import Kernel, Stream

def scale(x, y):
    return scaled(x) + OFFSET + y

def through_module(x):
    return helper.scaled(x)

OFFSET = 1.0
stream = Stream(np.ones(3))
kernel = Kernel(scale, inputs={"x": stream}, outputs=stream, constants={"y": 0.0})
kernel.execute()
loop = kernel._loop()
print(stream.array[0], loop.compiled_count)
kernel = Kernel(through_module, inputs={"x": stream}, outputs=stream)
kernel.execute()
print(kernel._loop().is_cached)
"""


def run(folder):
    variables = {"RAYSTREAM_CACHE_DIR": str(folder / "cache")}
    return run_fresh(folder / "program.py", [SOURCE], variables)


def test_what_a_kernel_uses_decides_whether_its_code_is_up_to_date(tmp_path):
    (tmp_path / "helper.py").write_text(HELPER)
    (tmp_path / "program.py").write_text(PROGRAM)
    assert run(tmp_path) == ["3.0", "1", "False"]
    assert run(tmp_path) == ["3.0", "0", "False"]
    (tmp_path / "program.py").write_text("\n\n" + PROGRAM)  # other lines, the same code
    assert run(tmp_path) == ["3.0", "0", "False"]
    (tmp_path / "helper.py").write_text(HELPER.replace("2.0", "5.0"))
    assert run(tmp_path) == ["6.0", "1", "False"]
    (tmp_path / "program.py").write_text(PROGRAM.replace("OFFSET = 1.0", "OFFSET = 2.0"))
    assert run(tmp_path) == ["7.0", "1", "False"]
    (tmp_path / "helper.py").write_text(HELPER)
    (tmp_path / "program.py").write_text(PROGRAM)
    assert run(tmp_path) == ["3.0", "0", "False"]
