"""Samples: images in tasks, each one sample of some rows."""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.clients import thread_total
from raystream.cluster.fetch import OnceCache, tracer_of
from raystream.cluster.tasks import OrderedTasks
from raystream.cluster.thread_budget import shared_threads
from raystream.core.errors import RaystreamWarning
from raystream.jit.threads import Progress
from raystream.rendering.contexts import make_context
from raystream.rendering.integrator import RenderContext
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import Sampled, trace_sample
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.aovs import AovBuffers
from raystream.scene.camera import Camera

if TYPE_CHECKING:
    from distributed import Client

#: Maximum pixels per task: some megabytes of light, and a few seconds of work at most.
TASK_PIXELS = 1 << 19

#: Tasks in flight per worker thread, running or done: while one result is returned and its worker
#: requests the next task, others continue.
TASKS_PER_THREAD = 3

#: Tasks per thread that an image with few samples is split into, for load balance.
MIN_TASKS_PER_THREAD = 4

#: Cached contexts per process.
_contexts = OnceCache(2)

RowSamples = tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]


def image_spec(
    mode: str,
    size: tuple[int, int],
    camera: Camera,
    sampler: tuple[str, int, int],
    options: Mapping[str, Any],
    layers: Sequence[str],
    lights: str,
) -> str:
    """Serialize everything that an image depends on beside its scene, as JSON.

    Parameters
    ----------
    mode, size, camera, options, layers
        See `raystream.render`.
    sampler : (str, int, int)
        Its name, the seed, and the number of samples.
    lights : str
        The choice of `view_light.decide`.
    """
    return json.dumps(
        {
            "mode": mode,
            "size": size,
            "camera": asdict(camera),
            "sampler": sampler,
            "options": dict(options),
            "layers": list(layers),
            "lights": lights,
        },
        sort_keys=True,
        default=float,
    )


def trace_rows(digest: str, image_spec: str, sample: int, first: int, end: int) -> RowSamples:
    """Trace one sample of the pixels of some rows, on a worker.

    Parameters
    ----------
    digest : str
        Bundle of a tracer with its scene.
    image_spec : str
        See `image_spec`.
    sample : int
        Its number.
    first, end : int
        Rows.

    Returns
    -------
    light : ndarray of shape (R * W, 3), float32
    seen : tuple of ndarray, or None
        As `AovBuffers`.
    """
    with shared_threads():
        context = _contexts.get((digest, image_spec), lambda: _context(digest, image_spec))
        renderer = RENDERERS[json.loads(image_spec)["mode"]]
        light, seen = trace_sample(renderer, context, sample, rows=range(first, end))
    return light, None if seen is None else tuple(seen)


def _context(digest: str, image_spec: str) -> RenderContext:
    asked = json.loads(image_spec)
    renderer = RENDERERS[asked["mode"]]
    width, height = asked["size"]
    with warnings.catch_warnings():  # the client has already warned
        warnings.simplefilter("ignore", RaystreamWarning)
        return make_context(
            tracer_of(digest),
            Camera(**asked["camera"]),
            (width, height),
            Sampler.of(*asked["sampler"]),
            renderer.check(asked["options"]),
            asked["layers"],
            asked["lights"],
        )


class Samples:
    """Samples of an image in order, assembled from the rows that workers trace.

    A `SampleSource` of `render_samples`.

    Parameters
    ----------
    client : distributed.Client
    digest, image_spec : str
        See `trace_rows`.
    context : RenderContext
        Determines the size and the layers.
    sample_count : int
        Samples per pixel, at most.
    """

    def __init__(
        self,
        client: Client,
        digest: str,
        image_spec: str,
        context: RenderContext,
        sample_count: int,
    ) -> None:
        self._client = client
        self._of = digest, image_spec
        self._width, self._height = context.width, context.height
        self._has_layers = bool(context.layers)
        self._sample_count = sample_count
        self._tasks: OrderedTasks | None = None
        self._bands: list[range] = []

    def take(self, sample: int, progress: Progress | None) -> Sampled:
        """Return the next sample of the image; see `SampleSource`."""
        if self._tasks is None:
            self._tasks = self._begin(sample)
        count = self._width * self._height
        light = np.empty((count, 3), np.float32)
        seen = AovBuffers.empty(count) if self._has_layers else None
        for band in self._bands:
            own, own_seen = next(self._tasks)
            first, end = band.start * self._width, band.stop * self._width
            light[first:end] = own
            if seen is not None and own_seen is not None:
                for to, values in zip(seen.part(first, end), own_seen, strict=True):
                    to[:] = values
            if progress is not None:
                progress(end, count)
        return light, seen

    def close(self) -> None:
        """Cancel outstanding tasks."""
        if self._tasks is not None:
            self._tasks.close()

    def _begin(self, first: int) -> OrderedTasks:
        """Divide the image into bands, and trace samples from the first one on."""
        threads = thread_total(self._client)
        left = self._sample_count - first
        count = max(
            math.ceil(self._width * self._height / TASK_PIXELS),
            math.ceil(MIN_TASKS_PER_THREAD * threads / left),
        )
        count = min(count, self._height)
        ends = [self._height * i // count for i in range(count + 1)]
        self._bands = [range(a, b) for a, b in itertools.pairwise(ends)]
        window = TASKS_PER_THREAD * threads
        return OrderedTasks(self._client, trace_rows, self._calls(first), window, "samples")

    def _calls(self, first: int) -> Iterator[tuple[Any, ...]]:
        for sample in range(first, self._sample_count):
            for band in self._bands:
                yield (*self._of, sample, band.start, band.stop)
