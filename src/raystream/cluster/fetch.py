"""Fetch bundles, and the tracers in them, on a worker.

A worker requests a bundle from its scheduler's store at the first task that needs it, so workers
that join late or restart behave like the first ones. Workers on the client's machine map its
files. A process caches its most recently used tracers for all of its threads.
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

from raystream.cluster.bundles import ArrayRef, Manifest
from raystream.cluster.errors import ClusterError
from raystream.cluster.folder import map_array
from raystream.cluster.scheduler_store import STORE
from raystream.cluster.tracer_bundles import unpack_tracer
from raystream.core.memory import check_memory
from raystream.tracer import Tracer

#: Cached tracers per process; the least recently used are evicted first.
TRACER_COUNT = 4

#: Attempts before a broken connection is an error.
_ATTEMPTS = 5

#: Bundles uploaded by this process: manifests, and where the arrays may be mapped.
UPLOADED: dict[str, tuple[Manifest, dict[str, str]]] = {}

T = TypeVar("T")

_arrays: WeakValueDictionary[str, NDArray[Any]] = WeakValueDictionary()


class OnceCache:
    """An LRU cache in which each value is made once, by the first thread that requests it.

    Parameters
    ----------
    count : int
        Capacity.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._made: OrderedDict[Any, Any] = OrderedDict()
        self._locks: dict[Any, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, name: Any, make: Callable[[], T]) -> T:
        """Return the value of a name, making it if necessary."""
        with self._lock:
            own = self._locks.setdefault(name, threading.Lock())
        with own:
            with self._lock:
                if name in self._made:
                    self._made.move_to_end(name)
                    return self._made[name]
            made = make()
            with self._lock:
                self._made[name] = made
                while len(self._made) > self._count:
                    self._made.popitem(last=False)
                self._locks = {n: lock for n, lock in self._locks.items() if lock.locked()}
            return made

    def forget(self, name: Any) -> None:
        """Remove the value of a name."""
        with self._lock:
            self._made.pop(name, None)


_tracers = OnceCache(TRACER_COUNT)


def forget(digest: str) -> None:
    """Evict the tracer of a bundle; runs on each worker when the bundle is released."""
    _tracers.forget(digest)


def tracer_of(digest: str) -> Tracer:
    """Return the tracer of a bundle, on a worker."""
    return _tracers.get(digest, lambda: unpack_tracer(*fetch(digest)))


def fetch(digest: str) -> tuple[Mapping[str, Any], dict[str, NDArray[Any]]]:
    """Fetch a bundle's header and arrays.

    Raises
    ------
    ClusterError
        If the bundle was released, or the scheduler does not answer.
    MemoryError
        If it does not fit in this worker's memory.
    """
    try:
        worker = get_worker()
    except ValueError:  # a thread of the client itself, under Dask's local schedulers
        worker = None
    if worker is None:
        manifest, where = _uploaded_here(digest)
    else:
        answer = _request(worker, do="manifest", digest=digest)
        if answer["text"] is None:
            raise _released()
        manifest, where = Manifest.read(answer["text"]), answer["where"]
    arrays = {name: _array(worker, where, ref) for name, ref in manifest.arrays.items()}
    return manifest.header, arrays


def _array(worker: Any, where: Mapping[str, str], ref: ArrayRef) -> NDArray[Any]:
    found = _arrays.get(ref.digest)
    if found is None:
        if not ref.byte_count:
            found = np.empty(ref.shape, ref.dtype)
        else:
            mapped = map_array(where, ref)
            found = _receive(worker, ref) if mapped is None else mapped
        _arrays[ref.digest] = found
    return found


def _receive(worker: Any, ref: ArrayRef) -> NDArray[Any]:
    """Fetch an array from the scheduler, part by part."""
    if worker is None:
        raise ClusterError(
            "arrays of a cluster's tracer must be computed on the cluster: make its client the "
            "default, or call client.compute"
        )
    check_memory(ref.byte_count, "an array of a scene would")
    content = np.empty(ref.byte_count, np.uint8)
    begin = 0
    while begin < len(content):
        part = _request(worker, do="fetch", digest=ref.digest, begin=begin)["content"]
        if not part:
            raise _released()
        content[begin : begin + len(part)] = np.frombuffer(part, np.uint8)
        begin += len(part)
    return content.view(ref.dtype).reshape(ref.shape)


def _uploaded_here(digest: str) -> tuple[Manifest, dict[str, str]]:
    sent = UPLOADED.get(digest)
    if sent is None:
        raise _released()
    return sent


def _released() -> ClusterError:
    return ClusterError("the tracer of this task was closed, or its client is gone")


def _request(worker: Any, **arguments: Any) -> dict[str, Any]:
    """Send a request to the worker's scheduler, from a thread that runs a task."""
    operation = getattr(worker.scheduler, STORE)
    for left in reversed(range(_ATTEMPTS)):
        try:
            return sync(worker.loop, operation, **arguments)
        except OSError as error:  # includes Dask's connection errors
            if not left:
                raise ClusterError(f"the scheduler does not answer: {error}") from error
    raise AssertionError
