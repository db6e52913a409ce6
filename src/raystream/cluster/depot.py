"""Depot: the scheduler's store of parcels, from which workers fetch what they lack.

The scheduler is the one place that every worker can reach, that outlives workers, and that knows
when a client leaves. It holds manifests; and of arrays either their bytes or, where it shares the
client's machine, maps of the client's files, which take no memory of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from distributed.diagnostics.plugin import SchedulerPlugin
from numpy.typing import NDArray

from raystream.cluster.folder import map_array
from raystream.cluster.parcels import Manifest
from raystream.core.memory import check_memory

if TYPE_CHECKING:
    from distributed.scheduler import Scheduler

__all__ = ["BLOCK_BYTES", "DEPOT", "Depot"]

#: The plugin's name, and that of the operation that it adds to the scheduler.
DEPOT = "raystream-depot"

#: Bytes of an array that travel in one message.
BLOCK_BYTES = 1 << 24

Answer = dict[str, Any]


class Depot(SchedulerPlugin):
    """Parcels of all clients of one scheduler.

    Parcels stay as long as a client holds them: until it releases them, or leaves.
    """

    name = DEPOT
    idempotent = True  # the first client's serves all

    def __init__(self) -> None:
        self._manifests: dict[str, Manifest] = {}
        self._holders: dict[str, dict[str, int]] = {}  # parcel: client: how often
        self._folders: dict[str, Mapping[str, str]] = {}  # parcel: where it may be mapped
        self._arrays: dict[str, NDArray[np.uint8]] = {}  # bytes, or maps
        self._parts: dict[tuple[str, str], NDArray[np.uint8]] = {}  # client, array: on the way

    async def start(self, scheduler: Scheduler) -> None:
        """Answer from now on."""
        self.__init__()  # type: ignore[misc] # it came as a pickle of an empty one
        scheduler.handlers[DEPOT] = self.answer

    def remove_client(self, scheduler: Scheduler, client: str) -> None:  # noqa: ARG002
        """Let go of what only a client that left has held."""
        for key in [key for key in self._parts if key[0] == client]:
            del self._parts[key]
        for digest in list(self._holders):
            if self._holders[digest].pop(client, None) is not None:
                self._clear(digest)

    def answer(self, do: str, **arguments: Any) -> Answer:
        """Answer a client or a worker."""
        operations: dict[str, Callable[..., Answer]] = {
            "offer": self._offer,
            "put": self._put,
            "release": self._release,
            "manifest": self._manifest,
            "fetch": self._fetch,
        }
        return operations[do](**arguments)

    def _offer(self, client: str, text: str, where: Mapping[str, str]) -> Answer:
        """Take a parcel in, and say which arrays are to be put."""
        manifest = Manifest.read(text)
        digest = manifest.digest
        held = self._holders.setdefault(digest, {})
        held[client] = held.get(client, 0) + 1
        self._manifests[digest] = manifest
        self._folders[digest] = dict(where)
        missing = {}
        for place in manifest.arrays.values():
            if place.byte_count and place.digest not in self._arrays:
                mapped = map_array(where, place)
                if mapped is None:
                    missing[place.digest] = place
                else:
                    self._arrays[place.digest] = mapped.reshape(-1).view(np.uint8)
        byte_count = sum(place.byte_count for place in missing.values())
        try:
            check_memory(byte_count, "scheduler: a scene's arrays would")
        except MemoryError:
            self._release(client, digest)
            raise
        return {"missing": sorted(missing)}

    def _put(self, client: str, digest: str, size: int, begin: int, content: bytes) -> Answer:
        """Take a part of an array's bytes; the parts of each come in order."""
        if begin == 0:
            self._parts[client, digest] = np.empty(size, np.uint8)
        end = begin + len(content)
        self._parts[client, digest][begin:end] = np.frombuffer(content, np.uint8)
        if end == size:
            self._arrays[digest] = self._parts.pop((client, digest))
        return {}

    def _release(self, client: str, digest: str) -> Answer:
        """Let go of a parcel once."""
        held = self._holders.get(digest, {})
        if client in held:
            held[client] -= 1
            if held[client] <= 0:
                del held[client]
            self._clear(digest)
        return {}

    def _clear(self, digest: str) -> None:
        """Forget a parcel that nobody holds, and arrays of no other."""
        if self._holders.get(digest):
            return
        self._holders.pop(digest, None)
        self._folders.pop(digest, None)
        self._manifests.pop(digest, None)
        kept = {p.digest for m in self._manifests.values() for p in m.arrays.values()}
        self._arrays = {name: array for name, array in self._arrays.items() if name in kept}

    def _manifest(self, digest: str) -> Answer:
        """What a parcel holds, and where it may be mapped."""
        manifest = self._manifests.get(digest)
        if manifest is None:
            return {"text": None}
        return {"text": manifest.text, "where": self._folders[digest]}

    def _fetch(self, digest: str, begin: int) -> Answer:
        """A part of an array's bytes."""
        array = self._arrays.get(digest)
        if array is None:
            return {"content": None}
        return {"content": array[begin : begin + BLOCK_BYTES].tobytes()}
