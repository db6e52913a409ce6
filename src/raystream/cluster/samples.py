"""Samples: pictures in pieces, on a worker that takes some rows of one sample at a time."""

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
from raystream.cluster.fetching import Kept, tracer_of
from raystream.cluster.shares import own_share
from raystream.cluster.tasks import OrderedTasks
from raystream.core.errors import RaystreamWarning
from raystream.jit.threads import Progress
from raystream.rendering.picture import RENDERERS
from raystream.rendering.progressive import Sampled, trace_sample
from raystream.rendering.sampled import Setting, make_setting
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.seen import SeenSurfaces
from raystream.scene.camera import Camera

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Samples", "picture_text", "trace_rows"]

#: Pixels of a task at most: some megabytes of light, and less than some seconds of work.
TASK_PIXELS = 1 << 19

#: Tasks for each thread of the workers, under way or done: while one is handed out and its worker
#: asks for the next, others go on.
TASKS_PER_THREAD = 3

#: Tasks for each thread of which a picture of few samples is made, so that they end together.
SHARES = 4

#: Settings that a process keeps.
_settings = Kept(2)

Piece = tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]


def picture_text(
    mode: str,
    size: tuple[int, int],
    camera: Camera,
    sampler: tuple[str, int, int],
    options: Mapping[str, Any],
    layers: Sequence[str],
    lights: str,
) -> str:
    """All that a picture depends on beside its scene, as JSON.

    Parameters
    ----------
    mode, size, camera, options, layers, lights
        See `raystream.render`.
    sampler : (str, int, int)
        Its name, the seed, and how many samples.
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


def trace_rows(digest: str, picture: str, sample: int, first: int, end: int) -> Piece:
    """Take one sample of the pixels of some rows; on a worker.

    Parameters
    ----------
    digest : str
        A tracer's parcel, with its scene.
    picture : str
        See `picture_text`.
    sample : int
    first, end : int
        Rows.

    Returns
    -------
    light : ndarray of shape (R * W, 3), float32
    seen : tuple of ndarray, or None
        As `SeenSurfaces`.
    """
    with own_share():
        setting = _settings.get((digest, picture), lambda: _setting(digest, picture))
        renderer = RENDERERS[json.loads(picture)["mode"]]
        light, seen = trace_sample(renderer, setting, sample, rows=range(first, end))
    return light, None if seen is None else tuple(seen)


def _setting(digest: str, picture: str) -> Setting:
    asked = json.loads(picture)
    renderer = RENDERERS[asked["mode"]]
    width, height = asked["size"]
    with warnings.catch_warnings():  # the client has said so
        warnings.simplefilter("ignore", RaystreamWarning)
        return make_setting(
            tracer_of(digest),
            Camera(**asked["camera"]),
            (width, height),
            Sampler.of(*asked["sampler"]),
            renderer.check(asked["options"]),
            asked["layers"],
            asked["lights"],
        )


class Samples:
    """Whole samples of a picture, one after another, put together from workers' rows.

    Parameters
    ----------
    client : distributed.Client
    digest, picture : str
        See `trace_rows`.
    setting : Setting
        For the size and the layers.
    sample_count : int
        Of each pixel, at most.
    """

    def __init__(
        self, client: Client, digest: str, picture: str, setting: Setting, sample_count: int
    ) -> None:
        self._client = client
        self._of = digest, picture
        self._width, self._height = setting.width, setting.height
        self._has_layers = bool(setting.layers)
        self._sample_count = sample_count
        self._tasks: OrderedTasks | None = None
        self._bands: list[range] = []
        self._next = 0

    def take(self, sample: int, progress: Progress | None) -> Sampled:
        """The next sample of every pixel; see `render_samples`."""
        if self._tasks is None:
            self._begin(sample)
        assert self._tasks is not None
        assert sample == self._next, "samples are taken in order"
        self._next += 1
        count = self._width * self._height
        light = np.empty((count, 3), np.float32)
        seen = SeenSurfaces.empty(count) if self._has_layers else None
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
        """Cancel what nobody will ask for."""
        if self._tasks is not None:
            self._tasks.close()

    def _begin(self, first: int) -> None:
        threads = thread_total(self._client)
        left = self._sample_count - first
        pixel_count = self._width * self._height
        count = max(math.ceil(pixel_count / TASK_PIXELS), math.ceil(SHARES * threads / left))
        count = min(count, self._height)
        ends = [self._height * i // count for i in range(count + 1)]
        self._bands = [range(a, b) for a, b in itertools.pairwise(ends)]
        self._next = first
        self._tasks = OrderedTasks(
            self._client,
            trace_rows,
            self._calls(first),
            TASKS_PER_THREAD * threads,
            "rows",
        )

    def _calls(self, first: int) -> Iterator[tuple[Any, ...]]:
        for sample in range(first, self._sample_count):
            for band in self._bands:
                yield (*self._of, sample, band.start, band.stop)
