"""Worker: the process of one contender, which builds and traces on request.

Requests and answers are lines of JSON on the standard input and output; arrays are in files. What
packages print goes to the standard error.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from raystream.bench.agreement import count_hits, outcome
from raystream.bench.contenders import Peer, load_contender
from raystream.bench.contenders.base import (
    NO_INSTANCES,
    Contender,
    Geometry,
    Placed,
    Points,
    Query,
    Rays,
    UnavailableError,
    warmup_geometry,
)
from raystream.bench.memory import MemoryGauge

Item = TypeVar("Item")

#: ``PR_SET_PDEATHSIG`` of ``linux/prctl.h``.
_PARENT_DEATH_SIGNAL = 1

#: File of a scene's instances.
_PLACED = "placed.npz"

#: File of a kept outcome.
OUTCOME = "outcome.npy"

#: File of a set of points.
_POINTS = "points.npy"


def save_geometry(folder: Path, geometry: Geometry) -> None:
    """Write triangles for `load_geometry`."""
    np.save(folder / "vertices.npy", geometry.vertices)
    np.save(folder / "faces.npy", geometry.faces)
    if geometry.placed is not None:
        np.savez(folder / _PLACED, **geometry.placed._asdict())


def load_geometry(folder: Path) -> Geometry:
    """Read the triangles of a scene."""
    placed = None
    if (folder / _PLACED).exists():
        with np.load(folder / _PLACED) as arrays:
            placed = Placed(**arrays)
    return Geometry(np.load(folder / "vertices.npy"), np.load(folder / "faces.npy"), placed)


def save_rays(folder: Path, rays: Rays | Points) -> None:
    """Write rays or points for `load_rays`."""
    if isinstance(rays, Points):
        np.save(folder / _POINTS, rays.points)
        np.save(folder / "unit.npy", np.float64(rays.unit))
        return
    np.save(folder / "origins.npy", rays.origins)
    np.save(folder / "directions.npy", rays.directions)
    np.save(folder / "t_max.npy", np.float64(rays.t_max))


def load_rays(folder: Path) -> Rays | Points:
    """Read the rays or points of a set, C-contiguous and in memory."""
    if (folder / _POINTS).exists():
        return Points(np.load(folder / _POINTS), float(np.load(folder / "unit.npy")))
    origins, directions = np.load(folder / "origins.npy"), np.load(folder / "directions.npy")
    return Rays(origins, directions, float(np.load(folder / "t_max.npy")))


class _Worker:
    """The state of the process: a contender, and the rays of the current set."""

    def __init__(self) -> None:
        self._contender: Contender | None = None
        self._rays: tuple[str, Rays | Points] | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request: ``do`` is a method's name, the rest its arguments."""
        names: dict[str, Callable[..., dict[str, Any]]] = {
            "open": self._open,
            "build": self._build,
            "trace": self._trace,
        }
        return names[request.pop("do")](**request)

    @property
    def contender(self) -> Contender:
        assert self._contender is not None, "open first"
        return self._contender

    def _open(
        self,
        adapter: Sequence[Any],
        options: dict[str, Any],
        threads: int,
        queries: Sequence[Query],
    ) -> dict[str, Any]:
        """Import the package, and try the queries: triggers loading and compilation."""
        started = time.perf_counter()
        contender = load_contender(Peer(*adapter), options, threads)
        contender.build(warmup_geometry())
        rays = Rays(np.zeros((2048, 3), np.float32), np.ones((2048, 3), np.float32), np.inf)
        points = Points(np.linspace([0, 0, 0], [1, 1, 1], 2048, dtype=np.float32), 1.0)
        for query in sorted(contender.queries.intersection(queries)):
            for mode in contender.modes:
                contender.run(query, points if query == "closest" else rays, mode)
        contender.release()
        self._contender = contender
        return {
            "version": contender.version,
            "notes": contender.notes,
            "modes": contender.modes,
            "queries": sorted(contender.queries),
            "watertight": contender.is_watertight,
            "seconds": time.perf_counter() - started,
        }

    def _build(self, folder: str, measured: bool) -> dict[str, Any]:
        """Build; and measure memory, if this is the first build."""
        self.contender.release()
        gauge = MemoryGauge() if measured else None
        geometry = load_geometry(Path(folder))
        if geometry.placed is not None and not self.contender.has_instances:
            raise UnavailableError(NO_INSTANCES)
        seconds, _ = _timed(self.contender.build, geometry)
        if gauge is None:
            return {"seconds": seconds}
        peak = gauge.peak()
        del geometry
        memory = gauge.memory(peak)
        return {"seconds": seconds, "memory": None if memory is None else memory._asdict()}

    def _trace(self, folder: str, query: Query, mode: str, keep: str | None) -> dict[str, Any]:
        """Trace a set; write its outcome to a folder if asked."""
        if self._rays is None or self._rays[0] != folder:
            self._rays = folder, load_rays(Path(folder))
        seconds, result = _timed(self.contender.run, query, self._rays[1], mode)
        answer: dict[str, Any] = {"seconds": seconds}
        if keep is not None:
            found = outcome(result, self._rays[1])
            np.save(Path(keep) / OUTCOME, found)
            answer["hits"] = count_hits(query, found)
        return answer


def _timed(call: Callable[..., Item], *arguments: Any) -> tuple[float, Item]:
    gc.collect()
    gc.disable()
    try:
        started = time.perf_counter()
        result = call(*arguments)
        return time.perf_counter() - started, result
    finally:
        gc.enable()


def _end_with_parent() -> None:
    """Let Linux kill this process when the thread that started it ends.

    A killed bench cannot end its workers, and one that is stopped does not notice by itself.
    """
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid()
    number, none = ctypes.c_ulong(signal.SIGKILL), ctypes.c_ulong(0)
    ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, number, none, none, none)
    if os.getppid() != parent:  # it ended before; if even earlier, the standard input is at its end
        sys.exit(1)


def main() -> None:
    """Answer requests until the standard input ends."""
    _end_with_parent()
    # The bench decides what a Ctrl-C ends.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    worker = _Worker()
    for line in sys.stdin:
        try:
            answer = worker.answer(json.loads(line))
        except UnavailableError as error:
            answer = {"error": str(error)}
        except Exception as error:  # third-party packages can raise anything
            answer = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
