"""Samples: images in tasks, each one sample of some rows or tiles."""

from __future__ import annotations

import itertools
import json
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
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
from raystream.rendering.adaptive import Tiles, Unit
from raystream.rendering.integrator import RenderContext, make_context
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import Sampled, trace_sample, trace_tiles
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.aovs import AovBuffers
from raystream.rendering.view_light import lit
from raystream.scene.camera import Camera

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Samples", "image_spec", "trace_part"]

#: Maximum pixels per task: some megabytes of light, and a few seconds of work at most.
TASK_PIXELS = 1 << 19

#: Tasks in flight per worker thread, running or done: while one result is returned and its worker
#: requests the next task, others continue.
TASKS_PER_THREAD = 3

#: Tasks per thread that an image with few samples is split into, for load balance.
MIN_TASKS_PER_THREAD = 4

#: Cached contexts per process.
_contexts = OnceCache(2)

PartSamples = tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]

#: Rows, or tiles.
Part = range | NDArray[np.int64]


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
    mode, size, camera, options, layers, lights
        See `raystream.render`.
    sampler : (str, int, int)
        Its name, the seed, and the number of samples.
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


def trace_part(digest: str, image_spec: str, samples: NDArray[np.int64], part: Part) -> PartSamples:
    """Trace one sample of the pixels of some rows or tiles, on a worker.

    Parameters
    ----------
    digest : str
        Bundle of a tracer with its scene.
    image_spec : str
        See `image_spec`.
    samples : ndarray of int64
        Its number in the rows, or in each of the tiles.
    part : range or ndarray of int64
        Rows, or tiles.

    Returns
    -------
    light : ndarray of shape (P, 3), float32
    seen : tuple of ndarray, or None
        As `AovBuffers`.
    """
    with shared_threads():
        context = _contexts.get((digest, image_spec), lambda: _context(digest, image_spec))
        renderer = RENDERERS[json.loads(image_spec)["mode"]]
        if isinstance(part, range):
            light, seen = trace_sample(renderer, context, int(samples[0]), rows=part)
        else:
            ((light, seen),) = trace_tiles(renderer, context, [Unit(samples, part)])
    return light, None if seen is None else tuple(seen)


def _context(digest: str, image_spec: str) -> RenderContext:
    asked = json.loads(image_spec)
    renderer = RENDERERS[asked["mode"]]
    width, height = asked["size"]
    with warnings.catch_warnings():  # the client has already warned
        warnings.simplefilter("ignore", RaystreamWarning)
        context = make_context(
            tracer_of(digest),
            Camera(**asked["camera"]),
            (width, height),
            Sampler.of(*asked["sampler"]),
            renderer.check(asked["options"]),
            asked["layers"],
            asked["lights"],
        )
        return lit(renderer, context)  # the same on all workers


class Samples:
    """Samples of an image in order, assembled from the parts that workers trace.

    A `SampleSource` of `render_samples`.

    Parameters
    ----------
    client : distributed.Client
    digest, image_spec : str
        See `trace_part`.
    context : RenderContext
        Determines the size and the layers.
    is_uniform : bool
        See `SampleSource`.
    """

    def __init__(
        self,
        client: Client,
        digest: str,
        image_spec: str,
        context: RenderContext,
        is_uniform: bool,
    ) -> None:
        self.is_uniform = is_uniform
        self._client = client
        self._of = digest, image_spec
        self._width, self._height = context.width, context.height
        self._tiles = Tiles(context.width, context.height)
        self._has_layers = bool(context.layers)
        self._units: Iterator[Unit] = iter(())
        self._tasks: OrderedTasks | None = None
        self._parts_per_pixel = 0.0

    def begin(self, units: Iterable[Unit], path_count: int) -> None:
        """Trace units next, in their order; see `SampleSource`."""
        self.close()
        threads = thread_total(self._client)
        least = MIN_TASKS_PER_THREAD * threads / path_count
        self._parts_per_pixel = max(1 / TASK_PIXELS, least)
        self._units, announced = itertools.tee(units)
        self._tasks = OrderedTasks(
            self._client,
            trace_part,
            ((*self._of, *part) for unit in announced for part in self._parts(unit)),
            TASKS_PER_THREAD * threads,
            "samples",
        )

    def take(self, progress: Progress | None) -> Sampled:
        """Return the next unit; see `SampleSource`."""
        assert self._tasks is not None, "begin comes first"
        unit = next(self._units)
        count = self._pixels_of(unit)
        light = np.empty((count, 3), np.float32)
        seen = AovBuffers.empty(count) if self._has_layers else None
        first = 0
        for _ in self._parts(unit):
            own, own_seen = next(self._tasks)
            end = first + len(own)
            light[first:end] = own
            if seen is not None and own_seen is not None:
                for to, values in zip(seen.part(first, end), own_seen, strict=True):
                    to[:] = values
            first = end
            if progress is not None:
                progress(end, count)
        return light, seen

    def close(self) -> None:
        """Cancel outstanding tasks."""
        if self._tasks is not None:
            self._tasks.close()

    def _pixels_of(self, unit: Unit) -> int:
        return self._tiles.size_of(unit) if len(unit.tiles) else self._width * self._height

    def _parts(self, unit: Unit) -> list[tuple[NDArray[np.int64], Part]]:
        """A unit's samples with its rows or tiles, in parts for one task each."""
        count = math.ceil(self._pixels_of(unit) * self._parts_per_pixel)
        length = len(unit.tiles) or self._height
        count = min(count, length)
        ends = [length * i // count for i in range(count + 1)]
        if len(unit.tiles):
            return [(unit.samples[a:b], unit.tiles[a:b]) for a, b in itertools.pairwise(ends)]
        return [(unit.samples, range(a, b)) for a, b in itertools.pairwise(ends)]
