"""Studio: a scene, those who look at it, and the threads that render for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.catalogue import devices_message, hello
from raystream.viewer.jobs import Job
from raystream.viewer.messages import Message, Send
from raystream.viewer.scenes import Staged
from raystream.viewer.settings import Settings, traversals_of
from raystream.viewer.tracers import Tracers
from raystream.viewer.visitor import Crew, Visitor
from raystream.viewer.worker import Worker

__all__ = ["Studio"]


class Studio:
    """A scene that visitors look at.

    Parameters
    ----------
    scene : Scene or Tracer
        What everybody sees at first. A tracer saves building its structure.
    name : str
        What to call it.
    settings : mapping, optional
        Where visitors begin: as in their ``"settings"`` messages.

    Raises
    ------
    ValueError
        If a setting is none.
    TypeError
        If `scene` is neither a scene nor a tracer.

    Notes
    -----
    Visitors are rendered for in turn, on all cores, in slices of bounded time; a thread encodes
    what is done; structures are built beside them, on threads of their own.
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
        self._crew = Crew(self._worker.wake)
        key = None if tracer is None else _settings_of(tracer, {}).tracer_key
        tracers = Tracers(shown, self._crew.builds, tracer, key)
        self._home = Staged(shown, name, False, tracers)
        self._devices: Message | None = None
        self._crew.asides.start(Job(lambda *_: None), self._look_for_devices, lambda _: None)

    def join(self, send: Send) -> Visitor:
        """Let a visitor in.

        Parameters
        ----------
        send : callable
            Gets messages and frames, from the studio's threads, and must return at once. It is
            told ``"hello"``, ``"scene"`` and ``"settings"`` before this returns.

        Returns
        -------
        Visitor

        Raises
        ------
        RuntimeError
            If the studio is closed.
        """
        visitor = Visitor(self._crew, send, self._home, self._settings, self._worker.drop)
        visitor.tell(hello())
        visitor.begin()
        if not self._worker.add(visitor):
            visitor.leave()
            raise RuntimeError("the studio is closed")
        if visitor.has_left:  # it could not even be told that
            self._worker.drop(visitor)
        elif self._devices is not None:
            visitor.tell(self._devices)
        self._worker.wake()
        return visitor

    def close(self) -> None:
        """Send everybody away, and end the threads."""
        for visitor in self._visitors():
            visitor.tell({"type": "closing", "reason": "the viewer was closed"})
            visitor.leave()
        self._worker.close()
        for visitor in self._visitors():  # who came meanwhile
            visitor.leave()
        self._crew.close()

    def _visitors(self) -> list[Visitor]:
        return [one for one in self._worker.customers if isinstance(one, Visitor)]

    def _look_for_devices(self, _: Job) -> None:
        self._devices = devices_message()
        for visitor in self._visitors():
            visitor.tell(self._devices)


def _settings_of(tracer: Tracer | None, given: Mapping[str, Any]) -> Settings:
    """The settings that a tracer has, and those that are given."""
    usual: dict[str, Any] = {}
    if tracer is not None:
        usual = {"structure": tracer.structure.name, "device": tracer.device}
        usual["machine"] = tracer.machine
        if traversals_of(tracer.structure.name):
            usual["traversal"] = tracer.structure.options.as_json()["traversal"]
        if tracer.machine == "multipass":
            scheduler = tracer._machine_options.get("scheduler")
            if isinstance(scheduler, str):
                usual["scheduler"] = scheduler
    return Settings().changed(usual).changed(given)
