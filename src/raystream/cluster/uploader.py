"""Uploader: sends a client's bundles to its cluster's scheduler."""

from __future__ import annotations

import contextlib
import weakref
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from raystream.cluster.bundles import Bundle
from raystream.cluster.errors import ClusterError
from raystream.cluster.fetch import UPLOADED, forget
from raystream.cluster.folder import SharedFolder, machine_name
from raystream.cluster.scheduler_store import BLOCK_BYTES, STORE, SchedulerStore

if TYPE_CHECKING:
    import numpy as np
    from distributed import Client
    from numpy.typing import NDArray


class Uploader:
    """Uploads the bundles of one client; use `uploader_of` to get it.

    Arrays are also written to a folder for processes on this machine. The folder is deleted
    when this process ends or the client is gone.

    Parameters
    ----------
    client : distributed.Client

    Raises
    ------
    ClusterError
        If the scheduler cannot store bundles.
    """

    def __init__(self, client: Client) -> None:
        self._of = weakref.ref(client)  # lives no longer than the client
        self._folder = SharedFolder()
        self._counts: dict[str, int] = {}
        try:
            client.register_plugin(SchedulerStore())
        except Exception as error:  # anything raised on the scheduler arrives here
            raise ClusterError(
                "the cluster's scheduler cannot serve raystream: it needs the same packages as "
                f"this process, and must allow plugins ({type(error).__name__}: {error})"
            ) from error

    @property
    def _client(self) -> Client:
        client = self._of()
        if client is None:
            raise ClusterError("the cluster's client is gone; create a new one")
        return client

    @property
    def where(self) -> dict[str, str]:
        """Where arrays may be mapped; see `folder.map_array`."""
        folder = self._folder
        return {"machine": machine_name(), "path": folder.path, "token": folder.token}

    def send(self, bundle: Bundle) -> str:
        """Make a bundle available to all workers.

        Returns
        -------
        str
            Its name, for `fetch.fetch`; call `release` once per call of `send`.

        Raises
        ------
        ClusterError
            If the scheduler does not answer.
        MemoryError
            If it cannot hold the bundle.
        """
        manifest = bundle.manifest()
        digest = manifest.digest
        arrays = {
            ref.digest: bundle.arrays[name]
            for name, ref in manifest.arrays.items()
            if ref.byte_count
        }
        for name, array in arrays.items():
            self._folder.add(name, array)
        offered = self._request("offer", text=manifest.text, where=self.where)
        for name in offered["missing"]:
            self._put(name, arrays[name])
        self._counts[digest] = self._counts.get(digest, 0) + 1
        UPLOADED[digest] = manifest, self.where
        return digest

    def release(self, digest: str) -> None:
        """Drop one reference to a bundle; workers cannot fetch it after the last one."""
        if digest not in self._counts:
            return
        is_tracer = "structure" in UPLOADED[digest][0].header
        self._counts[digest] -= 1
        if not self._counts[digest]:
            del self._counts[digest]
            manifest = UPLOADED.pop(digest)[0]
            kept = {ref.digest for n in self._counts for ref in UPLOADED[n][0].arrays.values()}
            for ref in manifest.arrays.values():
                if ref.digest not in kept:
                    self._folder.remove(ref.digest)
        if self._client.status == "running":
            self._request("release", digest=digest)
            if is_tracer and digest not in self._counts:
                with contextlib.suppress(OSError):  # a worker is leaving
                    self._client.run(forget, digest, on_error="ignore")

    def _put(self, digest: str, array: NDArray[Any]) -> None:
        content = _bytes_of(array)
        for begin in range(0, len(content), BLOCK_BYTES):
            part = content[begin : begin + BLOCK_BYTES].tobytes()
            self._request("put", digest=digest, size=len(content), begin=begin, content=part)

    def _request(self, do: str, **arguments: Any) -> dict[str, Any]:
        client = self._client
        if do in ("offer", "put", "release"):
            arguments["client"] = client.id
        try:
            operation = getattr(client.scheduler, STORE)
            answer: dict[str, Any] = client.sync(operation, do=do, **arguments)
        except (OSError, ValueError) as error:  # ValueError: the client was closed
            raise ClusterError(f"the cluster's scheduler does not answer: {error}") from error
        return answer


def _bytes_of(array: NDArray[Any]) -> NDArray[np.uint8]:
    import numpy as np

    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)


_uploaders: WeakKeyDictionary[Client, Uploader] = WeakKeyDictionary()


def uploader_of(client: Client) -> Uploader:
    """Return the uploader of a client."""
    uploader = _uploaders.get(client)
    if uploader is None:
        uploader = _uploaders[client] = Uploader(client)
    return uploader
