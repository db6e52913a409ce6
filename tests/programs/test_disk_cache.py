"""Programs are cached on disk: a second process does not compile."""

import contextlib
import os
from pathlib import Path

import raystream
from forks import run_fresh
from raystream.core.cache_folder import kernel_folder

SOURCE = Path(raystream.__file__).parents[1]

SCRIPT = """
import numpy as np
import raystream as rs
from raystream.jit import user_loops

RECORD = np.dtype([("hits", "i8"), ("depth", "f8")])

def add_up(hit, payload):
    payload.hits += 1
    payload.depth += STEP * hit.t
    if payload.hits == 2:
        return rs.Decision.STOP

def not_the_first(hit):
    return hit.prim_id > 0 or rs.Decision.IGNORE == 0

STEP = 1.0
vertices = np.array([[x, y, z] for z in (1, 2, 3) for x, y in ((0, 0), (4, 0), (0, 4))], float)
tracer = rs.Tracer(rs.Scene.from_arrays(vertices, np.arange(9).reshape(3, 3)), "brute")
ray = [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]
record = tracer.trace(*ray, on_hit=add_up, payload=RECORD)
first = tracer.first_hit(*ray, on_hit=not_the_first)
compiled = sum(loop.compiled_count for loop in user_loops._COMPILED.values())
print(record["depth"], first.prim_id, compiled)
"""


def run(folder):
    variables = {"RAYSTREAM_CACHE_DIR": str(folder / "cache")}
    return run_fresh(folder / "script.py", [SOURCE], variables)


def take_kernels(folder):
    """Our own kernels need not be compiled again: files of those that there are."""
    folder.mkdir(parents=True, mode=0o700)
    for path in kernel_folder().glob("*.nbc"):
        with contextlib.suppress(FileNotFoundError):
            os.link(path, folder / path.name)


def test_a_second_process_does_not_compile(tmp_path):
    with contextlib.suppress(OSError):  # no links there
        take_kernels(tmp_path / "cache" / "kernels")
    (tmp_path / "script.py").write_text(SCRIPT)
    assert run(tmp_path) == ["3.0", "1", "2"]
    assert run(tmp_path) == ["3.0", "1", "0"]
    (tmp_path / "script.py").write_text(SCRIPT.replace("STEP = 1.0", "STEP = 2.0"))
    assert run(tmp_path) == ["6.0", "1", "1"]
