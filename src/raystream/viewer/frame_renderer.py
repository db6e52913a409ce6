"""FrameRenderer: renders one client's frames, from the first quick preview to the last sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from raystream.rendering.contexts import seen_by
from raystream.rendering.render import RENDERERS
from raystream.scene.camera import Camera
from raystream.viewer.adaptive_resolution import (
    AdaptiveResolution,
    Cost,
    FrameRate,
    update_interval,
)
from raystream.viewer.heatmap_image import HeatmapImage
from raystream.viewer.messages import Message
from raystream.viewer.progressive_images import (
    Drawing,
    ProgressiveImage,
    SampledImage,
    WorkCancelledError,
    centered,
    with_samples,
)
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import PreparedTracer
from raystream.viewer.view_lights import ViewLights

#: A frame of a moving camera within this total or remaining time is finished although the camera
#: has moved on: otherwise no frame would appear until the camera rests.
_MAX_TOTAL, _MAX_REMAINING = 1.0, 0.25

#: A first image expected to take longer than this is preceded by a smaller one; the estimate is
#: trusted after this many seconds.
_PREVIEW_SECONDS, _MIN_EVIDENCE = 0.5, 0.05

#: Maximum number of remembered costs.
_MAX_COSTS = 64

#: Purpose of the image in progress: a frame of a moving camera; a preview before the full size;
#: the full size with one sample; or all samples.
_MOVING, _PREVIEW, _FULL_SIZE, _SAMPLES = range(4)


class FrameRequest(NamedTuple):
    """What a client wants to see.

    Attributes
    ----------
    prepared : PreparedTracer
    settings : Settings
    camera : Camera
    number : int
        Number of the message that set the camera.
    size : (int, int)
        Size of the canvas.
    moving : bool
        Whether the camera is moving.
    """

    prepared: PreparedTracer
    settings: Settings
    camera: Camera
    number: int
    size: tuple[int, int]
    moving: bool

    @property
    def scene_key(self) -> tuple[Any, ...]:
        """Everything that samples depend on, except the camera."""
        plain = replace(self.settings, exposure=1.0, tone="linear", maximum=None)
        return id(self.prepared), plain, self.size

    @property
    def sample_key(self) -> tuple[Any, ...]:
        """Everything that samples depend on."""
        return *self.scene_key, self.camera


class RenderedFrame(NamedTuple):
    """A rendered image to encode and send.

    Attributes
    ----------
    draw : callable
        Returns the pixels.
    header : dict
    """

    draw: Callable[[], Drawing]
    header: Message


class FrameRenderer:
    """Renders a client's requests in time slices, on the worker's thread.

    While the camera moves, renders images of one sample through the pixel centres, as large as
    the frame rate allows. When it rests, renders one full-size image at once, then samples
    distributed over the pixels, until the target is reached.

    Parameters
    ----------
    show : callable
        Receives each finished image, and whether it may be dropped.
    lights : ViewLights
    """

    def __init__(self, show: Callable[[RenderedFrame, bool], object], lights: ViewLights) -> None:
        self._show = show
        self._resolution = AdaptiveResolution()
        self._rate = FrameRate()
        self._costs: dict[Any, Cost] = {}
        self._lights = lights
        self.forget()

    def forget(self) -> None:
        """Discard all state."""
        self._request: FrameRequest | None = None  # of the image in progress, or of the last one
        self._image: ProgressiveImage | None = None
        self._purpose = _FULL_SIZE
        self._shown_key: Any = None  # sample key of the last image shown
        self._full_size: ProgressiveImage | None = None  # best full-size image of this request
        self._sent_key: Any = None  # key of its last header sent
        self._noise: float | None = None
        self._rested_at = self._sent_at = 0.0
        self._awaited_at: float | None = None  # start of the wait for a frame of the moving camera

    def has_work(self, request: FrameRequest) -> bool:
        """Whether anything remains to render or show for a request."""
        last = self._request
        if last is None or last.sample_key != request.sample_key:
            return True
        if request.moving:
            return self._shown_key != request.sample_key
        return not self._is_complete(request) or self._sent_key != _header_key(
            request, self._full_size
        )

    def full_size_image(self, request: FrameRequest) -> ProgressiveImage | None:
        """Return the full-size image of a request, if it has at least one sample."""
        last = self._request
        return (
            self._full_size if last is not None and last.sample_key == request.sample_key else None
        )

    def header(self, image: ProgressiveImage, request: FrameRequest) -> Message:
        """Return the header of an image."""
        target = request.settings.target_samples
        rays = image.width * image.height
        return {
            "type": "frame",
            "camera": request.number,
            "width": image.width,
            "height": image.height,
            "samples": image.samples,
            "target_samples": target,
            "done": not request.moving and image is self._full_size and image.samples >= target,
            "moving": request.moving,
            "render_ms": round(1e3 * image.seconds, 3),
            "fps": self._rate.now(time.perf_counter()),
            "rays": rays,
            "mrays_per_second": round(rays / max(image.seconds, 1e-9) / 1e6, 3),
            "noise": self._noise if image.samples > 1 else None,
            **image.facts(request.settings.display),
        }

    def step(self, request: FrameRequest, seconds: float, is_wanted: Callable[[], bool]) -> None:
        """Render one slice.

        Parameters
        ----------
        request : FrameRequest
        seconds : float
            Time limit of the slice.
        is_wanted : callable
            Polled: whether the current work is still worth finishing; see `is_worth_finishing`.
        """
        request = self._update(request)
        if self._image is None:
            self._begin(request)
        image = self._image
        if image is None:
            return
        try:
            is_whole = image.advance(seconds, is_wanted)
        except WorkCancelledError:
            self._image = None
            return
        if is_whole:
            self._finish(image, request)
        else:
            self._preview_if_slow(image, request)

    def is_worth_finishing(self, request: FrameRequest) -> bool:
        """Whether the image in progress is still worth finishing."""
        made, image = self._request, self._image
        if made is None or image is None:
            return False
        if made.sample_key == request.sample_key:
            return (self._purpose == _MOVING) == request.moving
        if made.scene_key != request.scene_key or not (self._purpose == _MOVING and request.moving):
            return False
        left = image.seconds_left
        return left < _MAX_REMAINING or image.seconds + left < _MAX_TOTAL

    def _update(self, request: FrameRequest) -> FrameRequest:
        """Discard obsolete work; returns the request to work on."""
        last = self._request
        if last is not None and last.sample_key == request.sample_key:
            if self._purpose == _MOVING and not request.moving:
                self._image = None  # go to full size at once
            if last.moving and not request.moving:
                self._rested_at = time.perf_counter()
        else:
            if last is not None and self._image is not None and self.is_worth_finishing(request):
                return last
            now = time.perf_counter()
            self._image = self._full_size = self._noise = None
            self._rested_at = now
            if last is None or last.scene_key != request.scene_key:
                self._resolution = AdaptiveResolution()
                self._shown_key = None
            if self._awaited_at is None:
                self._awaited_at = now
        self._request = request
        return request

    def _begin(self, request: FrameRequest) -> None:
        """Start the next image of a request, or send a new header for the existing one."""
        full_size = self._full_size
        if request.moving:
            if self._shown_key != request.sample_key:
                self._begin_small(request, _MOVING)
        elif full_size is None:
            self._make(request, request.size, _FULL_SIZE)
        elif not self._is_complete(request):
            self._make(request, request.size, _SAMPLES)
        elif self._sent_key != _header_key(request, full_size):
            self._send(full_size, request, may_drop=False)

    def _begin_small(self, request: FrameRequest, purpose: int) -> None:
        cost = self._cost(request, is_small=True)
        known = cost if cost.is_known else self._cost(request, is_small=False)
        self._resolution.apply_cost(*request.size, known)
        self._make(request, self._resolution.size(*request.size), purpose)

    def _preview_if_slow(self, image: ProgressiveImage, request: FrameRequest) -> None:
        """Switch to a smaller image if the current one is slow."""
        if image.seconds < _MIN_EVIDENCE:
            return
        if self._purpose in (_MOVING, _PREVIEW):
            self._resolution.apply_cost(*request.size, self._cost(request, is_small=True))
            width, height = self._resolution.size(*request.size)
            is_large = 2 * width * height < image.width * image.height
            if is_large and image.seconds_left > _MAX_REMAINING:
                self._begin_small(request, self._purpose)
            return
        is_first = self._full_size is None and self._shown_key != request.sample_key
        if is_first and image.seconds_left > _PREVIEW_SECONDS:
            self._begin_small(request, _PREVIEW)

    def _is_complete(self, request: FrameRequest) -> bool:
        full_size = self._full_size
        return full_size is not None and full_size.samples >= request.settings.target_samples

    def _cost(self, request: FrameRequest, *, is_small: bool) -> Cost:
        settings = request.settings
        what = request.prepared.key, settings.mode, settings.max_bounces, is_small
        if len(self._costs) >= _MAX_COSTS:
            self._costs.clear()
        return self._costs.setdefault(what, Cost())

    def _make(self, request: FrameRequest, size: tuple[int, int], purpose: int) -> None:
        """Start an image."""
        settings, cost = (
            request.settings,
            self._cost(request, is_small=purpose in (_MOVING, _PREVIEW)),
        )
        context = replace(request.prepared.context, options=settings.mode_options)
        if settings.heatmap is None:
            context = self._lights.lit(request.prepared, settings.mode, context, request.camera)
        context = seen_by(context, request.camera, size)
        samples = settings.target_samples if purpose == _SAMPLES else 1
        self._purpose = purpose
        if settings.heatmap is not None:
            self._image = HeatmapImage(centered(context), settings.heatmap, cost)
        else:
            context = with_samples(context, samples)
            self._image = SampledImage(RENDERERS[settings.mode], context, cost)

    def _finish(self, image: ProgressiveImage, request: FrameRequest) -> None:
        """Show an image that has completed a sample."""
        now = time.perf_counter()
        is_first = self._shown_key != request.sample_key
        self._shown_key = request.sample_key
        if self._purpose in (_MOVING, _PREVIEW):
            self._image = None
            if self._purpose == _MOVING:
                self._record_frame(image, request, now)
            if (image.width, image.height) == request.size:
                self._full_size = image
            self._send(image, request, may_drop=False)
            return
        self._awaited_at = None
        if image.is_done:
            self._image = None
        if self._full_size is None or image.samples > 1:
            is_first = is_first or self._full_size is None
            self._full_size = image
            is_due = now - self._sent_at >= update_interval(now - self._rested_at)
            if is_first or image.is_done or is_due:
                self._send(image, request, may_drop=not (is_first or image.is_done))

    def _record_frame(self, image: ProgressiveImage, request: FrameRequest, now: float) -> None:
        """Record the frame time of a moving camera."""
        if self._awaited_at is not None:
            pixels = image.width * image.height
            self._resolution.record(*request.size, pixels, now - self._awaited_at)
        self._awaited_at = None
        self._rate.record(now)

    def _send(self, image: ProgressiveImage, request: FrameRequest, *, may_drop: bool) -> None:
        count = image.samples
        if count > 1 and (count & (count - 1) == 0 or image.is_done):
            self._noise = image.noise()
        self._sent_key = _header_key(request, image)
        self._sent_at = time.perf_counter()
        display = request.settings.display
        self._show(RenderedFrame(image.draw(display), self.header(image, request)), may_drop)


def _header_key(request: FrameRequest, image: ProgressiveImage | None) -> tuple[Any, ...]:
    """Identify what was sent about a complete image."""
    return request.settings.display, request.number, request.moving, id(image)
