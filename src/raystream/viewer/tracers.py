"""The tracers of one scene: built in the background, and kept for switching back."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from raystream.rendering.accumulation import Accumulation
from raystream.rendering.color import encode_srgb
from raystream.rendering.picture import RENDERERS
from raystream.rendering.sampled import Setting, make_setting
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, finite_or_none
from raystream.viewer.settings import Settings, TracerKey

__all__ = ["Prepared", "Tracers", "Waiter", "device_is_free", "device_lock"]

#: Tracers that are kept of a scene, and their structures' bytes together; the ones that were
#: used last, and at least one.
_MOST_TRACERS = 8
_MOST_BYTES = 2 << 30

#: Width and height of the picture that is rendered to compile what is not yet. Of a BVH, rows of
#: a large one: few rays, or rays far apart, would compile other kernels than frames take.
_TRIAL = 16
_LARGE, _ROWS = (1024, 768), range(383, 386)


class Prepared(NamedTuple):
    """A tracer, and its scene's tables for shading.

    Attributes
    ----------
    key : TracerKey
    tracer : Tracer
    setting : Setting
        Of no mode yet, and seen by some camera.
    """

    key: TracerKey
    tracer: Tracer
    setting: Setting

    def message(self) -> Message:
        """Figures about its structure."""
        structure, key = self.tracer.structure, self.key
        return {
            "type": "structure",
            "structure": key.structure,
            "traversal": key.traversal,
            "machine": key.machine,
            "device": key.device,
            "seconds": round(structure.report.seconds, 6),
            "bytes": structure.report.byte_count,
            "statistics": {
                name: finite_or_none(value) for name, value in structure.quality().items()
            },
            "ready": True,
        }


class Waiter(Protocol):
    """Who waits for a tracer; it is called from other threads."""

    def on_progress(self, what: str, done: float) -> None:
        """Take note of how far it is."""

    def on_ready(self, prepared: Prepared) -> None:
        """Go on with it."""

    def on_failure(self, reason: str) -> None:
        """Do without."""


class _Build(NamedTuple):
    job: Job
    waiters: list[Waiter]


class Tracers:
    """The tracers of one scene.

    Parameters
    ----------
    scene : Scene
    jobs : Jobs
        Where they are built.
    tracer : Tracer, optional
        One that is there already.
    key : TracerKey, optional
        Its key.
    """

    def __init__(
        self, scene: Scene, jobs: Jobs, tracer: Tracer | None = None, key: TracerKey | None = None
    ) -> None:
        self._scene, self._jobs = scene, jobs
        self._lock = threading.Lock()
        self._tables = threading.Lock()
        self._setting: Setting | None = None
        self._tracers: OrderedDict[TracerKey, Tracer] = OrderedDict()
        self._ready: dict[tuple[TracerKey, str], Prepared] = {}
        self._builds: dict[tuple[TracerKey, str], _Build] = {}
        self._figures: dict[TracerKey, Message] = {}
        if tracer is not None and key is not None:
            self._tracers[key] = tracer

    def ready(self, settings: Settings) -> Prepared | None:
        """What there is for these settings, with all that it needs compiled; else None."""
        wanted = _wanted(settings)
        with self._lock:
            prepared = self._ready.get(wanted)
            if prepared is not None and wanted[0] in self._tracers:
                self._tracers.move_to_end(wanted[0])
            return prepared

    def want(self, settings: Settings, waiter: Waiter) -> None:
        """Prepare what these settings need, beside other work; then tell who waits for it."""
        wanted = _wanted(settings)
        with self._lock:
            build = self._builds.get(wanted)
            if build is not None and build.job.is_wanted:
                build.waiters.append(waiter)
                return
            waiters = [waiter]
            job = Job(lambda what, done: self._tell(waiters, lambda w: w.on_progress(what, done)))
            self._builds[wanted] = _Build(job, waiters)

        def work(job: Job) -> None:
            prepared = self._prepare(settings, job)
            self._end(wanted, job)
            self._tell(waiters, lambda w: w.on_ready(prepared))

        def failed(reason: str) -> None:
            self._end(wanted, job)
            self._tell(waiters, lambda w: w.on_failure(reason))

        self._jobs.start(job, work, failed)

    def forget(self, waiter: Waiter) -> None:
        """Tell it nothing more; what nobody else waits for is broken off."""
        with self._lock:
            for wanted, build in list(self._builds.items()):
                if waiter in build.waiters:
                    build.waiters.remove(waiter)
                    if not build.waiters:
                        build.job.break_off()
                        del self._builds[wanted]

    def describe(self, prepared: Prepared, tell: Callable[[Message], object]) -> None:
        """Tell figures about a structure; some take a while to find, and are then told later."""
        with self._lock:
            found = self._figures.get(prepared.key)
        if found is not None:
            tell(found)
            return

        def work(_: Job) -> None:
            message = prepared.message()
            with self._lock:
                self._figures[prepared.key] = message
            tell(message)

        self._jobs.start(Job(lambda *_: None), work, lambda _: None)

    def _tell(self, waiters: list[Waiter], call: Callable[[Waiter], None]) -> None:
        with self._lock:
            present = list(waiters)
        for waiter in present:
            call(waiter)

    def _end(self, wanted: tuple[TracerKey, str], job: Job) -> None:
        with self._lock:
            build = self._builds.get(wanted)
            if build is not None and build.job is job:
                del self._builds[wanted]

    def _prepare(self, settings: Settings, job: Job) -> Prepared:
        key, trial = _wanted(settings)
        with self._lock:
            tracer = self._tracers.get(key)
        with device_lock(key.device):
            if tracer is None:
                progress = job.begin(f"building {key.structure}")
                tracer = Tracer(self._scene, progress=progress, **key.options)
            job.begin("preparing the scene")
            setting = self._setting_for(tracer)
            job.begin(f"preparing {trial}")
            _try(settings, setting)
        prepared = Prepared(key, tracer, setting)
        with self._lock:
            if not job.is_wanted:
                return prepared
            self._tracers[key] = tracer
            self._tracers.move_to_end(key)
            self._ready[key, trial] = prepared
            self._drop_oldest()
        return prepared

    def _setting_for(self, tracer: Tracer) -> Setting:
        """The scene's tables are made once: they take longer than some structures."""
        with self._tables:
            if self._setting is None:
                camera, size = self._scene.camera, (_TRIAL, _TRIAL)
                self._setting = make_setting(tracer, camera, size, Sampler.of("sobol"), {})
            elif self._setting.tracer is not tracer:
                setting = replace(self._setting, tracer=tracer)
                self._setting = setting.seen_by(setting.camera)
            return self._setting

    def _drop_oldest(self) -> None:
        def is_too_much() -> bool:
            sizes = [tracer.structure.report.byte_count for tracer in self._tracers.values()]
            return len(sizes) > _MOST_TRACERS or sum(sizes) > _MOST_BYTES

        while len(self._tracers) > 1 and is_too_much():
            oldest, _ = self._tracers.popitem(last=False)
            for wanted in [wanted for wanted in self._ready if wanted[0] == oldest]:
                del self._ready[wanted]


def _wanted(settings: Settings) -> tuple[TracerKey, str]:
    """The tracer, and what is to be done with it."""
    trial = settings.mode if settings.heatmap is None else "heat map"
    return settings.tracer_key, trial


def _try(settings: Settings, setting: Setting) -> None:
    """Render a small picture, so that kernels are compiled and nothing waits for that later."""
    if settings.heatmap is not None:
        origins, directions = setting.camera.rays(_TRIAL, _TRIAL)
        setting.tracer.first_hit(origins, directions)
        return
    chosen = replace(setting, options=settings.mode_options)
    size, rows = (_TRIAL, _TRIAL), range(_TRIAL)
    if setting.tracer.structure.name == "bvh":
        size, rows = _LARGE, _ROWS
    chosen = chosen.seen_by(setting.camera, size)
    light = RENDERERS[settings.mode].trace(chosen, rows, 0)
    Accumulation(size[0], len(rows)).add_samples(0, light)
    encode_srgb(light)


_LOCKS: dict[str, threading.Lock] = {"graphics": threading.Lock(), "cuda": threading.Lock()}


def device_is_free(device: str) -> bool:
    """Whether `device_lock` can be had at once."""
    return device not in _LOCKS or not _LOCKS[device].locked()


def device_lock(device: str) -> AbstractContextManager[Any]:
    """To be held while a device is used, where only one thread may do so at a time."""
    lock: AbstractContextManager[Any] = _LOCKS.get(device, nullcontext())
    return lock
