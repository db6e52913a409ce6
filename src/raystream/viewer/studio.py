"""Studio: a scene, those who look at it, and the threads that render for them."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.catalogue import devices_message, hello
from raystream.viewer.jobs import Job
from raystream.viewer.messages import Message, Send
from raystream.viewer.scenes import Staged
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import Tracers
from raystream.viewer.turns import Turns
from raystream.viewer.visitor import Crew, Visitor

__all__ = ["Studio"]

#: What a slice of work may take: alone, and while others wait for their turn.
_ALONE, _AMONG_OTHERS = 0.1, 0.04

#: The worker looks again after so long, for cameras that have come to rest.
_LOOK_SECONDS = 0.1


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
    One thread renders for all visitors in turn, on all cores; another encodes what is done;
    structures are built beside them, on threads of their own.
    """

    def __init__(
        self, scene: Scene | Tracer, name: str, *, settings: Mapping[str, Any] | None = None
    ) -> None:
        if not isinstance(scene, Scene | Tracer):
            raise TypeError(f"scene: expected a Scene or a Tracer, got {type(scene).__name__}")
        tracer = scene if isinstance(scene, Tracer) else None
        self._settings = _settings_of(tracer, settings or {})
        shown = scene.scene if isinstance(scene, Tracer) else scene
        self._crew = Crew(self._wake)
        key = None if tracer is None else _settings_of(tracer, {}).tracer_key
        tracers = Tracers(shown, self._crew.builds, tracer, key)
        self._home = Staged(shown, name, False, tracers)
        self._turns: Turns[Visitor] = Turns()
        self._changed = threading.Condition()
        self._visitors: list[Visitor] = []
        self._left: list[Visitor] = []
        self._is_closed = False
        self._is_woken = False
        self._devices: Message | None = None
        self._thread = threading.Thread(target=self._work, name="raystream viewer", daemon=True)
        self._thread.start()
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
        visitor = Visitor(self._crew, send, self._home, self._settings, self._drop)
        visitor.tell(hello())
        visitor.begin()
        with self._changed:
            is_closed = self._is_closed
            self._visitors.append(visitor)
            devices = self._devices
        if is_closed:
            visitor.leave()
            raise RuntimeError("the studio is closed")
        if visitor.has_left:  # it could not even be told that
            self._drop(visitor)
        elif devices is not None:
            visitor.tell(devices)
        self._wake()
        return visitor

    def close(self) -> None:
        """Send everybody away, and end the threads."""
        with self._changed:
            if self._is_closed:
                return
            self._is_closed = True
            visitors = list(self._visitors)
            self._changed.notify_all()
        for visitor in visitors:
            visitor.tell({"type": "closing", "reason": "the viewer was closed"})
            visitor.leave()
        self._thread.join(10.0)
        self._crew.close()

    def _wake(self) -> None:
        """Let the worker look for work."""
        with self._changed:
            self._is_woken = True
            self._changed.notify_all()

    def _drop(self, visitor: Visitor) -> None:
        """Forget a visitor who has left."""
        with self._changed:
            if visitor in self._visitors:
                self._visitors.remove(visitor)
            self._left.append(visitor)
            self._changed.notify_all()

    def _look_for_devices(self, _: Job) -> None:
        message = devices_message()
        with self._changed:
            self._devices = message
            visitors = list(self._visitors)
        for visitor in visitors:
            visitor.tell(message)

    def _work(self) -> None:
        while True:
            with self._changed:
                if self._is_closed:
                    return
                self._is_woken = False
                visitors, left = list(self._visitors), list(self._left)
                self._left.clear()
            for visitor in left:
                visitor.rest()
                self._turns.forget(visitor)
            ready = [visitor for visitor in visitors if visitor.has_work()]
            if not ready:
                with self._changed:
                    if not self._is_woken and not self._left and not self._is_closed:
                        self._changed.wait(_LOOK_SECONDS if visitors else None)
                continue
            self._take_turn(ready)

    def _take_turn(self, ready: list[Visitor]) -> None:
        visitor = self._turns.choose(ready)
        started = time.perf_counter()
        visitor.step(_ALONE if len(ready) == 1 else _AMONG_OTHERS)
        self._turns.charge(visitor, time.perf_counter() - started)


def _settings_of(tracer: Tracer | None, given: Mapping[str, Any]) -> Settings:
    """The settings that a tracer has, and those that are given."""
    usual: dict[str, Any] = {}
    if tracer is not None:
        usual = {"structure": tracer.structure.name, "device": tracer.device}
        usual["machine"] = tracer.machine
        if tracer.structure.name == "kdtree":
            usual["traversal"] = tracer.structure.options["traversal"]
        if tracer.machine == "multipass":
            scheduler = tracer._machine_options.get("scheduler")
            if isinstance(scheduler, str):
                usual["scheduler"] = scheduler
    return Settings().changed(usual).changed(given)
