"""Fetching: how a worker comes by a parcel, and the tracer that is in it.

A worker asks its scheduler's depot, at the first task that needs a parcel; so one that joins
late or starts again does as the first ones did. What shares the client's machine maps its
files. A process keeps the tracers that it used last, for all of its threads.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import numpy as np
from distributed import get_worker
from distributed.utils import sync
from numpy.typing import NDArray

from raystream.cluster.depot import DEPOT
from raystream.cluster.errors import ClusterError
from raystream.cluster.folder import map_array
from raystream.cluster.parcels import ArrayPlace, Manifest
from raystream.cluster.tracers import unpack_tracer
from raystream.core.memory import check_memory
from raystream.tracer import Tracer

__all__ = ["SENT", "Kept", "fetch", "forget", "tracer_of"]

#: Tracers that a process keeps; those that were used longest ago go first.
TRACER_COUNT = 4

#: Times that a worker asks anew if a connection breaks.
_TRIES = 5

#: What this process has sent itself: manifests, and where the arrays may be mapped.
SENT: dict[str, tuple[Manifest, dict[str, str]]] = {}

T = TypeVar("T")

_arrays: WeakValueDictionary[str, NDArray[Any]] = WeakValueDictionary()


class Kept:
    """Things by name: each is made once, by the thread that first asks for it.

    Parameters
    ----------
    count : int
        How many are kept.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._made: OrderedDict[Any, Any] = OrderedDict()
        self._locks: dict[Any, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, name: Any, make: Callable[[], T]) -> T:
        """The one of a name."""
        with self._lock:
            own = self._locks.setdefault(name, threading.Lock())
        with own:
            with self._lock:
                if name in self._made:
                    self._made.move_to_end(name)
                    found: T = self._made[name]
                    return found
            made = make()
            with self._lock:
                self._made[name] = made
                while len(self._made) > self._count:
                    self._made.popitem(last=False)
                self._locks = {n: lock for n, lock in self._locks.items() if lock.locked()}
            return made

    def forget(self, name: Any) -> None:
        """Keep the one of a name no longer."""
        with self._lock:
            self._made.pop(name, None)


_tracers = Kept(TRACER_COUNT)


def forget(digest: str) -> None:
    """Keep the tracer of a parcel no longer; run on each worker when it is released."""
    _tracers.forget(digest)


def tracer_of(digest: str) -> Tracer:
    """The tracer of a parcel, on the worker that asks."""
    return _tracers.get(digest, lambda: unpack_tracer(*fetch(digest)))


def fetch(digest: str) -> tuple[Mapping[str, Any], dict[str, NDArray[Any]]]:
    """A parcel's header and arrays.

    Raises
    ------
    ClusterError
        If it was released, or the scheduler does not answer.
    MemoryError
        If it does not fit into this worker's memory.
    """
    try:
        worker = get_worker()
    except ValueError:  # a thread of the client itself: Dask's schedulers without a cluster
        worker = None
    if worker is None:
        manifest, where = _found_here(digest)
    else:
        answer = _ask(worker, do="manifest", digest=digest)
        if answer["text"] is None:
            raise _released()
        manifest, where = Manifest.read(answer["text"]), answer["where"]
    arrays = {name: _array(worker, where, place) for name, place in manifest.arrays.items()}
    return manifest.header, arrays


def _array(worker: Any, where: Mapping[str, str], place: ArrayPlace) -> NDArray[Any]:
    found = _arrays.get(place.digest)
    if found is None:
        if not place.byte_count:
            found = np.empty(place.shape, place.dtype)
        else:
            mapped = map_array(where, place)
            found = _received(worker, place) if mapped is None else mapped
        _arrays[place.digest] = found
    return found


def _received(worker: Any, place: ArrayPlace) -> NDArray[Any]:
    """An array from the scheduler, part by part."""
    if worker is None:
        raise ClusterError(
            "arrays of a cluster's tracer are computed on the cluster: make its client the "
            "default, or use client.compute"
        )
    check_memory(place.byte_count, "an array of a scene would")
    content = np.empty(place.byte_count, np.uint8)
    begin = 0
    while begin < len(content):
        part = _ask(worker, do="fetch", digest=place.digest, begin=begin)["content"]
        if not part:
            raise _released()
        content[begin : begin + len(part)] = np.frombuffer(part, np.uint8)
        begin += len(part)
    return content.view(place.dtype).reshape(place.shape)


def _found_here(digest: str) -> tuple[Manifest, dict[str, str]]:
    sent = SENT.get(digest)
    if sent is None:
        raise _released()
    return sent


def _released() -> ClusterError:
    return ClusterError("the tracer that this work needs was closed, or its client is gone")


def _ask(worker: Any, **arguments: Any) -> dict[str, Any]:
    """Ask the worker's scheduler, from a thread that runs a task."""
    operation = getattr(worker.scheduler, DEPOT)
    for left in reversed(range(_TRIES)):
        try:
            answer: dict[str, Any] = sync(worker.loop, operation, **arguments)
            return answer
        except OSError as error:  # Dask's errors of connections are
            if not left:
                raise ClusterError(f"the scheduler does not answer: {error}") from error
    raise AssertionError
