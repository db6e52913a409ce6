"""The tracers of a scene: built in the background, and cached."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from raystream.rendering.color import encode_srgb
from raystream.rendering.contexts import make_context, seen_by
from raystream.rendering.film import Film
from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.scene.scene import Scene
from raystream.tracer import Tracer
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, finite_or_none
from raystream.viewer.settings import Settings, TracerKey

#: Limits of the cache per scene: tracers, and bytes of their structures; evicts the least recently
#: used, but keeps at least one.
_MAX_TRACERS = 8
_MAX_BYTES = 2 << 30

#: Size of the warm-up image, which triggers compilation. A BVH uses some rows of a large image
#: instead: few or distant rays would compile other kernels than frames need.
_WARMUP_SIZE = 16
_BVH_WARMUP_SIZE, _BVH_WARMUP_ROWS = (1024, 768), range(383, 386)


class PreparedTracer(NamedTuple):
    """A tracer with the shading tables of its scene.

    Attributes
    ----------
    key : TracerKey
    tracer : Tracer
    context : RenderContext
        Without a mode, and with some camera.
    """

    key: TracerKey
    tracer: Tracer
    context: RenderContext

    def message(self) -> Message:
        """Describe its structure."""
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
    """A listener for the completion of a tracer, called from other threads."""

    def on_progress(self, what: str, done: float) -> None:
        """Report progress."""

    def on_ready(self, prepared: PreparedTracer) -> None:
        """Receive the tracer."""

    def on_failure(self, reason: str) -> None:
        """Receive the reason of a failure."""


class _Build(NamedTuple):
    job: Job
    waiters: list[Waiter]


class TracerCache:
    """A cache of the tracers of one scene.

    Parameters
    ----------
    scene : Scene
    jobs : Jobs
        Runs the builds.
    tracer : Tracer, optional
        An existing tracer of the scene.
    key : TracerKey, optional
        Its key.
    """

    def __init__(
        self, scene: Scene, jobs: Jobs, tracer: Tracer | None = None, key: TracerKey | None = None
    ) -> None:
        self._scene, self._jobs = scene, jobs
        self._lock = threading.Lock()
        self._tables = threading.Lock()
        self._context: RenderContext | None = None
        self._tracers: OrderedDict[TracerKey, Tracer] = OrderedDict()
        self._ready: dict[tuple[TracerKey, str], PreparedTracer] = {}
        self._builds: dict[tuple[TracerKey, str], _Build] = {}
        self._figures: dict[TracerKey, Message] = {}
        if tracer is not None and key is not None:
            self._tracers[key] = tracer

    def ready(self, settings: Settings) -> PreparedTracer | None:
        """Return the tracer for these settings if it is built and compiled; else None."""
        cache_key = _cache_key(settings)
        with self._lock:
            prepared = self._ready.get(cache_key)
            if prepared is not None and cache_key[0] in self._tracers:
                self._tracers.move_to_end(cache_key[0])
            return prepared

    def request(self, settings: Settings, waiter: Waiter) -> None:
        """Build the tracer for these settings in the background; then notify the waiter."""
        cache_key = _cache_key(settings)
        with self._lock:
            build = self._builds.get(cache_key)
            if build is not None and build.job.is_wanted:
                build.waiters.append(waiter)
                return
            waiters = [waiter]
            job = Job(lambda what, done: self._notify(waiters, lambda w: w.on_progress(what, done)))
            self._builds[cache_key] = _Build(job, waiters)

        def work(job: Job) -> None:
            prepared = self._prepare(settings, job)
            self._end(cache_key, job)
            self._notify(waiters, lambda w: w.on_ready(prepared))

        def failed(reason: str) -> None:
            self._end(cache_key, job)
            self._notify(waiters, lambda w: w.on_failure(reason))

        self._jobs.start(job, work, failed)

    def forget(self, waiter: Waiter) -> None:
        """Stop notifying a waiter; builds without waiters are cancelled."""
        with self._lock:
            for cache_key, build in list(self._builds.items()):
                if waiter in build.waiters:
                    build.waiters.remove(waiter)
                    if not build.waiters:
                        build.job.cancel()
                        del self._builds[cache_key]

    def describe(self, prepared: PreparedTracer, send: Callable[[Message], object]) -> None:
        """Send figures about a structure; expensive ones are computed in the background."""
        with self._lock:
            found = self._figures.get(prepared.key)
        if found is not None:
            send(found)
            return

        def work(_: Job) -> None:
            message = prepared.message()
            with self._lock:
                self._figures[prepared.key] = message
            send(message)

        self._jobs.start(Job(lambda *_: None), work, lambda _: None)

    def _notify(self, waiters: list[Waiter], call: Callable[[Waiter], None]) -> None:
        with self._lock:
            present = list(waiters)
        for waiter in present:
            call(waiter)

    def _end(self, cache_key: tuple[TracerKey, str], job: Job) -> None:
        with self._lock:
            build = self._builds.get(cache_key)
            if build is not None and build.job is job:
                del self._builds[cache_key]

    def _prepare(self, settings: Settings, job: Job) -> PreparedTracer:
        key, warmup = _cache_key(settings)
        with self._lock:
            tracer = self._tracers.get(key)
        with device_lock(key.device):
            if tracer is None:
                progress = job.begin(f"building {key.structure}")
                tracer = Tracer(self._scene, progress=progress, **key.options)
            job.begin("preparing the scene")
            context = self._context_for(tracer)
            job.begin(f"preparing {warmup}")
            _warm_up(settings, context)
        prepared = PreparedTracer(key, tracer, context)
        with self._lock:
            if not job.is_wanted:
                return prepared
            self._tracers[key] = tracer
            self._tracers.move_to_end(key)
            self._ready[key, warmup] = prepared
            self._drop_oldest()
        return prepared

    def _context_for(self, tracer: Tracer) -> RenderContext:
        """Return the scene's tables, shared by all tracers: making them can be expensive."""
        with self._tables:
            if self._context is None:
                camera, size = self._scene.camera, (_WARMUP_SIZE, _WARMUP_SIZE)
                self._context = make_context(tracer, camera, size, Sampler.of("sobol"), {})
            elif self._context.tracer is not tracer:
                context = replace(self._context, tracer=tracer)
                self._context = seen_by(context, context.camera)
            return self._context

    def _drop_oldest(self) -> None:
        def is_too_much() -> bool:
            sizes = [tracer.structure.report.byte_count for tracer in self._tracers.values()]
            return len(sizes) > _MAX_TRACERS or sum(sizes) > _MAX_BYTES

        while len(self._tracers) > 1 and is_too_much():
            oldest, _ = self._tracers.popitem(last=False)
            for cache_key in [cache_key for cache_key in self._ready if cache_key[0] == oldest]:
                del self._ready[cache_key]


def _cache_key(settings: Settings) -> tuple[TracerKey, str]:
    """Identify the tracer, and the rendering to compile for."""
    warmup = settings.mode if settings.heatmap is None else "heat map"
    return settings.tracer_key, warmup


def _warm_up(settings: Settings, context: RenderContext) -> None:
    """Render a small image, so that kernels are compiled before the first frame."""
    if settings.heatmap is not None:
        origins, directions = context.camera.rays(_WARMUP_SIZE, _WARMUP_SIZE)
        context.tracer.first_hit(origins, directions)
        return
    chosen = replace(context, options=settings.mode_options)
    size, rows = (_WARMUP_SIZE, _WARMUP_SIZE), range(_WARMUP_SIZE)
    if context.tracer.structure.name == "bvh":
        size, rows = _BVH_WARMUP_SIZE, _BVH_WARMUP_ROWS
    chosen = seen_by(chosen, context.camera, size)
    light = RENDERERS[settings.mode].trace(chosen, rows, 0)
    Film(size[0], len(rows)).add_samples(0, light)
    encode_srgb(light)


_LOCKS: dict[str, threading.Lock] = {"graphics": threading.Lock(), "cuda": threading.Lock()}


def device_is_free(device: str) -> bool:
    """Whether `device_lock` is free."""
    return device not in _LOCKS or not _LOCKS[device].locked()


def device_lock(device: str) -> AbstractContextManager[Any]:
    """Return the lock of a device that only one thread may use at a time."""
    return _LOCKS.get(device, nullcontext())
