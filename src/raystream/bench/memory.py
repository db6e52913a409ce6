"""Memory: resident size of a contender's structure, measured in a separate process."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from raystream.bench.contenders import Entry, make_contender
from raystream.bench.contenders.base import Contender, Geometry, Rays, warmup_geometry

__all__ = ["Memory", "can_measure", "measure_memory"]

_STATUS = Path("/proc/self/status")

#: Writing this resets the peak to the current resident size.
_CLEAR, _RESET_PEAK = Path("/proc/self/clear_refs"), "5"


class Memory(NamedTuple):
    """Memory of a contender, in bytes.

    Parameters
    ----------
    kept : int
        Growth after the build: the structure, and its copy of the triangles.
    peak : int
        Peak growth during the build, including the caller's arrays.

    Notes
    -----
    Both are growth of the resident size since before the scene's arrays were read. By then the
    package has been imported, has built a small scene and traced some rays, so that neither
    its code nor what it compiles counts. After the build the caller's arrays are
    freed, and the allocator returns what it can.
    """

    kept: int
    peak: int


def can_measure() -> bool:
    """Whether the system reports a process's resident size (Linux does)."""
    return _STATUS.exists()


def measure_memory(entry: Entry, geometry: Geometry, threads: int) -> Memory | None:
    """Build in a separate process, and measure its memory.

    Parameters
    ----------
    entry : Entry
    geometry : Geometry
    threads : int

    Returns
    -------
    Memory or None
        None if the system does not report it, or the process failed (out of memory, say).
    """
    if not can_measure():
        return None
    source = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    with tempfile.TemporaryDirectory(prefix="raystream-bench-") as folder:
        np.save(Path(folder) / "vertices.npy", geometry.vertices)
        np.save(Path(folder) / "faces.npy", geometry.faces)
        task = json.dumps([*entry, threads, folder])
        done = subprocess.run(
            [sys.executable, "-m", "raystream.bench.memory", task],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
        )
    if done.returncode:
        return None
    return Memory(*json.loads(done.stdout.splitlines()[-1]))


def _measure(contender: Contender, folder: Path) -> Memory:
    """Build and measure in this process."""
    contender.build(warmup_geometry())
    rays = Rays(np.zeros((9, 3), np.float32), np.ones((9, 3), np.float32), np.inf)
    for query in sorted(contender.queries):
        contender.run(query, rays, contender.modes[0])
    contender.release()
    _free_memory()
    _reset_peak()
    before = _status("VmRSS")
    geometry = Geometry(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy"))
    contender.build(geometry)
    peak = _status("VmHWM")
    del geometry
    _free_memory()
    return Memory(_status("VmRSS") - before, peak - before)


def _free_memory() -> None:
    """Return freed memory to the system."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError, TypeError):  # glibc only
        ctypes.CDLL(None).malloc_trim(0)


def _reset_peak() -> None:
    with contextlib.suppress(OSError):  # otherwise the peak of the import remains, which is low
        _CLEAR.write_text(_RESET_PEAK, encoding="ascii")


def _status(field: str) -> int:
    """Read a size from the process's status, in bytes."""
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) * 1024
    raise LookupError(field)


def _main() -> None:
    label, name, options, threads, folder = json.loads(sys.argv[1])
    contender = make_contender(Entry(label, name, options), threads)
    print(json.dumps(_measure(contender, Path(folder))))  # noqa: T201 - to the parent


if __name__ == "__main__":
    _main()
