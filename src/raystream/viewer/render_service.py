"""RenderService: a scene, its clients, and the threads that render for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.capabilities import devices_message, hello
from raystream.viewer.client import Client, WorkerPools
from raystream.viewer.jobs import Job
from raystream.viewer.messages import Message, Send
from raystream.viewer.scenes import LoadedScene
from raystream.viewer.settings import Settings, traversals_of
from raystream.viewer.tracers import TracerCache
from raystream.viewer.worker import Worker


class RenderService:
    """Renders a scene for any number of clients.

    Parameters
    ----------
    scene : Scene or Tracer
        The scene shared by all clients. Passing a tracer avoids rebuilding its structure.
    name : str
        Name of the scene.
    settings : mapping, optional
        Initial settings of clients, as in their ``"settings"`` messages.

    Raises
    ------
    ValueError
        If a setting is invalid.
    TypeError
        If `scene` is neither a scene nor a tracer.

    Notes
    -----
    Clients are rendered for in turn, on all cores, in time slices; a separate thread encodes
    frames, and structures are built on other threads in the background.
    """

    def __init__(
        self, scene: Scene | Tracer, name: str, *, settings: Mapping[str, Any] | None = None
    ) -> None:
        if not isinstance(scene, Scene | Tracer):
            raise TypeError(f"scene: expected a Scene or a Tracer, got {type(scene).__name__}")
        tracer = scene if isinstance(scene, Tracer) else None
        self._settings = _settings_of(tracer, settings or {})
        shown = scene.scene if isinstance(scene, Tracer) else scene
        self._worker = Worker()
        self._pools = WorkerPools(self._worker.wake)
        key = None if tracer is None else _settings_of(tracer, {}).tracer_key
        tracers = TracerCache(shown, self._pools.long_jobs, tracer, key)
        self._home = LoadedScene(shown, name, False, tracers)
        self._devices: Message | None = None
        self._pools.short_jobs.start(Job(lambda *_: None), self._find_devices, lambda _: None)

    def join(self, send: Send) -> Client:
        """Add a client.

        Parameters
        ----------
        send : callable
            Receives messages and frames on the service's threads, and must return at once. It
            receives ``"hello"``, ``"scene"`` and ``"settings"`` before this method returns.

        Returns
        -------
        Client

        Raises
        ------
        RuntimeError
            If the service is closed.
        """
        client = Client(self._pools, send, self._home, self._settings, self._worker.drop)
        client.send(hello())
        client.begin()
        if not self._worker.add(client):
            client.leave()
            raise RuntimeError("the render service is closed")
        if client.has_left:  # the first message failed
            self._worker.drop(client)
        elif self._devices is not None:
            client.send(self._devices)
        self._worker.wake()
        return client

    def close(self) -> None:
        """Disconnect all clients, and stop the threads."""
        for client in self._clients():
            client.send({"type": "closing", "reason": "the viewer was closed"})
            client.leave()
        self._worker.close()
        for client in self._clients():  # clients that joined meanwhile
            client.leave()
        self._pools.close()

    def _clients(self) -> list[Client]:
        return [one for one in self._worker.tasks if isinstance(one, Client)]

    def _find_devices(self, _: Job) -> None:
        self._devices = devices_message()
        for client in self._clients():
            client.send(self._devices)


def _settings_of(tracer: Tracer | None, given: Mapping[str, Any]) -> Settings:
    """Combine a tracer's settings with those that are given."""
    defaults: dict[str, Any] = {}
    if tracer is not None:
        defaults = {"structure": tracer.structure.name, "device": tracer.device}
        defaults["machine"] = tracer.machine
        if traversals_of(tracer.structure.name):
            defaults["traversal"] = tracer.structure.options.as_json()["traversal"]
        if tracer.machine == "multipass":
            scheduler = tracer._machine_options.get("scheduler")
            if isinstance(scheduler, str):
                defaults["scheduler"] = scheduler
    return Settings().changed(defaults).changed(given)
