"""Memory: what a contender's structure takes, measured in a process of its own."""

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
from raystream.bench.contenders.base import Contender, Geometry, Rays, practice_geometry

__all__ = ["Memory", "can_measure", "measure_memory"]

_STATUS = Path("/proc/self/status")

#: Written there, the peak starts anew from what is resident.
_CLEAR, _RESET_PEAK = Path("/proc/self/clear_refs"), "5"


class Memory(NamedTuple):
    """Memory of a contender, in bytes.

    Parameters
    ----------
    kept : int
        Resident after the build: the structure, and its copy of the triangles.
    peak : int
        Most that was resident during the build, the caller's arrays included.

    Notes
    -----
    Both are growth: what was resident before the scene's arrays were read is taken off. The
    package was imported by then, had built a small scene and traced some rays, so that neither
    its code nor what it compiles counts. After the build the caller's arrays are
    dropped, and the allocator returns what it can.
    """

    kept: int
    peak: int


def can_measure() -> bool:
    """Whether the system tells a process what is resident (Linux does)."""
    return _STATUS.exists()


def measure_memory(entry: Entry, geometry: Geometry, threads: int) -> Memory | None:
    """Build in another process, and see what it takes.

    Parameters
    ----------
    entry : Entry
    geometry : Geometry
    threads : int

    Returns
    -------
    Memory or None
        None where the system does not tell, or the process failed (for want of memory, say).
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
    contender.build(practice_geometry())
    rays = Rays(np.zeros((9, 3), np.float32), np.ones((9, 3), np.float32), np.inf)
    for query in sorted(contender.queries):
        contender.ask(query, rays, contender.modes[0])
    contender.release()
    _settle()
    _reset_peak()
    before = _status("VmRSS")
    geometry = Geometry(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy"))
    contender.build(geometry)
    peak = _status("VmHWM")
    del geometry
    _settle()
    return Memory(_status("VmRSS") - before, peak - before)


def _settle() -> None:
    """Give back what nobody holds."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError, TypeError):  # only glibc has it
        ctypes.CDLL(None).malloc_trim(0)


def _reset_peak() -> None:
    with contextlib.suppress(OSError):  # else the peak of the import stays, and is low
        _CLEAR.write_text(_RESET_PEAK, encoding="ascii")


def _status(field: str) -> int:
    """A size from the process's status, in bytes."""
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
