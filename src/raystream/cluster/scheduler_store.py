"""SchedulerStore: the scheduler's store of bundles, from which workers fetch missing ones.

The scheduler is the only process that every worker can reach, that outlives workers, and that
notices when a client leaves. It holds manifests and, for each array, either its bytes or, on the
client's machine, a memory map of the client's file, which takes no memory of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from distributed.diagnostics.plugin import SchedulerPlugin
from numpy.typing import NDArray

from raystream.cluster.bundles import Manifest
from raystream.cluster.folder import map_array
from raystream.core.memory import check_memory

if TYPE_CHECKING:
    from distributed.scheduler import Scheduler

#: Name of the plugin, and of the operation that it adds to the scheduler.
STORE = "raystream-store"

#: Bytes of an array sent in one message.
BLOCK_BYTES = 1 << 24

Response = dict[str, Any]


class SchedulerStore(SchedulerPlugin):
    """Bundles of all clients of one scheduler.

    A bundle stays while any client holds it: until the client releases it or leaves.
    """

    name = STORE
    idempotent = True  # the first client's instance serves all

    def __init__(self) -> None:
        self._manifests: dict[str, Manifest] = {}
        self._holders: dict[str, dict[str, int]] = {}  # bundle: client: reference count
        self._folders: dict[str, Mapping[str, str]] = {}  # bundle: folder to map it from
        self._arrays: dict[str, NDArray[np.uint8]] = {}  # bytes or memory maps
        self._parts: dict[tuple[str, str], NDArray[np.uint8]] = {}  # client, array: incomplete

    async def start(self, scheduler: Scheduler) -> None:
        """Register the operation with the scheduler."""
        self.__init__()  # type: ignore[misc] # it arrives as a pickle of an empty instance
        scheduler.handlers[STORE] = self.handle

    def remove_client(self, scheduler: Scheduler, client: str) -> None:  # noqa: ARG002
        """Release everything held only by a client that left."""
        for key in [key for key in self._parts if key[0] == client]:
            del self._parts[key]
        for digest in list(self._holders):
            if self._holders[digest].pop(client, None) is not None:
                self._clear(digest)

    def handle(self, do: str, **arguments: Any) -> Response:
        """Handle a request of a client or a worker."""
        operations: dict[str, Callable[..., Response]] = {
            "offer": self._offer,
            "put": self._put,
            "release": self._release,
            "manifest": self._manifest,
            "fetch": self._fetch,
        }
        return operations[do](**arguments)

    def _offer(self, client: str, text: str, where: Mapping[str, str]) -> Response:
        """Register a bundle, and return which arrays to upload."""
        manifest = Manifest.read(text)
        digest = manifest.digest
        held = self._holders.setdefault(digest, {})
        held[client] = held.get(client, 0) + 1
        self._manifests[digest] = manifest
        self._folders[digest] = dict(where)
        missing = {}
        for ref in manifest.arrays.values():
            if ref.byte_count and ref.digest not in self._arrays:
                mapped = map_array(where, ref)
                if mapped is None:
                    missing[ref.digest] = ref
                else:
                    self._arrays[ref.digest] = mapped.reshape(-1).view(np.uint8)
        byte_count = sum(ref.byte_count for ref in missing.values())
        try:
            check_memory(byte_count, "scheduler: a scene's arrays would")
        except MemoryError:
            self._release(client, digest)
            raise
        return {"missing": sorted(missing)}

    def _put(self, client: str, digest: str, size: int, begin: int, content: bytes) -> Response:
        """Store a part of an array's bytes; the parts of an array arrive in order."""
        if begin == 0:
            self._parts[client, digest] = np.empty(size, np.uint8)
        end = begin + len(content)
        self._parts[client, digest][begin:end] = np.frombuffer(content, np.uint8)
        if end == size:
            self._arrays[digest] = self._parts.pop((client, digest))
        return {}

    def _release(self, client: str, digest: str) -> Response:
        """Drop one reference to a bundle."""
        held = self._holders.get(digest, {})
        if client in held:
            held[client] -= 1
            if held[client] <= 0:
                del held[client]
            self._clear(digest)
        return {}

    def _clear(self, digest: str) -> None:
        """Delete a bundle without references, and arrays that no other bundle uses."""
        if self._holders.get(digest):
            return
        self._holders.pop(digest, None)
        self._folders.pop(digest, None)
        self._manifests.pop(digest, None)
        kept = {p.digest for m in self._manifests.values() for p in m.arrays.values()}
        self._arrays = {name: array for name, array in self._arrays.items() if name in kept}

    def _manifest(self, digest: str) -> Response:
        """Return a bundle's manifest, and where its arrays may be mapped."""
        manifest = self._manifests.get(digest)
        if manifest is None:
            return {"text": None}
        return {"text": manifest.text, "where": self._folders[digest]}

    def _fetch(self, digest: str, begin: int) -> Response:
        """Return a part of an array's bytes."""
        array = self._arrays.get(digest)
        if array is None:
            return {"content": None}
        return {"content": array[begin : begin + BLOCK_BYTES].tobytes()}
