"""Post: sends a client's parcels to the scheduler of its cluster."""

from __future__ import annotations

import contextlib
import weakref
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from raystream.cluster.depot import BLOCK_BYTES, DEPOT, Depot
from raystream.cluster.errors import ClusterError
from raystream.cluster.fetching import SENT, forget
from raystream.cluster.folder import SharedFolder, machine_name
from raystream.cluster.parcels import Parcel

if TYPE_CHECKING:
    import numpy as np
    from distributed import Client
    from numpy.typing import NDArray

__all__ = ["Post", "post_of"]


class Post:
    """The parcels of one client; `post_of` makes it.

    Their arrays lie in a folder, too, for who shares this machine. It is removed when this
    process ends or the client is gone.

    Parameters
    ----------
    client : distributed.Client

    Raises
    ------
    ClusterError
        If the scheduler cannot keep parcels.
    """

    def __init__(self, client: Client) -> None:
        self._of = weakref.ref(client)  # the client's end is this one's
        self._folder = SharedFolder()
        self._counts: dict[str, int] = {}
        try:
            client.register_plugin(Depot())
        except Exception as error:  # whatever its side raises comes here
            raise ClusterError(
                "the cluster's scheduler cannot serve raystream: it needs the same packages as "
                f"here, and to allow plugins ({type(error).__name__}: {error})"
            ) from error

    @property
    def _client(self) -> Client:
        client = self._of()
        if client is None:
            raise ClusterError("the cluster's client is gone; make a new one")
        return client

    @property
    def where(self) -> dict[str, str]:
        """Where arrays may be mapped; see `folder.map_array`."""
        folder = self._folder
        return {"machine": machine_name(), "path": folder.path, "token": folder.token}

    def send(self, parcel: Parcel) -> str:
        """Have a parcel where all workers can fetch it.

        Returns
        -------
        str
            Its name, for `fetching.fetch`; `release` it as often as it is sent.

        Raises
        ------
        ClusterError
            If the scheduler does not answer.
        MemoryError
            If it cannot hold the parcel.
        """
        manifest = parcel.manifest()
        digest = manifest.digest
        arrays = {
            place.digest: parcel.arrays[name]
            for name, place in manifest.arrays.items()
            if place.byte_count
        }
        for name, array in arrays.items():
            self._folder.add(name, array)
        offered = self._ask("offer", text=manifest.text, where=self.where)
        for name in offered["missing"]:
            self._put(name, arrays[name])
        self._counts[digest] = self._counts.get(digest, 0) + 1
        SENT[digest] = manifest, self.where
        return digest

    def release(self, digest: str) -> None:
        """Let go of a parcel once; after the last time, workers cannot fetch it any more."""
        if digest not in self._counts:
            return
        is_tracer = "structure" in SENT[digest][0].header
        self._counts[digest] -= 1
        if not self._counts[digest]:
            del self._counts[digest]
            manifest = SENT.pop(digest)[0]
            kept = {place.digest for n in self._counts for place in SENT[n][0].arrays.values()}
            for place in manifest.arrays.values():
                if place.digest not in kept:
                    self._folder.remove(place.digest)
        if self._client.status == "running":
            self._ask("release", digest=digest)
            if is_tracer and digest not in self._counts:
                with contextlib.suppress(OSError):  # a worker that is leaving
                    self._client.run(forget, digest, on_error="ignore")

    def _put(self, digest: str, array: NDArray[Any]) -> None:
        content = _bytes_of(array)
        for begin in range(0, len(content), BLOCK_BYTES):
            part = content[begin : begin + BLOCK_BYTES].tobytes()
            self._ask("put", digest=digest, size=len(content), begin=begin, content=part)

    def _ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        client = self._client
        if do in ("offer", "put", "release"):
            arguments["client"] = client.id
        try:
            operation = getattr(client.scheduler, DEPOT)
            answer: dict[str, Any] = client.sync(operation, do=do, **arguments)
        except (OSError, ValueError) as error:  # ValueError: a client that was closed
            raise ClusterError(f"the cluster's scheduler does not answer: {error}") from error
        return answer


def _bytes_of(array: NDArray[Any]) -> NDArray[np.uint8]:
    import numpy as np

    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)


_posts: WeakKeyDictionary[Client, Post] = WeakKeyDictionary()


def post_of(client: Client) -> Post:
    """The one of a client."""
    post = _posts.get(client)
    if post is None:
        post = _posts[client] = Post(client)
    return post
